"""How well light and mask meet, and how sharply: product stripes of both panels."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any

import numpy as np

from pdcd.bench.tables import Config
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.geometry.geometry_step import compute_pixel_ratio
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.preview import ArrowField, draw_arrows, draw_text_lines
from pdcd.calibration.registration.correction import (
    MapCorrection,
    correct_mask_map,
    fit_map_correction,
)
from pdcd.calibration.registration.mask_blur import MaskBlur, measure_mask_blur
from pdcd.calibration.registration.offsets import (
    MaskOffsets,
    StripeSeries,
    StripeSeriesBuilder,
    measure_mask_offsets,
)
from pdcd.calibration.registration.stripes import (
    MOVES,
    StripePlan,
    choose_stripe_periods,
    make_stripe_sequences,
)
from pdcd.calibration.script import (
    CalibrationPhoto,
    CalibrationSession,
    ConfigValue,
    PhotoRequest,
    StepOutcome,
    StepScript,
    UserPrompt,
    take_photo,
)
from pdcd.calibration.shown import make_still_sequence
from pdcd.calibration.window import find_shared_window
from pdcd.panels.frames import WHITE
from pdcd.panels.map import Map
from pdcd.probing.cell_size import (
    HALF,
    MaskAlignment,
    compute_bench_leak,
    format_cell_leaks,
    list_cell_leaks,
    smallest_cell_px,
)

_GOOD_PX, _BAD_PX = 0.15, 1.0
"""Remaining offset, which 95 % of the field stay below, that is good; and from which small cells
are no use."""
_MAP_PX = 0.06
"""Twice the largest error of the map, over 95 % of the field, that is good; else it is doubtful."""
_TRUSTED_PX = 4.0
"""Largest offset that the maps of the geometry step should have."""
_PARTS, _FEWEST_OFFSETS = (24, 18), 6
"""Parts of the field, across and down, whose mean offset is computed, and offsets that a part
needs."""
_RAYLEIGH_95 = 2.448
"""95th percentile of the lengths of vectors, over the standard deviation of either component."""
_UNEVEN, _UNEVEN_PX = 1.5, 0.5
"""Blur of the worst part of the field, over that of all of it and in projector pixels, from which
focusing again is advised; smaller blur cannot be measured part by part."""


def calibrate_registration(session: CalibrationSession) -> StepScript:
    """White, 16 photos of stripes of 16 px, and 12 of stripes of 6 px, or wider ones for a coarse
    mask. The offset of the mask's map is measured, corrected, and measured again; then the
    remaining offset is corrected, too."""
    camera, projector, mask = (session.found(name) for name in ("camera", "projector", "mask"))
    lit = max(MOVES, session.full // MOVES * MOVES)
    taken = yield from take_photo(
        PhotoRequest(session.in_step(make_still_sequence("white", lit, WHITE, WHITE)))
    )
    white = session.photo(taken)
    ruler, finest = choose_stripe_periods(1.0 / compute_pixel_ratio(mask, projector))
    coarse = yield from _both(session, ruler, white, camera, projector, mask, lit)
    before = measure_mask_offsets(*coarse, camera, mask)
    first = fit_map_correction(before, mask)
    near = correct_mask_map(mask, projector, first)
    fine = yield from _both(session, finest, white, camera, projector, near, lit, placed=True)
    after = measure_mask_offsets(*fine, camera, near, corrected=True)
    correction = fit_map_correction(after, near)
    found = correct_mask_map(near, projector, correction)
    spread = measure_mask_blur(coarse, fine, camera, projector, mask)
    error = _error_px(correction, after)
    meeting = MaskAlignment(
        _left_px(correction, after, error),
        spread.both_px,
        1.0 / compute_pixel_ratio(found, projector),
    )
    return StepOutcome(
        figures=(*_figures(session.on_field, before, error, spread, meeting), *_leaks(meeting)),
        words={
            "mask.place.map": ConfigValue("maps.npz"),
            "mask.offset_px": ConfigValue((0.0, 0.0)),
            "mask.blur_px": ConfigValue(spread.both_px, spread.both_sigma_px),
            "rig.misregistration_px": ConfigValue(meeting.e95_px, error),
        },
        maps={"mask": found},
        advice=_advice(session.on_field, before, spread, meeting),
        picture=lambda figure: _draw(
            figure, (before, first), (after, correction), meeting, mask.size_px
        ),
    )


def code_cell_px(config: Config) -> float:
    """Side of the code's cells in projector pixels, along the side that has the smaller ones."""
    rows, cols = config.code_grid()
    width, height = config.projector.field_size_px
    return min(width / cols, height / rows)


def _both(
    session: CalibrationSession,
    pair: Sequence[StripePlan],
    white: QuadPhoto,
    camera: Map,
    projector: Map,
    mask: Map,
    lit: int,
    *,
    placed: bool = False,
) -> Generator[
    PhotoRequest | UserPrompt, CalibrationPhoto | None, tuple[StripeSeries, StripeSeries]
]:
    """Series of upright and of lying stripes. placed : see `StripeSeriesBuilder.series`."""
    found, window = [], find_shared_window(mask, camera)
    for stripes in pair:
        gathering = StripeSeriesBuilder(stripes, white, camera, projector, window=window)
        for shown in make_stripe_sequences(stripes, projector, mask, lit):
            taken = yield from take_photo(PhotoRequest(session.in_step(shown)))
            gathering.add(session.photo(taken))
        found.append(gathering.series(placed=placed))
    return found[0], found[1]


def _error_px(correction: MapCorrection, after: MaskOffsets) -> float:
    """The 95th percentile of the corrected map's standard deviation."""
    sigma = correction.sigma_at(after.points_px)
    return float(np.quantile(sigma.max(axis=-1), 0.95))


def _left_px(correction: MapCorrection, after: MaskOffsets, error_px: float) -> float:
    """Offset that 95 % of the field stay below after the correction: by its own error, and by what
    it is too smooth to follow. Noise makes single offsets scatter much more; means over small parts
    of the field do not."""
    points, size = after.points_px, np.array(correction.size_px)
    good = np.isfinite(points).all(axis=-1) & np.isfinite(after.offset_px).all(axis=-1)
    column, row = np.clip(
        (points[good] / size * _PARTS).astype(np.int64), 0, np.array(_PARTS) - 1
    ).T
    part = row * _PARTS[0] + column
    count = np.bincount(part, minlength=_PARTS[0] * _PARTS[1]).astype(np.float64)
    many = count >= _FEWEST_OFFSETS
    unlike = 0.0
    for left in correction.left_px.T:
        mean, square = (
            np.bincount(part, values, minlength=count.size)[many] / count[many]
            for values in (left, left**2)
        )
        noise = (square - mean**2) / (count[many] - 1.0)
        if many.any():
            unlike = max(unlike, float(np.mean(mean**2 - noise)))
    return _RAYLEIGH_95 * float(np.hypot(error_px, np.sqrt(unlike)))


def _figures(
    config: Config, before: MaskOffsets, error_px: float, spread: MaskBlur, meeting: MaskAlignment
) -> list[MeasuredFigure]:
    """What was found, and what it means for cells."""
    e95, cell = meeting.e95_px, code_cell_px(config)
    left = Verdict.GOOD if e95 <= _GOOD_PX else Verdict.DOUBTFUL if e95 <= _BAD_PX else Verdict.BAD
    smallest = smallest_cell_px(meeting)
    enough = Verdict.GOOD if smallest <= cell else Verdict.DOUBTFUL
    share = float(compute_bench_leak(meeting, smallest, HALF)) if smallest > 0.0 else 0.0
    return [
        MeasuredFigure(
            "mask.offset_px", before.e95_px, error_px, "px", f"at most {_TRUSTED_PX:g} px",
            Verdict.GOOD if before.e95_px <= _TRUSTED_PX else Verdict.DOUBTFUL,
        ),
        MeasuredFigure("rig.misregistration_px", e95, error_px, "px", f"at most {_GOOD_PX:g} px",
        left),
        MeasuredFigure(
            "mask.map_px", error_px, 0.0, "px", f"at most {_MAP_PX / 2.0:g} px",
            Verdict.GOOD if error_px <= _MAP_PX / 2.0 else Verdict.DOUBTFUL,
        ),
        MeasuredFigure("mask.blur_px", spread.both_px, spread.both_sigma_px, "px"),
        MeasuredFigure("mask.blur_worst_px", spread.worst_px, 0.0, "px"),
        MeasuredFigure("smallest_cell_px", smallest, 0.0, "px", f"at most {cell:.3g} px", enough),
        MeasuredFigure("smallest_cell_leak", share, 0.0, ""),
    ]  # fmt: skip


def _leaks(meeting: MaskAlignment) -> list[MeasuredFigure]:
    """What cells of some sizes leak with quarter windows."""
    return [
        MeasuredFigure(f"leak_{row.cell_px:g}px", row.half, 0.0, "")
        for row in list_cell_leaks(meeting)
    ]


def _advice(
    config: Config, before: MaskOffsets, spread: MaskBlur, meeting: MaskAlignment
) -> tuple[str, ...]:
    said = []
    if before.e95_px > _TRUSTED_PX:
        said.append(
            "the maps of the geometry step were far off: repeat geometry, then registration"
        )
    if meeting.e95_px > _GOOD_PX:
        said.append("the offset moves while it is measured: let the bench warm up, and repeat")
    if spread.worst_px > max(_UNEVEN * spread.both_px, _UNEVEN_PX):
        said.append(
            f"blur on the mask is {spread.worst_px:.2f} px in one part of the field, "
            f"{spread.both_px:.2f} px over all of it: check whether the mask or the card is tilted"
        )
    smallest = smallest_cell_px(meeting)
    if smallest > code_cell_px(config):
        said.append(
            f"cells of {code_cell_px(config):.3g} px are too small for this bench, which needs "
            f"{smallest:.1f} px with quarter windows: use a coarser grid, or focus better"
        )
    return tuple(said)


def _draw(
    figure: Any,
    before: tuple[MaskOffsets, MapCorrection],
    after: tuple[MaskOffsets, MapCorrection],
    meeting: MaskAlignment,
    size_px: tuple[int, int],
) -> None:
    """Offsets of geometry's map and of the map once corrected, and what cells leak.

    The smooth offset that was fitted to each series is drawn. Single offsets of short stripes,
    which have two quads per period in the camera, scatter by ten times the map's error.
    """
    size = np.array(size_px, dtype=np.float64)
    fields = [
        ArrowField(
            found.points_px / size,
            smooth.at(found.points_px),
            f"offset of the mask's map, {title}",
        )
        for title, (found, smooth) in (("by geometry", before), ("corrected once", after))
    ]
    draw_arrows(figure, fields, text_below=True)
    draw_text_lines(figure, format_cell_leaks(meeting))
