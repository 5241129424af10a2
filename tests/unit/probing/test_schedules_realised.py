"""What the schedules of one to three refreshes a code keep apart, against evaluations by hand."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from pdcd.codes.make import make_codes
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import SLOTS, build_frames
from pdcd.planning.schedule_fit import choose_schedule, list_tolerant_schedules
from pdcd.probing.panel import PanelOptics
from pdcd.probing.realised import Factors, collect_factors, compute_factors
from pdcd.words import ScheduleName
from tests import bench_rig, oracles

T_NS = 16_000_000
T_S = T_NS * 1e-9
GRID = (2, 3)

PROMISED = {
    "none": (0.0, 0.0),
    "both": (-1.0, 1.0),
    "lag": (0.0, 1.0),
    "lead": (-1.0, 0.0),
    "tail": (-1.0, 2.0),
    "full": (-1.0, 1.0),
    "wide": (-1.0, 2.0),
}
SKEWS = (-1.0, -0.6, -0.25, 0.0, 0.25, 0.6, 1.0, 1.4, 2.0)


def frames_of(schedule: ScheduleName, count: int = 6, window: str = "whole") -> Frames:
    codes = make_codes("bernoulli", Lattice(GRID, window).shape, count, dual="complement", seed=2)
    return build_frames(bench_rig.pairs(codes), GRID, window=window, schedule=schedule, passes=1)


def log_of(frames: Frames) -> FrameLog:
    rows = np.arange(len(frames), dtype=np.int32)
    at = 40_000_000 + T_NS * np.arange(len(frames) + 1, dtype=np.int64)
    late = np.zeros(len(frames), dtype=np.int32)
    end = np.array([at[-1], at[-1]])
    return FrameLog(rows, rows, at[:-1], at[:-1], end, late, "test", True)


def realised(frames: Frames, primal: PanelOptics, dual: PanelOptics) -> Factors:
    log = log_of(frames)
    close_ns = int(log.end_ns[0]) + 60_000_000
    return collect_factors(compute_factors(frames, log, primal, dual, open_ns=0, close_ns=close_ns))


def skewed(skew: float, *, slow: bool = False) -> PanelOptics:
    if slow:
        return PanelOptics(0.003, 0.006, 1 / 200, round(skew * T_NS))
    return PanelOptics(skew_ns=round(skew * T_NS))


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize("skew", [-0.7, 0.0, 0.4])
@pytest.mark.parametrize("schedule", SLOTS)
@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_every_schedule_equals_the_dense_evaluation(
    window: str, schedule: ScheduleName, skew: float, slow: bool
) -> None:
    frames = frames_of(schedule, 2, window)
    log = log_of(frames)
    primal, dual = (
        PanelOptics(0.001, 0.002, 1 / 500) if slow else PanelOptics(),
        skewed(skew, slow=slow),
    )
    end = int(log.end_ns[0]) + 60_000_000
    got = collect_factors(compute_factors(frames, log, primal, dual, open_ns=0, close_ns=end))
    fine = 4 if window == "quarter" else 1
    lit = oracles.timeline(frames, log, primal, 0, True, fine)
    seen = oracles.timeline(frames, log, dual, 0, False, fine)
    pairs = oracles.pair_integrals(lit, seen, primal, dual, end * 1e-9)
    want, coaxial = oracles.to_cells(pairs, GRID, fine)
    assert np.abs(got.dense() - want).max() <= 1e-12 * want.max()
    assert np.abs(got.coaxial - coaxial).max() <= 1e-12 * want.max()


@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize("skew", SKEWS)
@pytest.mark.parametrize("schedule", SLOTS)
def test_direct_light_is_exactly_zero_where_promised_and_only_there(
    schedule: ScheduleName, skew: float, window: str
) -> None:
    low, high = PROMISED[schedule]
    got = realised(frames_of(schedule, window=window), PanelOptics(), skewed(skew))
    if low <= skew <= high:
        assert got.coaxial.max() == 0.0
    else:
        assert got.coaxial.max() > 0.0


@pytest.mark.parametrize("skew", SKEWS)
@pytest.mark.parametrize("schedule", ["both", "lag", "lead", "tail", "full", "wide"])
def test_light_of_the_code_is_the_share_that_is_told(schedule: ScheduleName, skew: float) -> None:
    """Off-diagonal sum: the time a code shines through its own mask, times lit times open cells."""
    low, high = PROMISED[schedule]
    if not low <= skew <= high:
        return
    frames = frames_of(schedule)
    on = np.unpackbits(frames.primal_patterns.astype(np.uint8), axis=1)[:, :6].astype(float)
    cells = float((on.sum(axis=1) * (6.0 - on.sum(axis=1))).sum())
    share = 1.0 - abs(skew) if schedule == "both" else 1.0
    if schedule == "tail":
        share = min(1.0, 1.0 + skew, 2.0 - skew)
    got = realised(frames, PanelOptics(), skewed(skew))
    assert got.total_s == pytest.approx(share * T_S * cells, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("schedule", "after"),
    [
        ("none", (0, 1)),
        ("both", (1, 2)),
        ("lag", (1, 3)),
        ("lead", (0, 2)),
        ("tail", (2, 4)),
        ("full", (1, 4)),
        ("wide", (2, 6)),
    ],
)
def test_the_tail_of_a_slow_mask_meets_what_the_schedule_says(
    schedule: ScheduleName, after: tuple[int, int]
) -> None:
    """Two codes: the mask opens at a cell for one refresh with the first, whose light is elsewhere;
    the second lights the cell from `after[0]` to `after[1]` refreshes after the mask closed."""
    tau = 0.011
    bits = np.array([[False, True], [True, False]])
    patterns = np.packbits(bits, axis=1), np.packbits(~bits, axis=1)
    frames = build_frames(patterns, (1, 2), window="whole", schedule=schedule, passes=1)
    got = realised(frames, PanelOptics(), PanelOptics(tau, tau))
    opened = 1.0 - np.exp(-T_S / tau)
    tail = tau * (np.exp(-after[0] * T_S / tau) - np.exp(-after[1] * T_S / tau))
    assert got.coaxial[0] == pytest.approx(opened * tail, rel=1e-9)


@pytest.mark.parametrize(
    ("schedule", "times"),
    [("none", 1), ("both", 1), ("lag", 2), ("tail", 2), ("full", 3), ("wide", 4)],
)
def test_a_leaking_mask_leaks_for_as_long_as_the_projector_is_lit(
    schedule: ScheduleName, times: int
) -> None:
    leak = 1 / 100
    bits = np.array([[True, False]])
    patterns = np.packbits(bits, axis=1), np.packbits(~bits, axis=1)
    frames = build_frames(patterns, (1, 2), window="whole", schedule=schedule, passes=1)
    got = realised(frames, PanelOptics(), PanelOptics(leak=leak))
    assert got.coaxial[0] == pytest.approx(times * leak * T_S, rel=1e-12)


def test_slots_in_full() -> None:
    """[P 0] / [M 0], [P P] / [M 0], [P P] / [0 M], [P P 0] / [M 0 0], as index of two codes."""
    p, m = {}, {}
    for schedule in SLOTS:
        frames = frames_of(schedule, 2)
        p[schedule], m[schedule] = frames.primal_index.tolist(), frames.dual_index.tolist()
        np.testing.assert_array_equal(frames.guard, frames.dual_index == -1)
    assert p["none"] == m["none"] == [0, 1]
    assert p["both"] == m["both"] == [0, -1, 1, -1]
    assert (p["lag"], m["lag"]) == ([0, 0, 1, 1], [0, -1, 1, -1])
    assert (p["lead"], m["lead"]) == ([0, 0, 1, 1], [-1, 0, -1, 1])
    assert (p["tail"], m["tail"]) == ([0, 0, -1, 1, 1, -1], [0, -1, -1, 1, -1, -1])
    assert (p["full"], m["full"]) == ([0] * 3 + [1] * 3, [-1, 0, -1, -1, 1, -1])


def test_bools_are_what_they_were() -> None:
    for given, name in ((True, "full"), (False, "none")):
        assert choose_schedule(given, None) == choose_schedule(given, 0.3) == name
    assert choose_schedule("lead", 0.3) == "lead"  # whoever names a schedule gets it


@pytest.mark.parametrize(
    ("lag", "jitter", "auto"),
    [
        (None, 0.0, "full"), (0.0, 0.0, "lag"), (0.4, 0.0, "lag"), (1.0, 0.0, "lag"),
        (-0.4, 0.0, "lead"), (-1.0, 0.0, "lead"), (1.2, 0.0, "full"), (-1.2, 0.0, "full"),
        (0.02, 0.01, "full"), (0.05, 0.01, "lag"), (-0.05, 0.01, "lead"), (0.97, 0.01, "full"),
    ],
)  # fmt: skip
def test_auto_follows_the_measured_sign(lag: float | None, jitter: float, auto: str) -> None:
    assert choose_schedule("auto", lag, jitter) == auto


@pytest.mark.parametrize("lag", [*SKEWS, -1.3, 1.7])
def test_what_is_called_tolerant_keeps_all_direct_light_out(lag: float) -> None:
    """Beyond one refresh nothing does: a mask that late wants `mask_delay_refreshes`."""
    assert list_tolerant_schedules(None) == ("full",)
    for schedule in list_tolerant_schedules(lag):
        got = realised(frames_of(schedule), PanelOptics(), skewed(lag))
        if abs(lag) <= 1.0:
            assert got.coaxial.max() == 0.0 and got.total_s > 0.0


def test_schedules_without_guards_leak_from_both_neighbours() -> None:
    """Sanity of the above: the leak of "none" is |s| T over all pairs of neighbours."""
    frames = frames_of("none", 8)
    on = np.unpackbits(frames.primal_patterns.astype(np.uint8), axis=1)[:, :6].astype(float)
    want = 0.25 * T_S * np.sum([(1.0 - before) * after for before, after in pairwise(on)], axis=0)
    got = realised(frames, PanelOptics(), skewed(0.25))
    np.testing.assert_allclose(got.coaxial, want, rtol=1e-12, atol=1e-15)
