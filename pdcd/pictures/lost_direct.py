"""Light that is lost where the mask lies elsewhere than believed, or where it gets blurred light.

Direct light then goes through the window of another cell: it is missing in pictures of direct light
and added to those of indirect light. Where a camera sees a place beside the mask's picture, no
light comes at all. Both follow from photos of blocks (`pdcd.pictures.misplaced`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import ArrayLike

from pdcd.arrays import Bools, Floats
from pdcd.bench.placed import place_panels
from pdcd.bench.tables import PanelConfig
from pdcd.panels.map import find_pixels_on
from pdcd.panels.windows import WindowKind, find_window_kind
from pdcd.pictures.misplaced import (
    compute_shifts_px,
    field_shifts_px,
    interpolate_bend_px,
    known_shift_px,
    make_affine_map,
    mean_cell_px,
    measure_misplacement,
    quad_px,
)
from pdcd.probing.cell_size import compute_leak, compute_leak_rms, compute_own_share
from pdcd.runs.record import PanelLook, RunRecord, Six
from pdcd.sensor.cells import CellMap

_SURE_PX = 0.1
"""Error of the place of blocks, in projector pixels, or in quads where these are larger."""
_SIGMAS = 3.0
"""Standard deviations by which the place found by a look may be off."""
_LEAST_APART = 1e-4
"""Least error, as a share of direct light, that is added to error bars: less is not visible."""
_LEAST_KEPT = 0.5
"""Share of direct light that must go through its own cells for the photos to measure it."""
_UNSURE_QUADS = 1.0
"""Standard deviation of the place in a window that a quad sees, in quads."""
_IN_QUAD = 4, 24
"""Least and most points along either side of a quad over which its light is averaged; a narrower
blur needs more."""
_EDGE_PX, _EDGE_QUADS = 0.5, 0.25
"""How far a quad may reach beyond the mask's edge, in projector pixels or in quads: the edge is
located to a third of either, and such a quad still gets most of its light."""


@dataclass(frozen=True)
class LostDirectLight:
    """Direct light that goes through wrong cells, over all of it: the mean over the field, and the
    root of the mean square over the camera's quads. Photos of indirect light contain it, in units
    of the weight of indirect light."""

    mean: float = 0.0
    rms: float = 0.0


def estimate_lost_direct(
    record: RunRecord, window: str, *, blurred: bool = True
) -> LostDirectLight:
    """What is lost through such windows because the mask lies elsewhere, and because of a blur
    beyond the known one if `blurred`. Nothing is lost where no look was taken, or it failed."""
    look = record.panels
    if look is None or look.mask is None:
        return LostDirectLight()
    size_px = record.projector.field_size_px
    if measure_misplacement(look.mask, size_px).flip != "none":
        return LostDirectLight(1.0, 1.0)
    offset = field_shifts_px(look.mask, size_px, known_shift_px(record.mask), look.bent_px)
    spread = _spread_px(record, look)
    if not blurred:
        spread = float(np.hypot(record.mask.blur_px, look.rest_px))
    found = _compute_lost(record, window, _sure(offset, record, look), spread)
    if not (blurred and look.border_px):
        return found
    lines = _compute_lost(record, window, np.zeros((1, 2)), blur_with_lines_px(record, look))
    return max(found, lines, key=lambda one: one.rms)


def estimate_unseen_loss(
    record: RunRecord, window: str, shift_px: float, blur_px: float
) -> LostDirectLight:
    """What would be lost through such windows by a shift across a corner, and by a blur."""
    off_px = np.full((1, 2), shift_px / np.sqrt(2.0))
    return _compute_lost(record, window, off_px, float(np.hypot(record.mask.blur_px, blur_px)))


def _compute_lost(
    record: RunRecord, window: str, offset_px: Floats, spread_px: float
) -> LostDirectLight:
    """What is lost beyond what is lost by the known blur alone. offset_px : (n, 2)."""
    side, cell = find_window_kind(window).side, mean_cell_px(record)
    (right, down), none = offset_px.T, np.zeros(1)
    known = (none, none), record.mask.blur_px
    mean = compute_leak(cell, side, (right, down), spread_px) - compute_leak(cell, side, *known)
    found, usual = (
        compute_leak_rms(cell, side, off, blurred, _quad_px(record))
        for off, blurred in (((right, down), spread_px), known)
    )
    square = np.mean(np.maximum(found**2 - usual**2, 0.0))
    return LostDirectLight(float(np.clip(mean.mean(), 0.0, 1.0)), float(np.sqrt(square)))


def estimate_misplaced_light(
    record: RunRecord, window: str, cells: CellMap, white: Floats, indirect: Floats
) -> Floats | None:
    """Direct light, (h, w, C), that got into a photo of indirect light through wrong cells; None
    where there is hardly any. It is added to the error bars.

    window : of the photo's shots. white, indirect : scaled pictures (h, w, C).
    """
    look, lost = record.panels, estimate_lost_direct(record, window)
    if look is None or look.mask is None or lost.rms < _LEAST_APART:
        return None
    if lost.mean > 1.0 - _LEAST_KEPT:  # the photos no longer measure how much direct light there is
        return np.asarray(lost.rms * look.direct * np.abs(white))
    share = estimate_lost_by_quad(record, look, look.mask, window, cells)[..., None]
    return np.asarray(share / np.maximum(1.0 - share, _LEAST_KEPT) * np.abs(white - indirect))


def estimate_lost_by_quad(
    record: RunRecord, look: PanelLook, mask: Six, window: str, cells: CellMap
) -> Floats:
    """What `estimate_lost_direct` is the mean of, at each quad (h, w). The loss lies along the
    edges of windows, where fine quads see it in full. mask : where the look found the mask's
    picture, which is not mirrored."""
    places = cells.centres * record.projector.field_size_px
    # The mask's picture lies further right and down by so much; light on it, further left and up.
    offset = -compute_shifts_px(mask, places, known_shift_px(record.mask))
    offset -= interpolate_bend_px(look, cells.centres)
    square = _compute_lost_squares(
        record, window, cells, places + offset, offset, _spread_px(record, look)
    )
    if look.border_px:
        none, lines_px = np.zeros_like(offset), blur_with_lines_px(record, look)
        lines = _compute_lost_squares(record, window, cells, places, none, lines_px)
        square = np.maximum(square, lines)
    smear = float(np.hypot(cells.blur_quads, _UNSURE_QUADS))
    beside = scipy.ndimage.gaussian_filter(square, smear)
    return np.asarray(np.sqrt(np.maximum(square, beside)))


def _compute_lost_squares(
    record: RunRecord,
    window: str,
    cells: CellMap,
    places: Floats,
    offset_px: Floats,
    spread_px: float,
) -> Floats:
    """Squares of what is lost beyond the loss by the known blur alone, (h, w). places, offset_px :
    where light falls on the mask, and by how much that is off, (h, w, 2)."""
    size_px = record.projector.field_size_px
    kind, cell = find_window_kind(window), mean_cell_px(record)
    pixel = quad_px(place_panels(record.projector, record.mask).mask.map, size_px)
    blur, spread = (
        float(np.hypot(px, np.hypot(1.0, pixel) / np.sqrt(12.0)))
        for px in (record.mask.blur_px, spread_px)
    )  # the edges of cells and windows lie at those of pixels
    along = int(np.clip(2.0 * _quad_px(record) / spread, *_IN_QUAD))
    of_quad = _quad_px(record) * ((np.arange(along) + 0.5) / along - 0.5)
    kept, usually_kept = np.ones(cells.frame), np.ones(cells.frame)
    for axis, count in enumerate(record.grid[::-1]):
        ats = places[..., axis] * (count * cell / size_px[axis]) + of_quad[:, None, None]
        off = offset_px[..., axis]
        kept *= _own(kind, cell, ats, off, spread).mean(axis=0)
        usually_kept *= _own(kind, cell, ats, 0.0, blur).mean(axis=0)
    return np.asarray(np.maximum((1.0 - kept) ** 2 - (1.0 - usually_kept) ** 2, 0.0))


def _own(
    kind: WindowKind, cell_px: float, at_px: Floats, offset_px: ArrayLike, blur_px: float
) -> Floats:
    """`compute_own_share` of places on the mask, over the windows that show them."""
    share, shown = np.zeros(at_px.shape), np.zeros(at_px.shape)
    for moved in (0.0, 0.5) if kind.shifted else (0.0,):
        place = (at_px / cell_px + moved) % 1.0
        opens = (place >= kind.guard) & (place <= 1.0 - kind.guard)
        share += np.where(
            opens, compute_own_share(cell_px, place * cell_px, offset_px, blur_px), 0.0
        )
        shown += opens
    return np.asarray(share / np.maximum(shown, 1.0))


def _quad_px(record: RunRecord) -> float:
    """Side of a quad in the middle of a run's frame, in projector pixels; 0 where it has no map."""
    if record.cells is None:
        return 0.0
    return quad_px(record.cells.filled, record.projector.field_size_px)


def _spread_px(record: RunRecord, look: PanelLook) -> float:
    """Blur on the mask, combined with the residual of a look's map."""
    return float(np.hypot(max(record.mask.blur_px, look.blur_px), look.rest_px))


def blur_with_lines_px(record: RunRecord, look: PanelLook) -> float:
    """Blur on the mask, the one that shows as lines along borders of cells included."""
    return float(np.hypot(record.mask.blur_px, look.border_px))


def finding_error_px(record: RunRecord) -> float:
    """Error of the place of blocks, in projector pixels."""
    return _SURE_PX * max(_quad_px(record), 1.0)


def measure_unseen_shift_px(record: RunRecord, look: PanelLook) -> float:
    """The longest shift of the mask that a look does not show."""
    return max(finding_error_px(record), _SIGMAS * look.sigma_px)


def _sure(off: Floats, record: RunRecord, look: PanelLook) -> Floats:
    """The part of offsets (..., 2) beyond the error of finding them, and beyond the noise of the
    look, which adds to them as squares do."""
    least_px, noise_px = finding_error_px(record), _SIGMAS * look.sigma_px
    length = np.hypot(off[..., 0], off[..., 1])
    beyond = np.sqrt(np.maximum(length**2 - noise_px**2, 0.0))
    share = np.minimum(beyond, np.maximum(length - least_px, 0.0)) / np.maximum(length, 1e-9)
    return np.asarray(off * share[..., None])


def find_quads_beside_mask(record: RunRecord, cells: CellMap) -> Bools | None:
    """Quads (h, w) that see a place beside the mask's picture, as photos of blocks located it: no
    light comes from there, whatever the scene has. None where no look was taken, or it failed.

    Callers: error bars, which are infinite there, and the verdict. cells : the map of the frame.
    """
    look = record.panels
    if look is None:
        return None
    return _find_beside(look, record.projector, record.mask, cells)


@lru_cache(maxsize=1)  # of a stream all pictures ask the same
def _find_beside(
    look: PanelLook, projector: PanelConfig, masking: PanelConfig, cells: CellMap
) -> Bools | None:
    if look.mask is None or look.camera is None or not look.upright:
        return None
    mask = place_panels(projector, masking).mask.map
    size_px = projector.field_size_px
    drawn = make_affine_map(look.mask).inverse().after(make_affine_map(look.camera))
    to_drawn = np.eye(3)
    to_drawn[:2, :2], to_drawn[:2, 2] = drawn.linear, drawn.shift
    scale = np.diag([*size_px, 1.0])
    seen = cells.filled.then(np.linalg.inv(scale) @ to_drawn @ scale)
    edge_px = max(_EDGE_QUADS * quad_px(cells.filled, size_px), _EDGE_PX)
    beside = ~find_pixels_on(seen, mask, -edge_px / quad_px(mask, size_px))
    found: Bools = beside & cells.known
    found.flags.writeable = False
    return found
