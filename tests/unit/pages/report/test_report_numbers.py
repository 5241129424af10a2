"""Numbers of a page: blocks come back, times of refreshes, light budget, factors of matrices."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.pages.report import material, weights
from pdcd.pages.report.packing import (
    block_size_bytes,
    pack_factors,
    pack_integers,
    pack_linear,
    pack_logarithmic,
    pack_singles,
)
from pdcd.pages.report.timeline import (
    MOST_SHOTS,
    MOST_TIMELINE_REFRESHES,
    make_light_budget,
    make_timeline,
)
from pdcd.panels.map import Map
from pdcd.pictures.exposed import ComputedShot
from pdcd.pictures.upright import FieldView
from pdcd.probing.convolved import KernelPart, SameRowPart
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import (
    GainPart,
    IlluminatedPart,
    MatchPart,
    NearPart,
    OuterPart,
    UniformPart,
    WantedMatrix,
)
from pdcd.runs.frame_table import COLUMNS
from tests.unit.pages.report._blocks import unpacked


def test_linear_blocks_come_back_within_half_a_step() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(0.0, 5.0, (2, 3, 40))
    values[0, 1, 7:9] = np.nan
    values[1, 0, :2] = 100.0, -100.0
    step = 100.0 / 32766
    back = unpacked(pack_linear(values, step))
    assert np.array_equal(np.isnan(back), np.isnan(values))
    assert np.nanmax(np.abs(back - values)) <= 0.5 * step * (1.0 + 1e-9)
    # What is too large for the step is cut off, on both sides, and stays a number.
    assert np.array_equal(unpacked(pack_linear(np.array([[40e3, -40e3]]), 1.0)), [[32766, -32766]])


def test_logarithmic_blocks_come_back_within_their_share() -> None:
    rng = np.random.default_rng(1)
    values = 10.0 ** rng.uniform(-9, 9, (3, 5, 50))
    values[0, 0, :4] = 0.0, np.inf, np.nan, -1.0
    block = pack_logarithmic(values)
    back = unpacked(block)
    assert back[0, 0, 0] < 1e-280 and np.isinf(back[0, 0, 1:4]).all()
    known = np.isfinite(values) & (values > 0.0)
    off = np.abs(back[known] / values[known] - 1.0).max()
    assert 0.5 * block["off"] < off <= block["off"] * (1.0 + 1e-6) < 0.0102


def test_factors_come_back_as_they_are_told_to() -> None:
    rng = np.random.default_rng(2)
    rows = np.concatenate([rng.random((3, 30)), rng.integers(0, 2, (2, 30)), np.full((1, 30), 0.7)])
    block, back = pack_factors(rows)
    assert np.allclose(unpacked(block), back, rtol=1e-6, atol=1e-9)
    assert np.abs(back[:3] - rows[:3]).max() <= 0.5 / 255 + 1e-6
    assert np.allclose(back[3:], rows[3:], atol=1e-6)


def test_singles_and_integers_come_back_whole() -> None:
    whole = np.array([[2**31 - 1, -(2**31) + 1, 0, 5], [1, 2, 3, 4]])
    block = pack_integers(whole)
    back = (unpacked(block) + 2**31) % 2**32 - 2**31
    assert np.array_equal(back, whole) and block["shape"] == [2, 4]
    assert np.array_equal(unpacked(pack_singles(np.array([0.5, np.inf]))), [0.5, np.inf])
    assert block_size_bytes({"a": "four", "b": "12", "c": 5}) == 6


def shot(name: str, open_ns: int = 0, close_ns: int = 10**9, **fields: Any) -> Any:
    told = {
        "name": name, "open_ns": open_ns, "close_ns": close_ns, "refreshes": 3, "source": "mock",
        "verified": True, "iso": 100, "f_number": 2.0, "level": None,
        "open_s": (close_ns - open_ns) * 1e-9,
    }  # fmt: skip
    return SimpleNamespace(**(told | fields))


def frames(folder: Path, rows: list[dict[str, Any]]) -> None:
    lines = [",".join(str(row.get(name, 0)) for name in COLUMNS) for row in rows]
    (folder / "frames.csv").write_text("\n".join([",".join(COLUMNS), *lines]) + "\n")


def test_the_time_line_tells_every_refresh_from_the_opening_of_its_shutter(tmp_path: Path) -> None:
    at = 5 * 10**9
    told = (
        ("b", at + 1_500_000, at + 1_499_000, 0, 0, 1), ("a", 2_000, 3_000, 2, 0, 0),
        ("b", at + 16_000_000, at + 16_000_400, 0, 1, 0), ("b", at + 3 * 10**7, at - 7000, 1, 1, 0),
    )  # fmt: skip
    names = ("shot", "t_primal_ns", "t_dual_ns", "missed", "dropped", "guard")
    frames(tmp_path, [dict(zip(names, row, strict=True)) for row in told])
    record: Any = SimpleNamespace(shots=(shot("b", at, at + 10**9), shot("a"), shot("c", 2 * at)))
    a, b, c = make_timeline(tmp_path, record)
    assert [one["name"] for one in (a, b, c)] == ["a", "b", "c"]
    assert [one["begin_s"] for one in (a, b, c)] == [0.0, 5.0, 10.0]
    assert (b["missed"], b["late"], a["missed"], a["late"], c["late"]) == (1, 2, 2, 1, 0)
    assert b["length_s"] == 1.0 and b["unit_s"] == pytest.approx(1e-6) and b["every"]
    assert unpacked(b["number"]).tolist() == [0, 1, 2]
    assert unpacked(b["projector"]).tolist() == [1500, 16000, 30000]
    assert unpacked(b["mask"]).tolist() == [1499, 16000, -7]
    # 1: refreshes were lost before it, 2: a panel showed another, 4: the mask is black.
    assert unpacked(b["flags"]).tolist() == [4, 2, 3] and unpacked(a["flags"]).tolist() == [1]
    assert unpacked(b["lost"]).tolist() == [0, 0, 1]
    assert (b["refreshes"], b["source"], b["verified"]) == (3, "mock", True)
    assert c["number"]["shape"] == [0]


@pytest.mark.parametrize(
    ("close_ns", "unit_s"),
    [(10**9, 1e-6), (2 * 10**12, 1e-6), (2 * 10**12 + 1, 1.001e-6), (4 * 10**12, 2e-6), (0, 1e-6)],
)
def test_units_of_a_time_line_fit_its_longest_shot(
    tmp_path: Path, close_ns: int, unit_s: float
) -> None:
    frames(tmp_path, [{"shot": "a", "t_primal_ns": 2**62, "t_dual_ns": -(2**62)}])
    record: Any = SimpleNamespace(shots=(shot("a", 0, close_ns),))
    (told,) = make_timeline(tmp_path, record)
    assert told["unit_s"] == pytest.approx(unit_s, rel=1e-9)
    assert told["length_s"] == max(close_ns, 1) * 1e-9
    # What no exposure can have is cut off, and still fits 32 bits.
    assert unpacked(told["projector"]) == -unpacked(told["mask"]) == 2 * 10**9


def test_of_very_many_refreshes_only_late_ones_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert MOST_TIMELINE_REFRESHES >= 60 * 60  # of a minute at least
    monkeypatch.setattr("pdcd.pages.report.timeline.MOST_TIMELINE_REFRESHES", 5)
    three = [{"missed": 0}, {"missed": 1}, {"dropped": 1}]
    rows = [{"shot": name, "guard": 1, **one} for name in "abc" for one in three]
    frames(tmp_path, [*rows, {"shot": "d"}])
    record: Any = SimpleNamespace(shots=tuple(shot(n, k) for k, n in enumerate("abcd")))
    told = make_timeline(tmp_path, record)
    # b would be the sixth; what is shorter still has room after it, up to the fifth.
    assert [one["every"] for one in told] == [True, False, False, True]
    assert unpacked(told[1]["number"]).tolist() == [1, 2]
    assert unpacked(told[1]["flags"]).tolist() == [5, 6]
    assert (told[1]["missed"], told[1]["late"]) == (1, 2)
    monkeypatch.setattr("pdcd.pages.report.timeline.MOST_TIMELINE_REFRESHES", 6)
    assert [one["every"] for one in make_timeline(tmp_path, record)] == [True, True, False, False]


def test_a_damaged_table_has_no_time_line(tmp_path: Path) -> None:
    record: Any = SimpleNamespace(shots=())
    with pytest.raises(DecodeError, match=r"frames\.csv"):
        make_timeline(tmp_path, record)


def exposed(cells: int, light: NDArray[np.float64], saturated: int = 0) -> ComputedShot:
    full = np.zeros(light.shape[:2], np.bool_)
    full.flat[:saturated] = True
    side = np.full((1, cells), 0.5)
    factors = Factors(side, side, np.full(cells, 0.2), np.full(cells, 0.4))
    return ComputedShot(light, light, full, factors, {})


def test_the_budget_is_in_shares_of_the_exposure_and_electrons() -> None:
    light = np.zeros((4, 5, 3))
    light[..., 1] = 2.0
    light[0, 0, 1] = 22.0
    profile = SimpleNamespace(
        row=lambda iso: SimpleNamespace(gain_e_per_dn=200.0 / iso),
        saturation_dn=lambda iso: 10.0 * iso,
    )
    record: Any = SimpleNamespace(
        shots=(shot("a", 5 * 10**8, 25 * 10**8, level=1.5), shot("gone"), shot("b")),
        responsivity_e=(7.0, 100.0, 9.0),
        profile=profile,
    )
    a, b = make_light_budget(record, {"a": exposed(4, light, saturated=5), "b": exposed(4, light)})
    assert (a["name"], a["exposure_s"], a["iso"], a["f_number"]) == ("a", 2.0, 100, 2.0)
    # The light was divided by the level: of the 2 s the mask was open for 0.4 s times 1.5.
    assert (a["open"], a["lit"]) == (pytest.approx(0.3), pytest.approx(0.15))
    assert a["others"] == pytest.approx(0.25 * 1.5 / 2.0)
    assert a["electrons"] == pytest.approx((19 * 2.0 + 22.0) / 20 * 1.5 * 100.0 / 4.0)
    assert a["saturated"] == 0.25 and b["saturated"] == 0.0
    assert (b["open"], b["lit"], b["others"]) == (
        pytest.approx(0.4), pytest.approx(0.2), pytest.approx(0.25),
    )  # fmt: skip
    values = light[..., 1].ravel() * 25.0
    assert b["full"] == pytest.approx(np.percentile(values, 99.9) / 2000.0)
    assert b["exposure_s"] == 1.0 and b["refreshes"] == 3


def test_an_exposure_of_no_time_has_a_budget_and_only_so_many_are_told() -> None:
    light = np.ones((400, 310, 3))
    light[1::2] = light[:, 1::2] = 1e9  # between the rows and columns that are looked at
    profile = SimpleNamespace(
        row=lambda _: SimpleNamespace(gain_e_per_dn=1.0), saturation_dn=lambda _: 1.0
    )
    shots = tuple(shot(str(n), 5, 5) for n in range(MOST_SHOTS + 1))
    record: Any = SimpleNamespace(shots=shots, responsivity_e=(1.0, 4.0, 1.0), profile=profile)
    dark = exposed(2, light)
    told = make_light_budget(record, {one.name: dark for one in shots})
    assert [one["name"] for one in told] == [str(n) for n in range(MOST_SHOTS)]
    assert np.isfinite(told[0]["open"]) and told[0]["electrons"] == 1.0


def weighed(wanted: WantedMatrix, weight: Any, name: str = "a", cells: int = 6) -> Any:
    rng = np.random.default_rng(3)
    left, right = rng.random((3, cells)), rng.random((3, cells))
    factors = Factors(left, right, rng.random(cells), np.ones(cells))
    photo = SimpleNamespace(name=name, wanted=wanted)
    return SimpleNamespace(photo=photo, realised=factors, weight_s=np.array(weight))


UNIFORM, SIX = {"kind": "uniform"}, range(6)
PARTS: tuple[tuple[Any, dict[str, Any] | None], ...] = (
    (SameRowPart((2, 3)), {"kind": "same row"}),
    (UniformPart(6), {"kind": "uniform"}),
    (OuterPart(np.arange(6.0), np.ones(6)), {"kind": "outer", "camera": SIX, "projector": [1] * 6}),
    (MatchPart(np.array([1, 0, -1, 3, 4, 5])), {"kind": "match", "partner": [1, 0, -1, 3, 4, 5]}),
    (NearPart((2, 3), 1), {"kind": "near", "radius": 1}),
    (KernelPart((2, 3), np.eye(3)), {"kind": "kernel", "taps": np.eye(3)}),
    (GainPart(np.arange(6.0), UniformPart(6)), {"kind": "gained", "camera": SIX, "part": UNIFORM}),
    (IlluminatedPart(UniformPart(6), np.arange(6.0)), {"kind": "lit", "projector": SIX,
    "part": UNIFORM}),
    (object(), None),
    (IlluminatedPart(object(), np.arange(6.0)), None),  # type: ignore[arg-type]
)  # fmt: skip


@pytest.mark.parametrize(("part", "told"), PARTS, ids=lambda one: type(one).__name__)
def test_parts_of_a_wanted_matrix_are_told_as_what_they_are(
    part: Any, told: dict[str, Any] | None
) -> None:
    found = weights._part(part)
    if told is None or found is None:
        assert found is told
        return
    assert found.keys() == told.keys()
    for key, value in told.items():
        if isinstance(found[key], dict) and "shape" in found[key]:
            assert np.array_equal(unpacked(found[key]), list(value))
        else:
            assert found[key] == value


def test_a_matrix_with_a_part_that_no_page_knows_has_no_wanted_one() -> None:
    known = WantedMatrix((2, 3), ((0.5, UniformPart(6)), (-1.0, NearPart((2, 3), 1))))
    told = weights._told(weighed(known, 2.0), 10_000)
    assert [(part["weight"], part["kind"]) for part in told["wanted"]] == [
        (0.5, "uniform"), (-1.0, "near"),
    ]  # fmt: skip
    strange: Any = object()
    mixed = WantedMatrix((2, 3), ((0.5, UniformPart(6)), (1.0, strange)))
    assert weights._told(weighed(mixed, 2.0), 10_000)["wanted"] is None


@pytest.mark.parametrize("weight", [0.5, [0.5, 4.0, 4.0, 4.0, 4.0, 4.0]])
def test_how_far_rows_are_off_by_rounding_is_measured(weight: Any) -> None:
    one = weighed(WantedMatrix((2, 3), ((1.0, UniformPart(6)),)), weight)
    told = weights._told(one, 10_000)
    left, right = unpacked(told["left"]), unpacked(told["right"])
    exact = one.realised.left.T @ one.realised.right
    rows = np.abs(left.T @ right - exact) / np.broadcast_to(weight, 6)[:, None]
    assert told["off"] == pytest.approx(rows.max(), rel=1e-3) and told["off"] > 0.0
    assert np.allclose(unpacked(told["weight"]), weight) and told["light"] is None
    assert told["bytes"] == block_size_bytes(told["left"]) + block_size_bytes(told["right"])


def test_photos_have_their_matrices_while_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = WantedMatrix((2, 3), ((1.0, UniformPart(6)),))
    names = ("coded", "open", "main", "x", "y", "z", "last")
    recipe: Any = SimpleNamespace(main="main", photos=[SimpleNamespace(name=n) for n in names])
    monkeypatch.setattr(weights, "weigh_matrix", lambda photo, *_: weighed(wanted, 1.0, photo.name))

    def found() -> list[str | None]:
        made = weights.pack_matrices(recipe, {}, "row")
        assert [one["name"] for one in made] == ["main", "coded", "open", "x", "y", "z"]
        assert all("bytes" not in one for one in made)
        return [one.get("missing") for one in made]

    assert found() == [None] * 6
    each = weights._told(weighed(wanted, 1.0), 10_000)["bytes"]
    monkeypatch.setattr(weights, "MOST_WEIGHT_BYTES", 2 * each)
    assert [said is None for said in found()] == [True, True, *[False] * 4]
    monkeypatch.setattr(weights, "MOST_WEIGHT_BYTES", 2 * each - 1)
    told = found()
    assert [said is None for said in told] == [True, *[False] * 5] and "too long" in str(told[1])
    monkeypatch.setattr(weights, "MOST_WEIGHTS", 36)
    assert found()[0] is None
    monkeypatch.setattr(weights, "MOST_WEIGHTS", 35)
    assert "too many" in str(found()[0])


def test_a_page_that_is_dear_is_not_made_unasked() -> None:
    """Each cost by itself tips the balance, whatever share of it each makes."""
    factors = exposed(4, np.zeros((2, 2, 3))).realised

    def costs(shots: int, entries: int, refreshes: int, frame: tuple[int, int], count: int) -> Any:
        big = Factors(np.zeros((1, entries)), np.zeros((1, 1)), factors.coaxial, factors.open_s)
        taken = [shot("a", refreshes=refreshes) for _ in range(shots)]
        record = SimpleNamespace(shots=taken, responsivity_e=(1.0, 1.0, 1.0))
        decoded = SimpleNamespace(
            pictures=dict.fromkeys(range(count)), view=FieldView(Map.filling(frame[::-1]), 1.5),
            shots={"a": SimpleNamespace(realised=big)}, sums={"b": SimpleNamespace(realised=big)},
            cells=SimpleNamespace(frame=frame),
        )  # fmt: skip
        return record, decoded

    small = costs(1, 10, 10, (20, 30), 2)
    assert material.is_cheap(*small) and 0.0 < material.foreseen_page_s(*small) < 0.1
    for dear in (
        costs(200, 10, 10, (20, 30), 2), costs(1, 4_000_000, 10, (20, 30), 2),
        costs(1, 10, 10**6, (20, 30), 2), costs(1, 10, 10, (1000, 1500), 2),
    ):  # fmt: skip
        assert not material.is_cheap(*dear)
        assert material.foreseen_page_s(*dear) > material.foreseen_page_s(*small)
    times = [material.foreseen_page_s(*costs(1, 10, 10, (200, 300), n)) for n in (1, 3, 8, 9)]
    assert times[0] < times[1] < times[2] == times[3]
    # Factors that are too many are not packed, and so cost no more.
    most = [material.foreseen_page_s(*costs(1, n, 10, (20, 30), 2)) for n in (10**7, 2 * 10**7)]
    assert most[0] == most[1]
