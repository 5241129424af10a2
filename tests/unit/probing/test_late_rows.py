"""Rows that are set one after the other, and light that is blurred on the mask: the realised matrix
against pairs of pixels that are followed one by one."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from pdcd.bench.tables import PanelConfig
from pdcd.codes.make import make_codes
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.placing import Placing
from pdcd.panels.schedule import build_frames
from pdcd.probing.panel import PanelOptics, offset_cells
from pdcd.probing.realised import Factors, collect_factors, compute_bench_factors
from pdcd.probing.spans import ALL_AT_ONCE, band_delays_ns, split_into_bands
from tests import bench_rig, oracles
from tests.frame_logs import make_log
from tests.sampled import sampled

Floats = NDArray[np.float64]

GRID = (3, 2)
FINE = 4
PROJECTOR = PanelConfig(size_px=(8, 12), rise_s=0.0017, fall_s=0.0023, contrast=300.0)
MASK = PanelConfig(size_px=(10, 18), rise_s=0.004, fall_s=0.007, contrast=90.0, skew_s=0.0031)


def exposure(window: str) -> tuple[Frames, FrameLog, int]:
    shape = Lattice(GRID, window).shape
    codes = make_codes("bernoulli", shape, 2, dual="complement", seed=1)
    frames = build_frames(bench_rig.pairs(codes), GRID, window=window, schedule="lag", passes=1)
    log = make_log(len(frames), start_ns=9_000_000, late_ns=700_000)
    return frames, log, int(log.end_ns[0]) + 90_000_000


@dataclass(frozen=True)
class Dense:
    """Times in s of pairs of fine pixels, (mask, projector), and open times of the mask's."""

    pairs: Floats
    window: str

    def means(self) -> tuple[Floats, Floats]:
        return oracles.to_cells(self.pairs, GRID, FINE)


def followed(projector: PanelConfig, mask: PanelConfig, window: str) -> Dense:
    """All pairs of pixels, those that come equally late together."""
    frames, log, close_ns = exposure(window)
    offset = offset_cells(projector, mask, GRID)
    delays = [
        pixel_delays(panel, window, mask=side, offset=offset)
        for panel, side in ((projector, False), (mask, True))
    ]
    out = np.zeros((delays[1].size, delays[0].size))
    optics = [PanelOptics.from_config(panel) for panel in (projector, mask)]
    lines = [
        {
            int(delay): oracles.timeline(
                frames,
                log,
                PanelOptics(0.0, 0.0, 0.0, optics[side].skew_ns + int(delay)),
                0,
                side == 0,
                FINE,
                offset if side else (0.0, 0.0),
            )
            for delay in np.unique(delays[side])
        }
        for side in (0, 1)
    ]
    for p_delay, lit in lines[0].items():
        for m_delay, seen in lines[1].items():
            own = np.ix_(delays[1] == m_delay, delays[0] == p_delay)
            lit_part = oracles.Timeline(lit.start_s, lit.on[:, delays[0] == p_delay])
            seen_part = oracles.Timeline(seen.start_s, seen.on[:, delays[1] == m_delay])
            out[own] = oracles.pair_integrals(
                lit_part, seen_part, optics[0], optics[1], close_ns * 1e-9
            )
    return Dense(out, window)


def pixel_delays(
    panel: PanelConfig, window: str, *, mask: bool, offset: tuple[float, float]
) -> NDArray[np.int64]:
    """By how much each fine pixel is late, in ns: by the row of the panel under the middle of the
    window, or of the lit half, that the pixel lies in."""
    rows, cols = GRID
    out = np.zeros((rows * FINE, cols * FINE), np.int64)
    for y in range(rows * FINE):
        for x in range(cols * FINE):
            at = [(y + 0.5) / FINE, (x + 0.5) / FINE]
            if mask:
                at = [place + by for place, by in zip(at, offset, strict=True)]
            middle = [_middle(place, window, mask=mask) for place in at]
            out[y, x] = _delay_ns(panel, middle[0] / rows, middle[1] / cols)
    return out.ravel()


def _middle(place: float, window: str, *, mask: bool) -> float:
    cell = np.floor(place)
    if window == "whole":
        return float(cell + 0.5)
    if not mask:
        return float(np.floor(2.0 * place) / 2.0 + 0.25)
    return float(cell + 0.5 if 0.25 <= place - cell < 0.75 else np.round(place))


def _delay_ns(panel: PanelConfig, down: float, right: float) -> int:
    if panel.scan_s == 0.0:
        return 0
    height = panel.size_px[1]
    along = {0.0: down, 180.0: 1.0 - down}[panel.place.turn_deg]
    row = min(max(int(np.floor(along * height + 1e-12)), 0), height - 1)
    bands = min(panel.scan_bands, height)
    band = row * bands // height
    late = band if panel.scan_s > 0 else bands - 1 - band
    return round(1e9 * abs(panel.scan_s) * late / (bands - 1))


def realised(
    projector: PanelConfig, mask: PanelConfig, window: str, *, fine: bool = False
) -> Factors:
    frames, log, close_ns = exposure(window)
    return collect_factors(
        compute_bench_factors(frames, log, projector, mask, open_ns=0, close_ns=close_ns, fine=fine)
    )


def told(panel: PanelConfig, **more: object) -> PanelConfig:
    return msgspec.structs.replace(panel, **more)


SCANS: dict[str, tuple[dict[str, object], dict[str, object]]] = {
    "mask": ({}, {"scan_s": 0.0121, "scan_bands": 6}),
    "projector": ({"scan_s": 0.0087, "scan_bands": 4}, {}),
    "against": ({"scan_s": 0.0087, "scan_bands": 4}, {"scan_s": -0.0153, "scan_bands": 99}),
    "on its head": ({"scan_s": 0.0151}, {"scan_s": 0.0153, "place": Placing(turn_deg=180.0)}),
}


@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize("scans", sampled(list(SCANS), 2))
def test_rows_one_after_the_other(window: str, scans: str) -> None:
    projector, mask = (told(p, **s) for p, s in zip((PROJECTOR, MASK), SCANS[scans], strict=True))
    want, coaxial = followed(projector, mask, window).means()
    got = realised(projector, mask, window)
    assert np.abs(got.dense() - want).max() <= 1e-12 * want.max()
    assert np.abs(got.coaxial - coaxial).max() <= 1e-12 * want.max()
    at_once = realised(PROJECTOR, MASK, window)
    assert np.abs(got.coaxial - at_once.coaxial).max() > 0.01 * want.max()
    np.testing.assert_allclose(got.open_s, at_once.open_s, rtol=1e-3)


def test_a_panel_on_its_side_is_late_by_columns() -> None:
    mask = told(MASK, scan_s=0.01, place=Placing(turn_deg=90.0))
    bands = split_into_bands(mask, PROJECTOR, Lattice(GRID, "whole"), mask=True)
    delays = np.empty(7, np.int64)
    for band in bands:
        delays[band.pixels] = band.delay_ns
    by_cell = delays[:6].reshape(GRID)
    assert (by_cell == by_cell[0]).all()
    assert by_cell[0, 0] > by_cell[0, 1]  # turned clockwise, its upper rows are at the right


def test_panels_that_are_set_at_once_have_one_band() -> None:
    """Then nothing is done that was not done before."""
    for panel in (PROJECTOR, told(MASK, scan_s=0.01, scan_bands=1)):
        assert split_into_bands(panel, PROJECTOR, Lattice(GRID), mask=False) is ALL_AT_ONCE
    np.testing.assert_array_equal(band_delays_ns(0.01, 3), [0, 5_000_000, 10_000_000])
    np.testing.assert_array_equal(band_delays_ns(-0.01, 3), [10_000_000, 5_000_000, 0])


@pytest.mark.parametrize(
    ("window", "sigma_px", "scan_s"),
    [("whole", 0.31, 0.0), ("quarter", 1.7, 0.0), ("quarter", 0.31, -0.0133)],
)
def test_light_that_is_blurred_on_the_mask(window: str, sigma_px: float, scan_s: float) -> None:
    """A cell is 4 projector pixels; the larger blur reaches over it."""
    mask = told(MASK, blur_px=sigma_px, scan_s=scan_s, offset_px=(1.0, 0.0))
    dense = followed(PROJECTOR, mask, window)
    want = blurred(dense, sigma_px / 4.0)
    got = realised(PROJECTOR, mask, window)
    assert np.abs(got.coaxial - want).max() <= 1e-12 * want.max()
    sharp = realised(PROJECTOR, told(mask, blur_px=0.0), window)
    np.testing.assert_array_equal(got.dense(), sharp.dense())
    assert np.abs(got.coaxial - sharp.coaxial).max() > 1e-3 * want.max()


def blurred(dense: Dense, sigma: float) -> Floats:
    """Mean over each cell of the time for which points are lit by light that came from a Gaussian
    around them, and seen."""
    rows, cols = GRID
    down, right = (_overlaps(n * FINE, sigma) for n in GRID)
    side = (rows * FINE, cols * FINE)
    pairs = dense.pairs.reshape(*side, *side)
    seen = np.einsum("abcd,ac,bd->ab", pairs, down, right) * FINE**2
    cells = seen.reshape(rows, FINE, cols, FINE).mean(axis=(1, 3))
    return np.asarray(cells.ravel())


def _overlaps(count: int, sigma: float) -> Floats:
    """Integral over x in pixel a and y in pixel b of the Gaussian of x - y, by quadrature."""
    width = 1.0 / FINE

    def one(apart: int) -> float:
        low = apart * width

        def inner(x: Floats) -> Floats:
            return np.asarray(ndtr((x - low) / sigma) - ndtr((x - low - width) / sigma))

        nodes, weights = np.polynomial.legendre.leggauss(24)
        pieces = (np.arange(16) + 0.5) * width / 16
        x = pieces[:, None] + nodes * width / 32
        return float(np.sum(inner(x) * weights) * width / 32)

    found = {k: one(k) for k in range(count)}
    return np.array([[found[abs(a - b)] for b in range(count)] for a in range(count)])


@pytest.mark.parametrize(
    "more", [{"scan_s": -0.012}, {"blur_px": 0.8}, {"scan_s": 0.01, "blur_px": 0.3}]
)
def test_parts_of_cells_add_up_to_cells(more: dict[str, float]) -> None:
    mask = told(MASK, offset_px=(0.7, -0.9), **more)
    projector = told(PROJECTOR, scan_s=0.005)
    got = realised(projector, mask, "quarter", fine=True)
    assert got.fine is not None
    areas = np.multiply.outer(*(np.diff(cuts) for cuts in got.fine.cuts))
    shape = GRID[0], areas.shape[0], GRID[1], areas.shape[1]
    for part, whole in (
        (got.fine.coaxial, got.coaxial),
        (got.fine.light, got.dense().sum(axis=1)),
        (got.fine.own, np.diag(got.dense())),
    ):
        mean = np.einsum("iajb,ab->ij", part.reshape(shape), areas).ravel()
        np.testing.assert_allclose(mean, whole, rtol=1e-12)
