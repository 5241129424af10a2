"""The closed form of the realised probing matrix against exponentials and time steps."""

from __future__ import annotations

import itertools
import tracemalloc
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from pdcd.panels.curve import make_power_curve, make_table_curve
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import SLOTS, build_frames
from pdcd.probing.deviation import measure_deviation
from pdcd.probing.panel import PanelOptics
from pdcd.probing.realised import Factors, collect_factors, compute_factors
from pdcd.words import ScheduleName
from tests import bench_rig, catalogue_rig, oracles
from tests.frame_logs import REFRESH_NS, make_log

FINE = 4
OTHERS = sorted(SLOTS.keys() - {"full", "none"})


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


def realise(
    frames: Frames,
    log: FrameLog,
    panels: tuple[PanelOptics, PanelOptics] = (PanelOptics(), PanelOptics()),
    **more: Any,
) -> Factors:
    return collect_factors(
        compute_factors(frames, log, *panels, open_ns=0, close_ns=close_ns(log), **more)
    )


def check_by_pixels(
    frames: Frames,
    log: FrameLog,
    panels: tuple[PanelOptics, PanelOptics],
    offset: tuple[float, float] = (0.0, 0.0),
    fine: int = FINE,
) -> None:
    """Against pairs of fine pixels that are followed one by one, by matrix exponentials."""
    got = realise(frames, log, panels, offset_cells=offset)
    lit = oracles.timeline(frames, log, panels[0], 0, True, fine)
    seen = oracles.timeline(frames, log, panels[1], 0, False, fine, offset)
    pairs = oracles.pair_integrals(lit, seen, *panels, close_ns(log) * 1e-9)
    want, coaxial = oracles.to_cells(pairs, frames.grid, fine)
    assert np.abs(got.dense() - want).max() <= 1e-12 * want.max()
    assert np.abs(got.coaxial - coaxial).max() <= 1e-12 * want.max()


PANELS = {
    "ideal": (PanelOptics(), PanelOptics()),
    "leaking": (PanelOptics(leak=1 / 800), PanelOptics(leak=1 / 50, skew_ns=4_000_000)),
    "slow": (PanelOptics(0.004, 0.004), PanelOptics(0.008, 0.008, skew_ns=-3_000_000)),
    "uneven": (
        PanelOptics(0.001, 0.003, 1 / 500, 2_000_000),
        PanelOptics(0.012, 0.005, 1 / 300, 5_000_000),
    ),
}


@pytest.mark.parametrize(
    ("panels", "schedule"),
    [*itertools.product(PANELS, ["full", "none"]), *(("uneven", name) for name in OTHERS)],
)
@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_closed_form_equals_matrix_exponentials(
    panels: str, schedule: ScheduleName, window: str
) -> None:
    frames = frames_for(window, schedule)
    log = log_for(frames, jitter_ns=400_000, phase_ns=1_234_567)
    check_by_pixels(frames, log, PANELS[panels])


@pytest.mark.parametrize(
    ("window", "offset"),
    [("whole", (0.125, -0.25)), ("quarter", (-0.5, 0.375)), ("side-3/4", (0.125, -0.25))],
)
def test_misregistration_equals_pixel_by_pixel(window: str, offset: tuple[float, float]) -> None:
    frames = frames_for(window, "full", count=2)
    check_by_pixels(frames, log_for(frames), PANELS["uneven"], offset, 8)


@pytest.mark.parametrize("window", ["side-5/8", "side-7/8"])
def test_windows_that_overlap_equal_pixel_by_pixel(window: str) -> None:
    """Places that open under two sub-shifts of an axis remember both: panels are slow."""
    frames = frames_for(window, "full", count=2, grid=(1, 2))
    log = log_for(frames, jitter_ns=400_000, phase_ns=1_234_567)
    check_by_pixels(frames, log, PANELS["uneven"], fine=16)


@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize(
    ("family", "count"), [("bernoulli", 2), ("balanced", 12), ("hadamard", 64)]
)
def test_indirect_codes_have_an_exactly_zero_diagonal(family: str, window: str, count: int) -> None:
    grid = (5, 7)
    codes = make_codes(family, Lattice(grid, window).shape, count, dual="complement", seed=5)
    frames = build_frames(bench_rig.pairs(codes), grid, window=window, schedule="full", passes=2)
    got = realise(frames, log_for(frames))
    assert got.coaxial.max() == 0.0
    if window == "whole":
        assert np.abs(np.diag(got.dense())).max() == 0.0


@pytest.mark.parametrize(("offset", "leaks"), [(0.24, False), (0.25, False), (0.27, True)])
def test_quarter_windows_tolerate_a_quarter_cell(offset: float, leaks: bool) -> None:
    frames = frames_for("quarter", "full", count=16, grid=(3, 3))
    got = realise(frames, log_for(frames), offset_cells=(offset, 0.0))
    assert bool(got.coaxial.max() > 1e-9) is leaks


def test_white_frames_open_everything() -> None:
    frames = build_frames(None, (3, 4), window="quarter", schedule="full", passes=5)
    got = realise(frames, log_for(frames))
    report = measure_deviation(got, bench_rig.uniform((3, 4), 1.0, 1.0))
    assert report.weight_s == pytest.approx(5 * REFRESH_NS * 1e-9, rel=1e-12)
    assert report.off_max is not None and report.off_max < 1e-12 and report.diagonal_max < 1e-12


def test_the_realised_matrix_has_the_light_of_the_levels_in_it() -> None:
    """Panels are sent 8 bits, and give light by the curve of each."""
    rng = np.random.default_rng(1)
    light, mask = rng.random((5, 12)), rng.random((5, 12))
    found = catalogue_rig.show(
        light, mask, (3, 4), guards=False,
        projector=PanelOptics(curve=make_power_curve(2.2)),
        mask=PanelOptics(curve=make_table_curve((0.0, 0.3, 1.0))),
    )  # fmt: skip
    given = (np.rint(255.0 * light) / 255.0) ** 2.2
    at = np.rint(255.0 * mask) / 255.0
    seen = np.where(at < 0.5, 0.6 * at, 0.3 + 1.4 * (at - 0.5))
    wanted = seen.T @ given * catalogue_rig.REFRESH_S
    np.testing.assert_allclose(found.dense(), wanted, rtol=1e-6)


@pytest.mark.parametrize(
    ("window", "offset", "asked", "given"),
    [
        ("quarter", (0.0, 0.0), True, True), ("quarter", (0.0, 0.0), False, False),
        ("whole", (0.0, 0.0), True, False), ("whole", (0.0, 0.25), True, True),
    ],
)  # fmt: skip
def test_parts_of_cells_are_looked_at_where_asked_and_where_there_are_any(
    window: str, offset: tuple[float, float], asked: bool, given: bool
) -> None:
    frames = frames_for(window, "full")
    got = realise(frames, log_for(frames), fine=asked, offset_cells=offset)
    assert (got.fine is not None) is given


def test_many_chunks_and_low_rank_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    panels = PANELS["uneven"]
    frames = frames_for("quarter", "full", count=5)
    log = log_for(frames)

    def run() -> list[NDArray[np.float64]]:
        parts = list(
            compute_factors(frames, log, *panels, open_ns=0, close_ns=close_ns(log), fine=True)
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
    peaks = []
    for count in (16, 128):
        frames = frames_for("quarter", "full", count=count, grid=(12, 16))
        log = log_for(frames)
        tracemalloc.start()
        for _ in compute_factors(frames, log, *PANELS["uneven"], open_ns=0, close_ns=close_ns(log)):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]
