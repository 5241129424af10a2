"""Bytes of blocks and numbers of pages, exactly: what a page's script relies on."""

from __future__ import annotations

import base64
import importlib
import zlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.pages.report import layers, material, packing, timeline
from pdcd.pages.report import timeline as budget
from pdcd.pages.report.packing import factored, integers, least_step, linear, logarithmic, singles
from pdcd.pages.report.write import written
from pdcd.panels.map import Map
from pdcd.pictures.exposed import Print
from pdcd.pictures.picture import Barred
from pdcd.pictures.upright import View
from pdcd.probing.realised import Factors
from pdcd.runs.later import REPORT


def raw(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text))


def test_linear_values_are_folded_differences_lower_bytes_first() -> None:
    """Steps 3, 1, none, 40000: differences 3, -2, -32769 and 65534 modulo 2^16, folded."""
    block = linear(np.array([[3.0, 1.0], [np.nan, 32766.0]]), 1.0)
    assert (block["kind"], block["shape"], block["step"]) == ("linear", [2, 2], 1.0)
    data = np.frombuffer(raw(block["data"]), np.uint8)
    folded = data[:4].astype(int) + 256 * data[4:].astype(int)
    steps = np.where(folded % 2, -(folded // 2) - 1, folded // 2)
    assert steps.tolist()[:2] == [3, -2]
    assert (np.cumsum(steps[2:]) % 2**16).tolist() == [2**16 - 32768, 32766]


def test_steps_are_rounded_and_cut_off() -> None:
    block = linear(np.array([[0.4, 0.6, -0.6, 1e9, -1e9]]), 1.0)
    data = np.frombuffer(raw(block["data"]), np.uint8)
    folded = data[:5].astype(int) + 256 * data[5:].astype(int)
    steps = np.where(folded % 2, -(folded // 2) - 1, folded // 2)
    whole = (np.cumsum(steps) + 2**15) % 2**16 - 2**15
    assert whole.tolist() == [0, 1, -1, 32766, -32766]


def test_logarithms_have_254_levels_between_the_least_and_the_largest() -> None:
    block = logarithmic(np.array([[1.0, np.exp(2.0), np.exp(4.0), 0.0, np.inf, np.nan, -1.0]]))
    levels = np.cumsum(np.frombuffer(raw(block["data"]), np.uint8).astype(int)) % 256
    assert levels.tolist()[:2] == [1, 127 if levels[1] == 127 else 128]
    assert levels.tolist()[2:6] == [254, 0, 255, 255] and levels[6] == 0
    assert block["off"] == pytest.approx(np.exp(2.0 / 253.0) - 1.0)
    assert (block["low"], block["high"]) == (1.0, pytest.approx(np.exp(4.0)))


def test_rows_of_factors_have_256_levels_of_their_own() -> None:
    block, back = factored(np.array([[1.0, 2.0, 3.55], [7.0, 7.0, 7.0]]))
    assert np.frombuffer(raw(block["data"]), np.uint8).tolist() == [0, 100, 255, 0, 0, 0]
    assert np.frombuffer(raw(block["low"]), "<f4").tolist() == [1.0, 7.0]
    step = np.frombuffer(raw(block["step"]), "<f4")
    assert step[0] == pytest.approx(0.01) and step[1] == 1.0
    assert back.dtype == np.float32
    np.testing.assert_allclose(back, [[1.0, 2.0, 3.55], [7.0, 7.0, 7.0]], rtol=1e-6)
    assert (block["kind"], block["shape"]) == ("factored", [2, 3])


def test_whole_numbers_are_differences_of_four_bytes_and_singles_are_plain() -> None:
    block = integers(np.array([5, 6, 4]))
    assert raw(block["data"]) == np.array([5, 1, -2], "<i4").tobytes()
    assert (block["kind"], block["shape"]) == ("integers", [3])
    plain = singles(np.array([[0.5, -1.0]]))
    assert raw(plain["data"]) == np.array([0.5, -1.0], "<f4").tobytes()
    assert (plain["kind"], plain["shape"]) == ("singles", [1, 2])


def test_steps_are_never_zero() -> None:
    assert least_step(np.array([np.nan, np.inf]), 0.0) == 1.0
    assert least_step(np.array([-32766.0 * 4.0]), 0.0) == 4.0


def test_alike_numbers_are_packed_shorter_than_noise() -> None:
    """Patterns of codes repeat, noise does not: each is packed in its own way."""
    rows = np.tile(np.arange(64.0), (8, 16))
    assert len(factored(rows)[0]["data"]) < 400
    steady = integers(np.tile([0, 1000], 4000))
    assert len(steady["data"]) < 400
    assert len(linear(np.zeros((64, 64)), 1.0)["data"]) < 400


def test_a_page_has_room_for_so_much() -> None:
    """Codes of blocks are those of its script; twelve megabytes are kept with these sizes."""
    assert (packing.MOST, packing.NOTHING, packing.LEVELS, packing.UNKNOWN) == (
        32766, -32768, 254, 255,
    )  # fmt: skip
    assert (layers.MOST_PX, layers.MOST_PIXELS, layers.MOST_PICTURES) == (1068, 3_100_000, 8)
    assert (budget.MOST_SHOTS, budget.LOOKED_AT, timeline.MOST_REFRESHES) == (64, 150, 60_000)


def barred(level: float, sigma: float, frame: tuple[int, int]) -> Barred:
    error = np.full((*frame, 3), sigma, np.float32)
    return Barred(np.full((*frame, 3), level), error, error, 0.0 * error, "sensor")


def test_brightness_of_a_page_is_told_by_picture() -> None:
    """The white one gets to 0.9, and what is as weak as a tenth is shown eight times brighter."""
    made = {"indirect": barred(0.06, 1e-5, (8, 12)), "white": barred(0.6, 1e-5, (8, 12))}
    shown = layers.layers(made, View(Map.filling((12, 8)), 1.5), None)
    assert shown.scale == pytest.approx(1.5)
    assert [(one["name"], one["factor"], one["signed"]) for one in shown.data] == [
        ("indirect", 8.0, False), ("white", 1.0, False),
    ]  # fmt: skip
    made["indirect"].image[...] = -0.06
    signed = layers.layers(made, View(Map.filling((12, 8)), 1.5), None).data[0]
    assert signed["signed"] and signed["factor"] == 8.0


def test_steps_of_pictures_go_by_their_noise_but_not_below_their_brightest() -> None:
    """Half of the usual sigma; of pictures without noise a 2^-14th of the largest value."""
    view = View(Map.filling((12, 8)), 1.5)
    for sigma, step in ((0.02, 0.01), (1e-9, 0.6 * 2.0**-14)):
        (one,) = layers.layers({"white": barred(0.6, sigma, (8, 12))}, view, None).data
        assert one["values"]["step"] == pytest.approx(step, rel=1e-4)


@pytest.mark.parametrize(
    ("shots", "entries", "refreshes", "more"),
    [(3, 0, 0, 2 * 3e-3), (1, 10**6, 0, 2 * 1e-7 * 10**6), (1, 0, 10**4, 1e-5 * 10**4)],
)
def test_costs_of_a_page_add_up(shots: int, entries: int, refreshes: int, more: float) -> None:
    def foreseen(shots: int, entries: int, refreshes: int) -> float:
        factors = Factors(np.zeros((1, entries)), np.zeros((1, 0)), np.zeros(1), np.zeros(1))
        told = SimpleNamespace(realised=factors)
        taken = [SimpleNamespace(refreshes=refreshes // shots) for _ in range(shots)]
        decoded: Any = SimpleNamespace(
            pictures={"a": 1, "b": 2}, view=View(Map.filling((12, 8)), 1.5), shots={"a": told},
            sums={"b": told}, cells=SimpleNamespace(frame=(8, 12)),
        )  # fmt: skip
        record: Any = SimpleNamespace(shots=taken)
        return material.foreseen_s(record, decoded)

    least = foreseen(1, 0, 0)
    # Three values of each pixel of two pictures and a truth, and a third of that for each quad.
    values = 3 * 12 * 8 * 3
    assert least == pytest.approx(0.02 + 3e-3 + 9e-8 * 1.3 * values)
    assert foreseen(shots, entries, refreshes) - least == pytest.approx(more)


def test_a_page_is_written_where_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = importlib.import_module(
        "pdcd.pages.report.write"
    )  # the package has a function of that name
    monkeypatch.setattr(module, "page", lambda manifest, material: "caf\u00e9")
    nothing: Any = None
    assert written(tmp_path, nothing, nothing) == tmp_path / REPORT
    out = tmp_path / "other.html"
    assert written(tmp_path, nothing, nothing, out) == out
    assert out.read_bytes() == (tmp_path / REPORT).read_bytes() == b"caf\xc3\xa9"


def test_the_light_of_a_budget_is_looked_at_evenly() -> None:
    """Of 300 rows every second one, of 299 each."""
    profile = SimpleNamespace(
        row=lambda _: SimpleNamespace(gain_e_per_dn=1.0), saturation_dn=lambda _: 1.0
    )
    taken = SimpleNamespace(
        name="a", open_ns=0, close_ns=10**9, refreshes=1, iso=1, f_number=1.0, level=None
    )
    record: Any = SimpleNamespace(shots=[taken], profile=profile, responsivity_e=(0.0, 1.0, 0.0))
    factors = Factors(np.ones((1, 4)), np.ones((1, 4)), np.ones(4), np.ones(4))
    for rows, seen in ((300, 0.0), (299, 149.0 / 299.0)):
        light = np.zeros((rows, 10, 3))
        light[1::2] = 1.0
        shot = Print(light, light, np.zeros((rows, 10), np.bool_), factors, {})
        (line,) = budget.budget(record, {"a": shot})
        assert line["electrons"] == pytest.approx(seen)
