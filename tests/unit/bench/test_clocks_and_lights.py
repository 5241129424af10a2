"""The two clocks, tables of lights, files as tables, and options: each at its edges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.clock import VirtualClock
from pdcd.bench.grey import curve_of, curves_of, read_lut, with_lut
from pdcd.bench.reading import (
    ConfigFault,
    format_toml,
)
from pdcd.bench.tables import Config, PanelConfig
from pdcd.errors import ConfigError


def test_sleeping_moves_a_virtual_clock_forward_only() -> None:
    clock = VirtualClock()
    assert clock.now_ns() == 1_000_000_000
    clock.sleep_until_ns(1_500_000_000)
    clock.sleep_until_ns(1_200_000_000)
    assert clock.now_ns() == 1_500_000_000


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


def test_notes_stand_behind_their_keys_and_tables() -> None:
    table = {"a": 1, "t": {"b": None, "c": [True, "x"], "d e": {"f": 0.5}}}
    text = format_toml(table, {("a",): "first\nline", ("t",): "a table", ("t", "d e", "f"): "last"})
    assert text == (
        'a = 1  # first\\nline\n\n[t]  # a table\nc = [true, "x"]\n\n[t."d e"]\nf = 0.5  # last\n'
    )
