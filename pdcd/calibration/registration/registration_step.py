"""Where light and mask really meet, and how sharp: product stripes of both panels."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any

import numpy as np

from pdcd.bench.tables import Config
from pdcd.calibration.figures import Figure, Verdict
from pdcd.calibration.geometry.geometry_step import finer
from pdcd.calibration.photo import Photo
from pdcd.calibration.preview import draw_arrows, write_lines
from pdcd.calibration.registration.correction import Correction, corrected, fitted
from pdcd.calibration.registration.mask_blur import MaskBlur, blur
from pdcd.calibration.registration.offsets import Gathering, Offsets, Series, offsets
from pdcd.calibration.registration.stripes import MOVES, Stripes, patterns, periods_for
from pdcd.calibration.script import (
    Ask,
    Measured,
    Outcome,
    Script,
    Session,
    Taken,
    Wanted,
    take,
)
from pdcd.calibration.shown import still
from pdcd.calibration.window import shared
from pdcd.panels.frames import WHITE
from pdcd.panels.map import Map
from pdcd.probing.cell_size import (
    HALF,
    Meeting,
    leak_of,
    printed,
    smallest_cell_px,
    table,
)

GOOD_PX, BAD_PX = 0.15, 1.0
"""Offset that is left of 95 % of the field: good, and such that no small cell is of use."""
MAP_PX = 0.06
"""95 % of the field are known at least so well, or the map is doubtful."""
TRUSTED_PX = 4.0
"""Offsets that the maps of geometry should not leave."""
PARTS, FEWEST_OFFSETS = (24, 18), 6
"""Parts of the field across and down whose mean offset is looked at, and offsets in such a part."""
RAYLEIGH_95 = 2.448
"""Length that 95 % of vectors stay below, over the standard deviation of either part."""
UNEVEN, UNEVEN_PX = 1.5, 0.5
"""Blur of the worst part of the field over that of all of it, and in projector pixels, that asks
for another focus; less blur is not told part by part."""


def registration(session: Session) -> Script:
    """White, 16 photos of stripes of 16 px, and 12 of stripes of 6 px, or wider ones for a coarse
    mask: the offset of the mask's map is measured, taken out, and measured again; then what is left
    is taken out, too."""
    camera, projector, mask = (session.found(name) for name in ("camera", "projector", "mask"))
    lit = max(MOVES, session.full // MOVES * MOVES)
    taken = yield from take(Wanted(session.in_step(still("white", lit, WHITE, WHITE))))
    white = session.photo(taken)
    ruler, finest = periods_for(1.0 / finer(mask, projector))
    coarse = yield from _both(session, ruler, white, camera, projector, mask, lit)
    before = offsets(*coarse, camera, mask)
    first = fitted(before, mask)
    near = corrected(mask, projector, first)
    fine = yield from _both(session, finest, white, camera, projector, near, lit, placed=True)
    after = offsets(*fine, camera, near, corrected=True)
    correction = fitted(after, near)
    found = corrected(near, projector, correction)
    spread = blur(coarse, fine, camera, projector, mask)
    error = _error_px(correction, after)
    meeting = Meeting(
        _left_px(correction, after, error), spread.both_px, 1.0 / finer(found, projector)
    )
    return Outcome(
        figures=(*_figures(session.on_field, before, error, spread, meeting), *_leaks(meeting)),
        words={
            "mask.place.map": Measured("maps.npz"),
            "mask.offset_px": Measured((0.0, 0.0)),
            "mask.blur_px": Measured(spread.both_px, spread.both_sigma_px),
            "rig.misregistration_px": Measured(meeting.e95_px, error),
        },
        maps={"mask": found},
        advice=_advice(session.on_field, before, spread, meeting),
        picture=lambda figure: _draw(
            figure, (before, first), (after, correction), meeting, mask.size_px
        ),
    )


def cell_px(config: Config) -> float:
    """Side of the code's cells in projector pixels, along the side that has the smaller ones."""
    rows, cols = config.code_grid()
    width, height = config.projector.field_size_px
    return min(width / cols, height / rows)


def _both(
    session: Session,
    pair: Sequence[Stripes],
    white: Photo,
    camera: Map,
    projector: Map,
    mask: Map,
    lit: int,
    *,
    placed: bool = False,
) -> Generator[Wanted | Ask, Taken | None, tuple[Series, Series]]:
    """Series of upright and of lying stripes. placed : see `Gathering.series`."""
    found, window = [], shared(mask, camera)
    for stripes in pair:
        gathering = Gathering(stripes, white, camera, projector, window=window)
        for shown in patterns(stripes, projector, mask, lit):
            taken = yield from take(Wanted(session.in_step(shown)))
            gathering.add(session.photo(taken))
        found.append(gathering.series(placed=placed))
    return found[0], found[1]


def _error_px(correction: Correction, after: Offsets) -> float:
    """Standard deviation of the corrected map, that 95 % of the places stay below."""
    sigma = correction.sigma_at(after.points_px)
    return float(np.quantile(sigma.max(axis=-1), 0.95))


def _left_px(correction: Correction, after: Offsets, error_px: float) -> float:
    """Offset that 95 % of the field stay below once the correction is made: by its own error, and
    by what it is too smooth to follow. Single offsets scatter much more, by noise; means over
    small parts of the field do not."""
    points, size = after.points_px, np.array(correction.size_px)
    good = np.isfinite(points).all(axis=-1) & np.isfinite(after.offset_px).all(axis=-1)
    column, row = np.clip((points[good] / size * PARTS).astype(np.int64), 0, np.array(PARTS) - 1).T
    part = row * PARTS[0] + column
    count = np.bincount(part, minlength=PARTS[0] * PARTS[1]).astype(np.float64)
    many = count >= FEWEST_OFFSETS
    unlike = 0.0
    for left in correction.left_px.T:
        mean, square = (
            np.bincount(part, values, minlength=count.size)[many] / count[many]
            for values in (left, left**2)
        )
        noise = (square - mean**2) / (count[many] - 1.0)
        if many.any():
            unlike = max(unlike, float(np.mean(mean**2 - noise)))
    return RAYLEIGH_95 * float(np.hypot(error_px, np.sqrt(unlike)))


def _figures(
    config: Config, before: Offsets, error_px: float, spread: MaskBlur, meeting: Meeting
) -> list[Figure]:
    """What was found, and what it means for cells."""
    e95, cell = meeting.e95_px, cell_px(config)
    left = Verdict.GOOD if e95 <= GOOD_PX else Verdict.DOUBTFUL if e95 <= BAD_PX else Verdict.BAD
    smallest = smallest_cell_px(meeting)
    enough = Verdict.GOOD if smallest <= cell else Verdict.DOUBTFUL
    share = float(leak_of(meeting, smallest, HALF)) if smallest > 0.0 else 0.0
    return [
        Figure(
            "mask.offset_px", before.e95_px, error_px, "px", f"at most {TRUSTED_PX:g} px",
            Verdict.GOOD if before.e95_px <= TRUSTED_PX else Verdict.DOUBTFUL,
        ),
        Figure("rig.misregistration_px", e95, error_px, "px", f"at most {GOOD_PX:g} px", left),
        Figure(
            "mask.map_px", error_px, 0.0, "px", f"at most {MAP_PX / 2.0:g} px",
            Verdict.GOOD if error_px <= MAP_PX / 2.0 else Verdict.DOUBTFUL,
        ),
        Figure("mask.blur_px", spread.both_px, spread.both_sigma_px, "px"),
        Figure("mask.blur_worst_px", spread.worst_px, 0.0, "px"),
        Figure("smallest_cell_px", smallest, 0.0, "px", f"at most {cell:.3g} px", enough),
        Figure("smallest_cell_leak", share, 0.0, ""),
    ]  # fmt: skip


def _leaks(meeting: Meeting) -> list[Figure]:
    """What cells of some sizes leak through half windows."""
    return [Figure(f"leak_{row.cell_px:g}px", row.half, 0.0, "") for row in table(meeting)]


def _advice(config: Config, before: Offsets, spread: MaskBlur, meeting: Meeting) -> tuple[str, ...]:
    said = []
    if before.e95_px > TRUSTED_PX:
        said.append("the maps of geometry were far off: repeat geometry, then registration")
    if meeting.e95_px > GOOD_PX:
        said.append("the offset moves while it is measured: let the bench warm up, and repeat")
    if spread.worst_px > max(UNEVEN * spread.both_px, UNEVEN_PX):
        said.append(
            f"blur on the mask is {spread.worst_px:.2f} px in one part of the field, "
            f"{spread.both_px:.2f} px over all of it: look whether the mask or the card is tilted"
        )
    smallest = smallest_cell_px(meeting)
    if smallest > cell_px(config):
        said.append(
            f"cells of {cell_px(config):.3g} px are too small for this bench, which needs "
            f"{smallest:.1f} px with half windows: use a coarser grid, or focus better"
        )
    return tuple(said)


def _draw(
    figure: Any,
    before: tuple[Offsets, Correction],
    after: tuple[Offsets, Correction],
    meeting: Meeting,
    size_px: tuple[int, int],
) -> None:
    """Offsets of geometry's map and of the map once corrected, and what cells leak.

    Drawn is the smooth offset that each series found: single ones of short stripes, of which a
    camera has two quads a period, scatter by ten times what is wrong with the map.
    """
    size = np.array(size_px, dtype=np.float64)
    for axes, (title, (found, smooth)) in zip(
        figure.subplots(1, 2), (("by geometry", before), ("corrected once", after)), strict=True
    ):
        title = f"offset of the mask's map, {title}"
        draw_arrows(axes, found.points_px / size, smooth.at(found.points_px), title)
    write_lines(figure, printed(meeting))
