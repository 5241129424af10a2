"""Panels that repeat themselves have the matrix of before, and nobody else has."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import PanelConfig
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.patterns import pack_bits
from pdcd.panels.schedule import build_frames
from pdcd.pictures.repeated import RepeatedMatrices
from pdcd.pictures.weights import RealisedMatrix
from pdcd.probing.realised import Factors, collect_factors, compute_bench_factors

GRID = (4, 6)
ROW_NS = 250_000


def make_panel(**more: Any) -> PanelConfig:
    return PanelConfig(size_px=(24, 16), refresh_hz=4000.0, **more)


PROJECTOR, MASK = make_panel(), make_panel(skew_s=2e-6)


def make_frames() -> Frames:
    rng = np.random.default_rng(3)
    sides = [pack_bits(rng.random((8, GRID[0] * GRID[1])) < 0.5) for _ in range(2)]
    return build_frames((sides[0], sides[1]), GRID, window="whole", schedule="both", passes=1)


def make_log(frames: Frames, begins_ns: int) -> FrameLog:
    rows = np.arange(len(frames), dtype=np.int32)
    at_ns = begins_ns + ROW_NS * np.arange(len(frames) + 1, dtype=np.int64)
    late = np.zeros(len(frames), np.int32)
    ends_ns = np.array([at_ns[-1], at_ns[-1] + 700])
    return FrameLog(rows, rows, at_ns[:-1], at_ns[:-1] + 700, ends_ns, late, "", True)


def make_shot(open_ns: int, close_ns: int) -> Any:
    return SimpleNamespace(name="coded", level=1.0, open_ns=open_ns, close_ns=close_ns)


def realise(
    frames: Frames, log: FrameLog, shot: Any, projector: PanelConfig = PROJECTOR
) -> Factors:
    return collect_factors(
        compute_bench_factors(
            frames, log, projector, MASK, open_ns=shot.open_ns, close_ns=shot.close_ns
        )
    )


def matrix_of(factors: Factors) -> np.ndarray:
    return factors.left.T @ factors.right


@pytest.fixture
def frames() -> Frames:
    return make_frames()


def test_what_began_at_another_time_of_the_exposure_has_the_same_matrix(frames: Frames) -> None:
    known = RepeatedMatrices(PROJECTOR, MASK)
    first, again = make_shot(0, 20_000_000), make_shot(5_000_000_000, 5_031_000_007)
    log, later = make_log(frames, 100_000), make_log(frames, 5_003_456_789)
    made = RealisedMatrix(realise(frames, log, first))
    known.keep(first, frames, log, made)
    assert known.find(again, replace(frames), later) is made
    anew = realise(frames, later, again)
    np.testing.assert_allclose(matrix_of(anew), matrix_of(made.realised), rtol=1e-12, atol=1e-18)
    for name in ("coaxial", "open_s"):
        np.testing.assert_allclose(
            getattr(anew, name), getattr(made.realised, name), rtol=1e-12, atol=1e-18
        )


def test_what_differs_in_anything_is_worked_out_anew(frames: Frames) -> None:
    shot = make_shot(0, 20_000_000)
    log = make_log(frames, 100_000)
    made = RealisedMatrix(realise(frames, log, shot))
    known = RepeatedMatrices(PROJECTOR, MASK)
    known.keep(shot, frames, log, made)
    assert known.find(shot, frames, log) is made
    late_ns, stale, missed = log.dual_ns.copy(), log.primal_shown.copy(), log.missed.copy()
    late_ns[3] += 1
    stale[4] = stale[3]
    missed[2] = 1
    for other in (
        replace(log, dual_ns=late_ns),
        replace(log, primal_shown=stale),
        replace(log, missed=missed),
        replace(log, end_ns=log.end_ns + 1),
    ):
        assert known.find(shot, frames, other) is None
    assert known.find(shot, make_frames(), log) is None, "codes of another plan"
    assert known.find(make_shot(100_001, 20_000_000), frames, log) is None, "opened too late"
    assert known.find(make_shot(0, int(log.end_ns.max())), frames, log) is None, "closed too soon"
    dimmed = make_shot(0, 20_000_000)
    dimmed.level = 0.9
    assert known.find(dimmed, frames, log) is None
    dimmed.name = "other"
    assert known.find(dimmed, frames, log) is None


def test_rows_that_a_panel_scans_are_not_cut_by_the_shutter(frames: Frames) -> None:
    """The last band of a panel that is scanned ends later by that time."""
    slow = make_panel(scan_s=0.012)
    known, log = RepeatedMatrices(slow, MASK), make_log(frames, 100_000)
    for close_ns, kept in ((int(log.end_ns.max()) + 1_000_000, False), (100_000_000, True)):
        shot = make_shot(0, close_ns)
        known.keep(shot, frames, log, RealisedMatrix(realise(frames, log, shot, slow)))
        assert (known.find(make_shot(0, 100_000_000), frames, log) is not None) == kept


@pytest.mark.parametrize("more", [{"rise_s": 1e-4}, {"fall_s": 1e-4}, {"contrast": 500.0}])
def test_panels_that_are_slow_or_not_black_never_repeat(
    frames: Frames, more: dict[str, float]
) -> None:
    slow = make_panel(**more)
    shot, log = make_shot(0, 20_000_000), make_log(frames, 100_000)
    known = RepeatedMatrices(slow, MASK)
    known.keep(shot, frames, log, RealisedMatrix(realise(frames, log, shot, slow)))
    assert known.find(shot, frames, log) is None
