"""Stripes on both panels at once: each panel is the other's ruler.

The projector shows stripes of a period of P pixels; the mask shows the same stripes where its map
says that they fall, moved by 0, P/S, 2 P/S ... from photo to photo. How much light comes through
shows where light and mask really meet (`pdcd.calibration.registration.offsets`).

The mask's pixels are a lattice that beats with the stripes. So each photo lasts several refreshes,
in which the stripes move over one pixel of the mask: its pixels at the stripes' edges become grey
on average. The projector is lit only while the mask already shows stripes, and the round of moves
starts and ends at its middle: so slow panels shift no edge.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats
from pdcd.calibration.shown import Bits, PanelSequence
from pdcd.errors import CalibrationError
from pdcd.panels.frames import BLACK
from pdcd.panels.map import Map, map_between

MOVES = 8
"""Positions within one pixel of the mask that the stripes take in a photo."""
_GUARD = 2
"""Refreshes with a dark projector before and after: the mask has settled, and is not yet black."""


@dataclass(frozen=True)
class StripePlan:
    """One series of photos.

    axis : 0, upright stripes, which measure to the right; 1, lying ones, which measure down.
    period_px : even number of projector pixels, so that half a period is whole pixels.
    steps : photos, S, 4 or more.
    """

    axis: int
    period_px: int
    steps: int = 8

    @property
    def name(self) -> str:
        """ "right-16" or "down-16"."""
        return f"{('right', 'down')[self.axis]}-{self.period_px}"

    @property
    def order(self) -> tuple[int, ...]:
        """The step that each photo shows. They are not in sequence: so if the bench moves during
        the series, a residual is left that no stripes explain."""
        golden = np.arange(self.steps) * 0.5 * (np.sqrt(5.0) - 1.0)
        return tuple(np.argsort(golden % 1.0).tolist())


RULER = (StripePlan(0, 16), StripePlan(1, 16))
"""Stripes by which the offset is measured."""
FINE = (StripePlan(0, 6, 6), StripePlan(1, 6, 6))
"""Stripes that give blur, together with `RULER`; that measure up to 9 px from the edges of the
field; and that reveal offsets of more than half a period: 16 and 6 px coincide again only 48 px
on."""
_COARSER = (
    (1.3, (RULER, FINE)),
    (2.3, (RULER, (StripePlan(0, 10, 6), StripePlan(1, 10, 6)))),
    (
        np.inf,
        ((StripePlan(0, 32), StripePlan(1, 32)), (StripePlan(0, 14, 6), StripePlan(1, 14, 6))),
    ),
)
"""Stripes of both periods for masks whose pixels are up to so many projector pixels wide: such a
mask hardly shows finer ones. 16 and 10 px coincide again 80 px on, 32 and 14 px 224 px on."""


def choose_stripe_periods(
    mask_px: float,
) -> tuple[tuple[StripePlan, StripePlan], tuple[StripePlan, StripePlan]]:
    """The coarse and the fine stripes for a mask whose pixels are `mask_px` projector pixels
    wide."""
    return next(pairs for widest, pairs in _COARSER if mask_px <= widest)


def make_stripe_sequences(
    stripes: StripePlan, projector: Map, mask: Map, refreshes: int = MOVES
) -> Iterator[PanelSequence]:
    """The S photos of a series in the order in which to take them, 8 patterns of the mask each.

    projector, mask : maps in use.
    refreshes : for which the projector is lit in each photo, a multiple of 8.

    Raises CalibrationError where the mask's map leads nowhere on the projector.
    """
    if refreshes < MOVES or refreshes % MOVES:
        raise ValueError(f"{refreshes} refreshes are no whole rounds of {MOVES} moves")
    places, move = _places(stripes.axis, projector, mask)
    lit = _projector_stripes(stripes, projector.size_px)[None]
    rounds = np.tile(np.arange(MOVES, dtype=np.int32), refreshes // MOVES)
    around = np.full(_GUARD, MOVES - 1, dtype=np.int32)
    mask_index = np.concatenate([around, rounds, around])
    projector_index = np.zeros(mask_index.size, dtype=np.int32)
    projector_index[:_GUARD] = projector_index[-_GUARD:] = BLACK
    for step in stripes.order:
        moved: Floats = places - stripes.period_px * step / stripes.steps
        opened = np.stack([_lit(moved + at * move, stripes.period_px) for at in _moves_px()])
        yield PanelSequence(f"{stripes.name}-{step}", lit, opened, projector_index, mask_index)


def _projector_stripes(stripes: StripePlan, size_px: tuple[int, int]) -> Bits:
    """What the projector shows, (height, width) bool: the first half of each period is lit."""
    width, height = size_px
    centres = np.arange((width, height)[stripes.axis], dtype=np.float64) + 0.5
    lit = _lit(centres, stripes.period_px)
    return np.broadcast_to(lit if stripes.axis == 0 else lit[:, None], (height, width)).copy()


def _moves_px() -> Floats:
    """By how many of its pixels the mask's stripes are moved in each refresh of a round: forward
    through one pixel, from its middle to its middle."""
    spread: Floats = (np.arange(MOVES) + 0.5) / MOVES - 0.5
    return np.roll(spread, -(MOVES // 2))


def compute_pixel_attenuation(stripes: StripePlan, slope: Floats, harmonic: int = 1) -> Floats:
    """How much the mask's pixels leave of a harmonic of the stripes, (n,), 0 to 1.

    slope : (n, 2), how the place along the stripes' axis, in projector pixels, changes per pixel of
        the mask to the right, and down.

    A pixel has one value over its area (a sinc for each of its sides), and the moves take it to 8
    places along one side.
    """
    cycles = np.abs(slope) * harmonic / stripes.period_px
    along = _along(slope)
    each = np.take_along_axis(cycles, np.full((len(cycles), 1), along), axis=1)[:, 0] / MOVES
    moving = np.sin(np.pi * MOVES * each) / (MOVES * np.sin(np.pi * each))
    return np.asarray(np.sinc(cycles).prod(axis=1) * moving)


def _places(axis: int, projector: Map, mask: Map) -> tuple[Floats, Floats]:
    """For the centre of each mask pixel, (height, width): its place along the axis of the
    projector, and how much that grows over one pixel of the mask."""
    wanted = projector.from_field(mask.centres())[..., axis]
    if not np.isfinite(wanted).any():
        raise CalibrationError(
            "the mask's map leads nowhere on the projector",
            device="mask",
            hint="calibrate the geometry first",
        )
    down, right = (np.asarray(way, dtype=np.float64) for way in np.gradient(wanted))
    slope = np.array([[np.nanmedian(right), np.nanmedian(down)]])
    return wanted, (right, down)[_along(slope)]


def _along(slope: Floats) -> int:
    """The side of the mask's pixels along which stripes move: the one that crosses them most."""
    return int(np.argmax(np.abs(slope).mean(axis=0)))


def _lit(places: Floats, period_px: int) -> Bits:
    """Whether places in projector pixels lie on lit stripes; NaN does not."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.mod(places / period_px, 1.0) < 0.5)


def compute_map_slope(axis: int, projector: Map, mask: Map, points_px: Floats) -> Floats:
    """How the place along an axis of the projector changes per pixel of the mask to the right and
    down, (n, 2), at points (n, 2) of the mask."""
    half = 0.5
    ways = []
    for side in (0, 1):
        step = np.zeros(2)
        step[side] = half
        ends = (map_between(mask, projector, points_px + sign * step) for sign in (1.0, -1.0))
        first, second = ends
        ways.append((first - second)[:, axis])
    return np.stack(ways, axis=-1)
