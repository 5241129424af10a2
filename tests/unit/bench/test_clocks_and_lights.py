"""The two clocks, tables of lights, files as tables, and options: each at its edges."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.bench.grey import curve_of, curves_of, read_lut, with_lut
from pdcd.bench.reading import (
    ConfigFault,
    check_integers,
    find_number_faults,
    format_toml,
    merge_table,
    parse_toml,
    read_toml,
)
from pdcd.bench.tables import Config, PanelConfig
from pdcd.errors import ConfigError


def test_sleeping_moves_a_virtual_clock_forward_only() -> None:
    clock = VirtualClock()
    assert clock.now_ns() == 1_000_000_000
    clock.sleep_until_ns(1_500_000_000)
    clock.sleep_until_ns(1_200_000_000)
    assert clock.now_ns() == 1_500_000_000


def test_a_real_clock_sleeps_for_what_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    monkeypatch.setattr(time, "monotonic_ns", lambda: 5_000_000_000)
    monkeypatch.setattr(time, "sleep", slept.append)
    real = RealClock()
    assert real.now_ns() == 5_000_000_000
    real.sleep_until_ns(7_500_000_000)
    real.sleep_until_ns(5_000_000_000)
    real.sleep_until_ns(4_000_000_000)
    assert slept == [2.5]


def panel(**told: Any) -> PanelConfig:
    return PanelConfig(size_px=(8, 8), **told)


def test_levels_give_light_by_a_power_or_by_a_table(tmp_path: Path) -> None:
    levels = np.array([0, 51, 255], np.uint8)
    assert curve_of(panel()) is None
    power, table = curve_of(panel(gamma=2.0)), curve_of(panel(gamma=2.0, lut=(0.0, 0.5, 1.0)))
    assert power is not None and table is not None
    np.testing.assert_allclose(power.of(levels), [0.0, 0.04, 1.0])
    np.testing.assert_allclose(table.of(levels), [0.0, 0.2, 1.0])
    (tmp_path / "l").write_text("0 1")
    from_file = curve_of(panel(lut=str(tmp_path / "l")))
    assert from_file is not None
    np.testing.assert_allclose(from_file.of(levels), [0.0, 0.2, 1.0])
    with pytest.raises(ConfigError, match=r"^lut "):
        curve_of(panel(lut=(0.0, 0.5)))
    projector, mask = curves_of(Config(mask=panel(gamma=2.0)))
    assert projector is None and mask is not None


def test_lights_of_a_file_are_parted_by_space_or_commas(tmp_path: Path) -> None:
    path = tmp_path / "lights"
    path.write_text("# levels\n0, 0.25\t0.5 # half\n\n1.0")
    assert read_lut(path) == (0.0, 0.25, 0.5, 1.0)
    path.write_text(" ".join(["0.5"] * 256))
    assert len(read_lut(path)) == 256
    path.write_text(" ".join(["0.5"] * 257))
    with pytest.raises(ConfigError, match="holds more than 256 lights"):
        read_lut(path)


@pytest.mark.parametrize("data", [b"0 x 1", b"\xff", None])
def test_what_holds_no_lights_is_refused_in_one_line(tmp_path: Path, data: bytes | None) -> None:
    path = tmp_path / "lights"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(ConfigError, match="cannot read lights from "):
        read_lut(path)


def test_a_file_of_lights_takes_the_place_of_its_name(tmp_path: Path) -> None:
    (tmp_path / "l").write_text("0 1")
    faults: list[ConfigFault] = []
    plain = panel(lut=(0.0, 1.0))
    assert with_lut(plain, "mask", tmp_path, faults) is plain
    assert with_lut(panel(lut="l"), "mask", tmp_path, faults).lut == (0.0, 1.0)
    assert faults == []
    assert with_lut(panel(lut="none"), "mask", tmp_path, faults).lut is None
    (fault,) = faults
    assert fault.keys == ("mask.lut",) and fault.message.startswith("mask.lut: cannot read")


@pytest.mark.parametrize(
    ("value", "keys"),
    [
        ({"a": 2**63 - 1, "b": -(2**63)}, []), ({"a": 2**63}, ["a"]), ({"a": -(2**63) - 1}, ["a"]),
        ({"a": {"b": [1, [2**63]]}, "c": [{"d": 2**70}]}, ["a.b", "c.d"]),
    ],
)  # fmt: skip
def test_integers_have_64_bits(value: dict[str, Any], keys: list[str]) -> None:
    if not keys:
        assert check_integers(value, "it") is value
        return
    with pytest.raises(ConfigError) as caught:
        check_integers(value, "it")
    told = caught.value.message.splitlines()
    assert told[0] == f"{len(keys)} fault{'s' * (len(keys) > 1)} in it:"
    assert [line.strip().partition(":")[0] for line in told[1:]] == keys


def test_numbers_that_no_message_can_hold_are_named() -> None:
    told = {"a": [1.0, float("nan")], "b": {"c": (2**53, 2**53 - 1)}, "d": -(2**53), "e": "x"}
    assert [fault.keys for fault in find_number_faults(told, "")] == [
        ("a[1]",),
        ("b.c[0]",),
        ("d",),
    ]
    assert [fault.keys for fault in find_number_faults(float("inf"), "key")] == [("key",)]
    assert list(find_number_faults({"a": 1 - 2**53}, "top")) == []
    (fault,) = find_number_faults({"a": 2**60}, "top")
    assert fault == ConfigFault(("top.a",), f"top.a: must be below 2**53 in size, not {2**60}")


def test_what_is_no_toml_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^it is not TOML: "):
        parse_toml("a = ", "it")
    with pytest.raises(ConfigError, match=r"^cannot read the file .*gone: No such file") as caught:
        read_toml(tmp_path / "gone", "the file", "mend it")
    assert caught.value.hint == "mend it"
    (tmp_path / "bytes").write_bytes(b"\xff")
    with pytest.raises(ConfigError, match="is not TOML"):
        read_toml(tmp_path / "bytes", "the file", "mend it")


class Inner(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    number: int = 1


class Outer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    inner: Inner = Inner()
    word: str = "w"


def test_tables_are_laid_over_others_key_by_key() -> None:
    faults: list[ConfigFault] = []
    base = Outer(Inner(5), "v")
    assert merge_table(base, {"word": "x"}, "", faults) == Outer(Inner(5), "x")
    assert merge_table(base, {"inner": {"number": 7}}, "", faults) == Outer(Inner(7), "v")
    assert merge_table(base, {}, "", faults) == base and faults == []
    given = {"inner": {"number": "many", "nmber": 1}, "word": 3, "zzz": 2}
    found = merge_table(base, given, "t", faults)
    assert found == base
    assert [fault.keys for fault in faults] == [
        ("t.inner.number",), ("t.inner.nmber",), ("t.word",), ("t.zzz",),
    ]  # fmt: skip
    assert faults[1].message == "t.inner.nmber: no such key; is number meant?"
    assert faults[3].message == "t.zzz: no such key; known are inner, word"
    assert merge_table(base, 3, "t", faults) == base
    assert faults[-1] == ConfigFault(("t",), "t: must be a table, not 3; write [t]")


def test_notes_stand_behind_their_keys_and_tables() -> None:
    table = {"a": 1, "t": {"b": None, "c": [True, "x"], "d e": {"f": 0.5}}}
    text = format_toml(table, {("a",): "first\nline", ("t",): "a table", ("t", "d e", "f"): "last"})
    assert text == (
        'a = 1  # first\\nline\n\n[t]  # a table\nc = [true, "x"]\n\n[t."d e"]\nf = 0.5  # last\n'
    )
