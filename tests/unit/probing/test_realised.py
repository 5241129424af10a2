"""The closed form of the realised probing matrix against exponentials and time steps."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import build_frames
from pdcd.probing.deviation import measure_deviation
from pdcd.probing.panel import PanelOptics
from pdcd.probing.realised import collect_factors, compute_factors, sum_signed_factors
from pdcd.words import ScheduleName
from tests import bench_rig, oracles
from tests.frame_logs import REFRESH_NS, make_log

FINE = 4


def frames_for(
    window: str,
    schedule: ScheduleName,
    *,
    count: int = 3,
    grid: tuple[int, int] = (2, 3),
    seed: int = 1,
) -> Frames:
    codes = make_codes(
        "bernoulli", Lattice(grid, window).shape, count, dual="complement", seed=seed
    )
    return build_frames(bench_rig.pairs(codes), grid, window=window, schedule=schedule, passes=1)


def log_for(
    frames: Frames, *, start_ns: int = 10_000_000, jitter_ns: int = 0, phase_ns: int = 0
) -> FrameLog:
    return make_log(len(frames), start_ns=start_ns, jitter_ns=jitter_ns, late_ns=phase_ns)


def close_ns(log: FrameLog) -> int:
    return int(log.end_ns.max()) + 30_000_000


def both(
    frames: Frames,
    log: FrameLog,
    primal: PanelOptics,
    dual: PanelOptics,
    offset: tuple[float, float] = (0.0, 0.0),
    fine: int = FINE,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    end = close_ns(log)
    got = collect_factors(
        compute_factors(frames, log, primal, dual, open_ns=0, close_ns=end, offset_cells=offset)
    )
    tp = oracles.timeline(frames, log, primal, 0, True, fine)
    td = oracles.timeline(frames, log, dual, 0, False, fine, offset)
    pairs = oracles.pair_integrals(tp, td, primal, dual, end * 1e-9)
    want, coaxial = oracles.to_cells(pairs, frames.grid, fine)
    return got.dense(), got.coaxial, want, coaxial


PANELS = {
    "ideal": (PanelOptics(), PanelOptics()),
    "leaking": (PanelOptics(leak=1 / 800), PanelOptics(leak=1 / 50, skew_ns=4_000_000)),
    "slow": (PanelOptics(0.004, 0.004), PanelOptics(0.008, 0.008, skew_ns=-3_000_000)),
    "uneven": (
        PanelOptics(0.001, 0.003, 1 / 500, 2_000_000),
        PanelOptics(0.012, 0.005, 1 / 300, 5_000_000),
    ),
}


@pytest.mark.parametrize("schedule", ["full", "none"])
@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize("panels", PANELS)
def test_closed_form_equals_matrix_exponentials(
    panels: str, window: str, schedule: ScheduleName
) -> None:
    primal, dual = PANELS[panels]
    frames = frames_for(window, schedule)
    log = log_for(frames, jitter_ns=400_000, phase_ns=1_234_567)
    got, got_coaxial, want, coaxial = both(frames, log, primal, dual)
    scale = want.max()
    assert np.abs(got - want).max() <= 1e-12 * scale
    assert np.abs(got_coaxial - coaxial).max() <= 1e-12 * scale


@pytest.mark.parametrize(
    ("window", "offset"),
    [("whole", (0.125, -0.25)), ("quarter", (-0.5, 0.375)), ("side-3/4", (0.125, -0.25))],
)
def test_misregistration_equals_pixel_by_pixel(window: str, offset: tuple[float, float]) -> None:
    primal, dual = PANELS["uneven"]
    frames = frames_for(window, "full", count=2)
    got, got_coaxial, want, coaxial = both(frames, log_for(frames), primal, dual, offset, 8)
    assert np.abs(got - want).max() <= 1e-12 * want.max()
    assert np.abs(got_coaxial - coaxial).max() <= 1e-12 * want.max()


@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize(
    ("family", "count"), [("bernoulli", 2), ("balanced", 12), ("hadamard", 64)]
)
def test_indirect_codes_have_an_exactly_zero_diagonal(family: str, window: str, count: int) -> None:
    grid = (5, 7)
    codes = make_codes(family, Lattice(grid, window).shape, count, dual="complement", seed=5)
    frames = build_frames(bench_rig.pairs(codes), grid, window=window, schedule="full", passes=2)
    log = log_for(frames)
    got = collect_factors(
        compute_factors(
            frames, log, PanelOptics(), PanelOptics(), open_ns=0, close_ns=close_ns(log)
        )
    )
    assert got.coaxial.max() == 0.0
    if window == "whole":
        assert np.abs(np.diag(got.dense())).max() == 0.0


@pytest.mark.parametrize("window", ["side-5/8", "side-7/8"])
def test_windows_that_overlap_equal_pixel_by_pixel(window: str) -> None:
    """Places that open under two sub-shifts of an axis remember both: panels are slow."""
    primal, dual = PANELS["uneven"]
    frames = frames_for(window, "full", count=2, grid=(1, 2))
    log = log_for(frames, jitter_ns=400_000, phase_ns=1_234_567)
    got, got_coaxial, want, coaxial = both(frames, log, primal, dual, fine=16)
    assert np.abs(got - want).max() <= 1e-12 * want.max()
    assert np.abs(got_coaxial - coaxial).max() <= 1e-12 * want.max()


@pytest.mark.parametrize(("offset", "leaks"), [(0.24, False), (0.25, False), (0.27, True)])
def test_quarter_windows_tolerate_a_quarter_cell(offset: float, leaks: bool) -> None:
    frames = frames_for("quarter", "full", count=16, grid=(3, 3))
    log = log_for(frames)
    got = collect_factors(
        compute_factors(
            frames, log, PanelOptics(), PanelOptics(), open_ns=0, close_ns=close_ns(log),
            offset_cells=(offset, 0.0),
        )
    )  # fmt: skip
    assert bool(got.coaxial.max() > 1e-9) is leaks


def test_white_frames_open_everything() -> None:
    frames = build_frames(
        None,
        (3, 4),
        window="quarter",
        schedule="full",
        passes=5,
    )
    log = log_for(frames)
    got = collect_factors(
        compute_factors(
            frames, log, PanelOptics(), PanelOptics(), open_ns=0, close_ns=close_ns(log)
        )
    )
    report = measure_deviation(got, bench_rig.uniform((3, 4), 1.0, 1.0))
    assert report.weight_s == pytest.approx(5 * REFRESH_NS * 1e-9, rel=1e-12)
    assert report.off_max is not None and report.off_max < 1e-12 and report.diagonal_max < 1e-12


@pytest.mark.parametrize(
    ("window", "asked", "given"), [("quarter", True, True), ("quarter", False, False),
                                   ("whole", True, False)]
)  # fmt: skip
def test_parts_of_cells_are_looked_at_where_asked_and_where_there_are_any(
    window: str, asked: bool, given: bool
) -> None:
    frames = frames_for(window, "full")
    log = log_for(frames)
    got = collect_factors(
        compute_factors(
            frames, log, PanelOptics(), PanelOptics(), open_ns=0, close_ns=close_ns(log), fine=asked
        )
    )
    assert (got.fine is not None) is given
    assert got.displaced is None


def test_many_chunks_and_low_rank_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    primal, dual = PANELS["uneven"]
    frames = frames_for("quarter", "full", count=5)
    log = log_for(frames)

    def run() -> list[NDArray[np.float64]]:
        parts = list(
            compute_factors(frames, log, primal, dual, open_ns=0, close_ns=close_ns(log), fine=True)
        )
        whole = collect_factors(parts)
        assert whole.left.shape[0] <= 6  # never more than the cells there are
        assert whole.fine is not None
        found = [whole.dense(), whole.coaxial, whole.open_s, whole.fine.light, whole.fine.coaxial]
        return [*found, np.array([float(len(parts))])]

    one = run()
    monkeypatch.setattr("pdcd.probing.realised.FIELD_CHUNK_BYTES", 1)
    many = run()
    assert one[-1] < many[-1]
    for a, b in zip(one[:-1], many[:-1], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13)


def test_memory_does_not_grow_with_the_number_of_codes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pdcd.probing.realised.FIELD_CHUNK_BYTES", 2**14)
    primal, dual = PANELS["uneven"]
    peaks = []
    for count in (16, 128):
        frames = frames_for("quarter", "full", count=count, grid=(12, 16))
        log = log_for(frames)
        tracemalloc.start()
        for _ in compute_factors(frames, log, primal, dual, open_ns=0, close_ns=close_ns(log)):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]


def test_black_level_shots_leave_the_codes_alone() -> None:
    """L3: P(i,m) - P(i,0) - P(0,m) + P(0,0) = (1 - eps)(1 - delta) sum m i, exactly."""
    primal, dual = PanelOptics(leak=0.01), PanelOptics(leak=0.02)
    grid = (3, 4)
    codes = make_codes("hadamard", grid, 8, dual="complement", seed=2)
    parts = []
    for sign, p, d in [
        (1.0, False, False), (-1.0, False, True), (-1.0, True, False), (1.0, True, True),
    ]:  # fmt: skip
        frames = build_frames(
            bench_rig.pairs(codes), grid, window="whole", schedule="full", passes=1,
            primal_black=p, dual_black=d,
        )  # fmt: skip
        log = log_for(frames)
        one = collect_factors(
            compute_factors(frames, log, primal, dual, open_ns=0, close_ns=close_ns(log))
        )
        parts.append((sign, one))
    total = sum_signed_factors(parts)
    want = (codes.dual.astype(float).T @ codes.primal) * REFRESH_NS * 1e-9 * 0.99 * 0.98
    np.testing.assert_allclose(total.dense(), want, rtol=0, atol=1e-14)
    np.testing.assert_allclose(total.coaxial, 0.0, atol=1e-15)
