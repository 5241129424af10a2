"""From test exposures to the one aperture of a run; and a comparison of the light of two stops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.stops import STOP_SIGMA
from pdcd.panels.curve import compute_pattern_light
from pdcd.panels.patterns import make_empty_patterns
from pdcd.planning.plan import ShotSequence, is_long_range
from pdcd.recipes.programs import BlockProgram, SignedBlockProgram
from pdcd.recipes.recipe import Shot
from pdcd.sensor.cells import CellMap
from pdcd.sensor.profile import SensorProfile, compute_variance_dn2
from pdcd.sensor.raw import RawFrame

_MOST_TIMES = 4
"""Most times that it is shown: such a photo takes a few seconds."""
_PATCHES = 4
"""Parts of a frame along each side in which the light of two stops is compared."""
_MASKED_DN = 0.05
"""Standard deviation of a black level that is measured by a masked border of 100 000 samples."""

TARGET = 0.6
"""Where the brightest sample is to lie, as a share of saturation."""

USABLE = (0.02, 0.95)
"""A test exposure whose brightest sample lies outside is of little use: too dark, or clipped."""

_METER_PAIRS = 16
"""Pairs of patterns in a test exposure: enough that every cell has light in some."""

_METER_FAR = 8
"""With codes of far light, a test shows one code in so many, if that is more. Each lights few
cells. So a few codes may have far more light at some place, or less, than all of them: a photo of
512 codes came out at four tenths of its light."""

SEEN = 0.5
"""Light of a cell in a test exposure, over its fair share, below which it is not scaled up further:
sharp paths would be overestimated."""

MAX_TESTS = 6

_BRIGHTEST = 0.85
"""Where the brightest sample of a photo may lie that shares the stop of others. Its own test showed
the same light, so that it may come closer to saturation than one predicted from a few codes."""

_DIMMEST, _DIMMEST_SINGLE = 0.2, 0.05
"""Share of saturation that the brightest sample of a photo of codes must reach to share the stop of
the others, and the same for a photo of a single code: below it, read noise would matter."""


def choose_test_pairs(shot: ShotSequence) -> tuple[int, Floats]:
    """Number of pattern pairs in a test exposure, and how much more light the shot gathers in each
    cell: (rows, cols).

    Few codes open some cells more often than others. So the ratio of a cell is the time for which
    its mask was open while an average cell was lit, in the shot over that in the test. This is
    right for light from many cells. Cells that the test opened seldom gain at most 1 / `SEEN` times
    what others do, and their neighbours stand for the rest. Exact sequences are shown whole, as
    their first pairs are not like the others.
    """
    program, of_shot = shot.program, shot.count
    same = np.full(shot.grid, float(shot.passes))
    if program is not None and not program.coded:
        # Copies of a sequence differ by no more than the rounding of their levels.
        once = of_shot
        if isinstance(program, BlockProgram | SignedBlockProgram):
            once = len(program.camera) * (1 + isinstance(program, SignedBlockProgram))
        return (once, same * (of_shot // once)) if of_shot > once else (of_shot, same)
    pairs = _METER_PAIRS
    if program is not None and is_long_range(program):
        pairs = max(_METER_PAIRS, of_shot // _METER_FAR)
    if pairs >= of_shot:
        return of_shot, same
    whole, test = _open(shot, of_shot), _open(shot, pairs)
    least = np.maximum(test, SEEN * whole * pairs / of_shot)
    return pairs, same * np.divide(whole, least, out=np.zeros_like(whole), where=whole > 0.0)


def _open(shot: ShotSequence, pairs: int) -> Floats:
    """Pairs, each weighted by the lit share of all cells, in which a cell is open: (rows, cols)."""
    lattice = shot.lattice
    primal, dual = shot.pair or (make_empty_patterns(), make_empty_patterns())
    total = np.zeros(lattice.lattice_cells)
    for k in range(pairs):
        lit = float(compute_pattern_light(primal, k, total.size, shot.curves[0]).mean())
        total += lit * compute_pattern_light(dual, k, total.size, shot.curves[1])
    table = total.reshape(lattice.shape)
    if lattice.fields == 1:
        return table
    # Each quarter of a cell has a code cell of its own: this one, or its next down and right.
    rows = (table[:-1] + table[1:]) / 2.0
    return (rows[:, :-1] + rows[:, 1:]) / 2.0


def pick_leading_shot(planned: Sequence[Shot]) -> Shot:
    """The shot whose light sets the aperture of a run: the first of codes, whose time is fixed by
    their number; else the first of a single one, else the first."""
    shots = [shot for shot in planned if not shot.of_leaks]
    lit = [shot for shot in shots if not shot.white]
    codes = [shot for shot in lit if shot.only is None]
    return (codes or lit or shots or planned)[0]


def fit_white_slots(per_slot: float, planned: int) -> int:
    """Slots of a white shot at the stop of the codes, if each of them adds `per_slot` of saturation
    to the brightest sample: as many as are planned, or fit. A slot is on and off like that of a
    code, so that the panels' edges in time add or take the same share of either."""
    return max(1, min(planned, int(TARGET / max(per_slot, 1e-9) + 1e-6)))


def can_share_stop(shot: Shot, expected: float, slots: int) -> bool:
    """Whether a shot can be taken at the stop of the others, if its brightest sample is expected at
    that share of saturation; a white shot may use fewer of its `slots`."""
    if shot.white:
        return expected / slots <= _BRIGHTEST
    return (_DIMMEST if shot.only is None else _DIMMEST_SINGLE) <= expected <= _BRIGHTEST


def choose_next_aperture(
    apertures: tuple[float, ...], now: float, peak: float, expected: float
) -> tuple[float, bool]:
    """The aperture to use next, and whether the test exposure was good enough to trust it.

    Parameters
    ----------
    apertures : f-numbers that can be set.
    now : f-number of the test exposure.
    peak : its brightest sample as a share of saturation.
    expected : the brightest sample of the real exposure at that f-number, by the same measure.
    """
    if peak >= USABLE[1]:
        return pick_aperture(apertures, now * 4.0), now >= max(apertures)
    if peak < USABLE[0] and now > min(apertures):
        brighter = now * np.sqrt(max(peak, 1e-4) / 0.3)
        return pick_aperture(apertures, float(brighter)), False
    wanted = now * np.sqrt(max(expected, 1e-9) / TARGET)
    return pick_aperture(apertures, float(wanted)), True


def measure_peak_share(
    planes: NDArray[np.float32],
    saturated: NDArray[np.bool_],
    saturation_dn: float,
) -> float:
    """Brightest sample as a share of saturation; 1 when any is saturated."""
    if saturated.any():
        return 1.0
    return float(planes.max()) / saturation_dn


def predict_peak_share(
    planes: NDArray[np.float32], ratio: Floats, saturation_dn: float, cells: CellMap
) -> float:
    """Brightest sample of the real exposure, as a share of saturation; may be more than 1.

    Parameters
    ----------
    planes : (4, h, w), the test exposure in DN above black.
    ratio : (rows, cols) of `choose_test_pairs`.
    cells : which quads see which cell. What is outside the field does not count.
    """
    return float((planes * cells.spread(ratio.ravel())).max()) / saturation_dn


def pick_aperture(apertures: tuple[float, ...], f_number: float) -> float:
    """The widest aperture that is no wider than wanted; the narrowest there is otherwise."""
    return min((a for a in apertures if a >= f_number), default=max(apertures))


def count_stop_repeats(wider: float, narrower: float) -> int:
    """How often the narrower of two stops is shown what the wider one is shown once, to compare
    them: light grows with that number, and the black level limits the precision of a dim photo."""
    return min(_MOST_TIMES, max(1, round((narrower / wider) ** 2)))


def compare_stops(
    one: RawFrame, other: RawFrame, profile: SensorProfile, iso: int, exposure_s: float
) -> tuple[float, float] | None:
    """Light of a photo at one stop over that of another one, and its relative standard deviation;
    both show the same codes, each as often as it may. None where they have too little light to be
    more precise than the engraved numbers.

    Only quads that are saturated in neither count. Besides the noise of the samples, the black
    level of each photo is uncertain: by `_MASKED_DN` with a masked border, else by rounding to
    whole numbers. And a wide stop darkens corners that a narrow one does not: the differences
    between parts of the frame are added, too.
    """
    good = ~(one.saturated | other.saturated)
    light, squares = [], 0.0
    for raw in (one, other):
        planes = np.where(good, raw.planes.astype(np.float64), 0.0)
        total = float(planes.sum())
        noise = float(compute_variance_dn2(planes, profile, iso, exposure_s).sum())
        black_dn = _MASKED_DN if raw.masked else 12.0**-0.5
        square = noise + (black_dn * 4.0 * float(good.sum())) ** 2
        if not total > 0.0 or square > (STOP_SIGMA * total) ** 2:
            return None
        squares += square / total**2
        light.append(_of_patches(planes.sum(axis=0)))
    ratio = float(light[0].sum() / light[1].sum())
    lit = light[1] > 0.0
    away = light[0][lit] / light[1][lit] / ratio - 1.0
    spread = float(np.average(away**2, weights=light[1][lit]))
    return ratio, float(np.sqrt(squares + spread))


def _of_patches(light: Floats) -> Floats:
    """Sums over `_PATCHES` x `_PATCHES` parts of a frame."""
    parts = (np.array_split(row, _PATCHES, axis=1) for row in np.array_split(light, _PATCHES))
    return np.array([part.sum() for row in parts for part in row])
