"""Whether both panels lie where they are believed to: out of photos of the same random blocks.

One photo shows blocks on the projector behind an open mask, one the same blocks on the mask before
a lit projector, each over a photo of all light. Through the mask the camera sees its blocks as they
are; of the projector's it sees those that direct light brings back. Where each quad sees which
place of the pattern follows from each (`pdcd.pictures.found_blocks`). What they differ by is how
far the mask lies from where it is believed to, whatever is believed of the camera; and what the
projector's differ from where the camera is believed to look is how far that is off.
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
from pdcd.panels.blocks import BlockPattern
from pdcd.panels.map import Map, find_pixels_on
from pdcd.panels.windows import WindowKind, find_window_kind
from pdcd.pictures.block_blur import measure_block_edges, measure_blur_before_mask
from pdcd.pictures.found_blocks import FEWEST, FLIPS, WINDOW_BLOCKS, FoundPattern, PatternFinder
from pdcd.pictures.raster import HERE, AffineMap, FieldRaster
from pdcd.probing.cell_size import compute_leak, compute_leak_rms, compute_own_share
from pdcd.runs.record import PanelLook, RunRecord, Six
from pdcd.sensor.cells import CellMap

_LIT = 0.03
"""Share of the bright quads' light in the photo of all light below which a quad tells nothing."""
_NOISE_PX = 0.5
"""Standard deviation of a window's place by which nothing is said of the mask, at least."""
_SURE_PX = 0.1
"""Error with which blocks are found, in projector pixels, or in quads where these are larger."""
_SIGMAS = 3.0
"""Standard deviations of its own that a look may be off by."""
_IN_PLACE = 4.0
"""Standard deviations from which a pattern's light comes from a place."""
_LEAST_IN_PLACE = 0.01
"""Share of all light that is enough of it."""
_AWAY = 8.0
"""Blocks between two places from which patterns have nothing in common, large blocks included."""
_EDGE_PX, _EDGE_QUADS = 0.5, 0.25
"""How far a quad may reach beyond the mask's edge, in projector pixels or of its side: an edge is
found to a third of either, and the quad has most of its light."""
_POINTS = 9
"""Places along either axis of the field at which the panels are compared."""
_LEAST_APART = 1e-4
"""Share of the field in which panels draw different cells below which nobody could see it."""
_LEAST_KEPT = 0.5
"""Share of direct light that must go through its own cells for the photos to tell how much there
is."""
_UNSURE_QUADS = 1.0
"""How unsure it is where in a window a quad looks."""
_IN_QUAD = 4
"""Places along either side of a quad at which its light comes from."""


@dataclass(frozen=True, eq=False)
class BlockPhotos:
    """Photos of the blocks: light of quads (h, w) in any unit of its own; `white` has all light.

    known : (h, w), where nothing is saturated.
    """

    white: Floats
    projector: Floats
    mask: Floats
    known: Bools


def find_panel_places(
    photos: BlockPhotos,
    blocks: BlockPattern,
    camera: Map,
    panels: tuple[Map, Map],
    size_px: tuple[int, int],
) -> PanelLook:
    """Where the panels lie by these photos.

    camera, panels : maps of quads, and of the pixels of projector and mask, as they are believed.
    size_px : (width, height) of the field in projector pixels.
    """
    lit = photos.known & (photos.white > _LIT * np.percentile(photos.white, 95.0))
    lit &= photos.white > 0.0
    raster = FieldRaster.of(size_px, quad_px(camera, size_px))
    safe = np.where(lit, photos.white, 1.0)

    def sampled(light: Floats) -> tuple[Floats, Bools]:
        return raster.sample(np.where(lit, light / safe, 0.0), lit, camera)

    of_mask, through = PatternFinder(blocks, raster, panels[1]), sampled(photos.mask)
    mask = of_mask.find(*through)
    finder, seen = PatternFinder(blocks, raster, panels[0]), sampled(photos.projector)
    projector = finder.find(*seen, HERE if mask is None else mask.map)
    if mask is not None and projector is not None:
        block_px = size_px[0] / blocks.cols
        if _is_of_the_scene(finder, seen, projector, mask, block_px):
            projector = None
    nothing = PanelLook(mask=None, camera=None, rest_px=0.0, direct=0.0, mask_seen=mask is not None)
    if mask is None or projector is None:
        return nothing
    _, one, other = np.intersect1d(projector.number, mask.number, return_indices=True)
    if one.size < FEWEST:
        return nothing
    here, drawn = projector.places[one], mask.places[other]
    base = np.concatenate([drawn, np.ones((one.size, 1))], axis=1)
    fit, rest = _fitted(base, here)
    places = _places(size_px)
    variance = of_mask.variance(*through, mask.map, mask.map.inverse()(places))
    variance += finder.variance(*seen, projector.map, projector.map.inverse()(places))
    # Of a window that is the error of all of them together, and that of fewer blocks.
    of_window = variance[len(places) // 2] * max(1.0, blocks.rows * blocks.cols / WINDOW_BLOCKS**2)
    noise = max(_NOISE_PX**2, float(of_window))
    contrast = projector.contrast[one] / np.maximum(mask.contrast[other], 1e-3)
    direct = float(np.median(contrast))
    edges = measure_block_edges(finder, *seen, projector)
    of_mask_edges = measure_block_edges(of_mask, *through, mask)
    blur = measure_blur_before_mask(edges, of_mask_edges)
    if blur:
        direct = edges.depth / of_mask_edges.depth
    return PanelLook(
        mask=_six(AffineMap(fit[:2].T, fit[2])),
        camera=_six(projector.map),
        rest_px=float(np.sqrt(max(rest**2 - noise, 0.0))),
        sigma_px=float(np.sqrt(variance.max())),
        blur_px=blur,
        direct=float(np.clip(direct, 0.0, 1.0)),
        mask_seen=True,
    )


def _is_of_the_scene(
    finder: PatternFinder,
    seen: tuple[Floats, Bools],
    projector: FoundPattern,
    mask: FoundPattern,
    block_px: float,
) -> bool:
    """Whether the projector's pattern is found mirrored, turned or blocks away, and yet some of its
    light comes from where the mask's is: a mirror in the scene makes such light, a panel does not.
    """
    between = projector.map.after(mask.map.inverse()).linear
    apart = projector.map(mask.centres) - mask.map(mask.centres)
    turned_over = between[0, 0] <= 0.0 or between[1, 1] <= 0.0
    if not turned_over and np.median(np.hypot(*apart.T)) < _AWAY * block_px:
        return False
    left, spread = finder.left_at(*seen, projector, mask.map)
    return left > max(_IN_PLACE * spread, _LEAST_IN_PLACE)


def quad_px(camera: Map, size_px: tuple[int, int]) -> float:
    """Side in projector pixels of a quad in the middle of a frame."""
    slope = camera.jacobian(0.5 * np.array(camera.size_px, dtype=np.float64))
    return float(np.sqrt(abs(np.linalg.det(slope)) * size_px[0] * size_px[1]))


def mean_cell_px(record: RunRecord) -> float:
    """Side of a cell of codes in projector pixels, of one that is not square the mean."""
    width, height = record.projector.field_size_px
    return float(np.sqrt(width * height / (record.grid[0] * record.grid[1])))


@dataclass(frozen=True)
class Misplacement:
    """How a picture lies against where it is believed to, in words' terms.

    flip : "none", "horizontal", "vertical" or "both", which is half a turn. turn_deg : clockwise.
    offset_px : of the field's middle (right, down). median_px, most_px : length of the way over
    half of the field, and over 95 % of it.
    """

    flip: str
    turn_deg: float
    scale: float
    offset_px: tuple[float, float]
    median_px: float
    most_px: float


def measure_misplacement(
    six: Six, size_px: tuple[int, int], known_px: tuple[float, float] = (0.0, 0.0)
) -> Misplacement:
    """How a picture lies by its affine map; `known_shift_px` of its shift is no news."""
    map_ = make_affine_map(six)
    off = field_shifts_px(six, size_px, known_px)
    lengths = np.hypot(off[:, 0], off[:, 1])
    turns = {}
    for flip, signs in FLIPS.items():
        kept = map_.linear @ np.diag(signs)  # mirrored first, then turned and enlarged
        if np.linalg.det(kept) > 0.0:
            turns[flip] = np.degrees(np.arctan2(kept[1, 0] - kept[0, 1], kept[0, 0] + kept[1, 1]))
    flip = min(turns, key=lambda one: abs(turns[one]))
    middle = 0.5 * np.array(size_px)
    right, down = (map_(middle) - middle - known_px).tolist()
    return Misplacement(
        flip=flip,
        turn_deg=float(turns[flip]),
        scale=float(np.sqrt(abs(np.linalg.det(map_.linear)))),
        offset_px=(right, down),
        median_px=float(np.median(lengths)),
        most_px=float(np.percentile(lengths, 95.0)),
    )


def field_shifts_px(
    six: Six, size_px: tuple[int, int], known_px: tuple[float, float] = (0.0, 0.0)
) -> Floats:
    """By how much places all over the field lie further right and down, (n, 2)."""
    return _shifts_px(six, _places(size_px), known_px)


def _shifts_px(six: Six, places: Floats, known_px: tuple[float, float]) -> Floats:
    """The same of places (..., 2)."""
    flat = places.reshape(-1, 2)
    return np.asarray(make_affine_map(six)(flat) - flat - known_px).reshape(places.shape)


def _places(size_px: tuple[int, int]) -> Floats:
    """Places all over the field, (n, 2)."""
    along = (np.arange(_POINTS) + 0.5) / _POINTS
    return np.stack(np.meshgrid(*(along * length for length in size_px)), axis=-1).reshape(-1, 2)


def finding_error_px(record: RunRecord) -> float:
    """Error with which blocks are found, in projector pixels."""
    return _SURE_PX * max(_quad_px(record), 1.0)


def _sure(off: Floats, record: RunRecord, look: PanelLook) -> Floats:
    """Of offsets (..., 2) what is beyond the error of finding them, and beyond the noise of the
    look, which adds to them as squares do."""
    least_px, noise_px = finding_error_px(record), _SIGMAS * look.sigma_px
    length = np.hypot(off[..., 0], off[..., 1])
    beyond = np.sqrt(np.maximum(length**2 - noise_px**2, 0.0))
    share = np.minimum(beyond, np.maximum(length - least_px, 0.0)) / np.maximum(length, 1e-9)
    return np.asarray(off * share[..., None])


def known_shift_px(mask: PanelConfig) -> tuple[float, float]:
    """By how much further right and down the mask's picture is known to lie: a point of the field
    is seen through the mask at that point plus `offset_px`."""
    right, down = mask.offset_px
    return -right, -down


@dataclass(frozen=True)
class LostDirectLight:
    """Direct light that goes through wrong cells, over all of it: the mean over the field, and the
    root of the mean square over the camera's quads. Photos of indirect light have it in units of
    the weight of indirect light."""

    mean: float = 0.0
    rms: float = 0.0


def estimate_lost_direct(
    record: RunRecord, window: str, *, blurred: bool = True
) -> LostDirectLight:
    """What is lost through such windows because the mask lies elsewhere, and by a blur beyond the
    known one, if that counts; none where nobody looked, or the look tells nothing."""
    look = record.panels
    if look is None or look.mask is None:
        return LostDirectLight()
    size_px = record.projector.field_size_px
    if measure_misplacement(look.mask, size_px).flip != "none":
        return LostDirectLight(1.0, 1.0)
    side, cell = find_window_kind(window).side, mean_cell_px(record)
    offset = field_shifts_px(look.mask, size_px, known_shift_px(record.mask))
    blur, none = record.mask.blur_px, np.zeros(1)
    spread = _spread_px(record, look) if blurred else float(np.hypot(blur, look.rest_px))
    right, down = _sure(offset, record, look).T
    mean = compute_leak(cell, side, (right, down), spread) - compute_leak(
        cell, side, (none, none), blur
    )
    found, usual = (
        compute_leak_rms(cell, side, off, blurred, _quad_px(record))
        for off, blurred in (((right, down), spread), ((none, none), blur))
    )
    square = np.mean(np.maximum(found**2 - usual**2, 0.0))
    return LostDirectLight(float(np.clip(mean.mean(), 0.0, 1.0)), float(np.sqrt(square)))


def estimate_misplaced_light(
    record: RunRecord, window: str, cells: CellMap, white: Floats, indirect: Floats
) -> Floats | None:
    """Direct light, (h, w, C), that got into a photo of indirect light through wrong cells; None
    where that is hardly any. Error bars add it.

    window : of the photo's shots. white, indirect : scaled pictures (h, w, C).
    """
    look, lost = record.panels, estimate_lost_direct(record, window)
    if look is None or look.mask is None or lost.rms < _LEAST_APART:
        return None
    if lost.mean > 1.0 - _LEAST_KEPT:  # the photos do not tell any more how much there is
        return np.asarray(lost.rms * look.direct * np.abs(white))
    share = estimate_lost_by_quad(record, look, look.mask, window, cells)[..., None]
    return np.asarray(share / np.maximum(1.0 - share, _LEAST_KEPT) * np.abs(white - indirect))


def estimate_lost_by_quad(
    record: RunRecord, look: PanelLook, mask: Six, window: str, cells: CellMap
) -> Floats:
    """What `estimate_lost_direct` is the mean of, at each quad (h, w): it lies along the edges of
    windows, where fine quads see it in full. mask : where the look found the mask's picture, which
    is not mirrored."""
    size_px = record.projector.field_size_px
    kind, cell = find_window_kind(window), mean_cell_px(record)
    places = cells.centres * size_px
    # The mask's picture lies further right and down by so much; light on it, further left and up.
    offset = -_shifts_px(mask, places, known_shift_px(record.mask))
    places += offset
    pixel = quad_px(place_panels(record.projector, record.mask).mask.map, size_px)
    blur, spread = (
        float(np.hypot(px, np.hypot(1.0, pixel) / np.sqrt(12.0)))
        for px in (record.mask.blur_px, _spread_px(record, look))
    )  # the edges of cells and windows lie at those of pixels
    of_quad = _quad_px(record) * ((np.arange(_IN_QUAD) + 0.5) / _IN_QUAD - 0.5)
    kept, usually_kept = np.ones(cells.frame), np.ones(cells.frame)
    for axis, count in enumerate(record.grid[::-1]):
        ats = places[..., axis] * (count * cell / size_px[axis]) + of_quad[:, None, None]
        off = offset[..., axis]
        kept *= _own(kind, cell, ats, off, spread).mean(axis=0)
        usually_kept *= _own(kind, cell, ats, 0.0, blur).mean(axis=0)
    square = np.maximum((1.0 - kept) ** 2 - (1.0 - usually_kept) ** 2, 0.0)
    smear = float(np.hypot(cells.blur_quads, _UNSURE_QUADS))
    beside = scipy.ndimage.gaussian_filter(square, smear)
    return np.asarray(np.sqrt(np.maximum(square, beside)))


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
    """Blur on the mask, and what places lie elsewhere beside a look's map."""
    return float(np.hypot(max(record.mask.blur_px, look.blur_px), look.rest_px))


def find_quads_beside_mask(record: RunRecord, cells: CellMap) -> Bools | None:
    """Quads (h, w) that see a place beside the mask's picture, as blocks showed it: no light comes
    from there, whatever the scene has. None where nobody looked, or the look tells nothing.

    Callers: error bars, which know nothing there, and the verdict. cells : the map of the frame.
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


def make_affine_map(six: Six) -> AffineMap:
    """The map that six numbers stand for."""
    table = np.array(six, dtype=np.float64).reshape(2, 3)
    return AffineMap(table[:, :2], table[:, 2])


def _six(map_: AffineMap) -> Six:
    (a, b), (d, e) = map_.linear.tolist()
    c, f = map_.shift.tolist()
    return a, b, c, d, e, f


def _fitted(base: Floats, places: Floats) -> tuple[Floats, float]:
    """An affine map (3, 2) by least squares, without those that lie far off; and the standard
    deviation that is left."""
    kept = np.ones(len(base), np.bool_)
    for _ in range(5):
        fit = np.linalg.lstsq(base[kept], places[kept], rcond=None)[0]
        off = np.hypot(*(base @ fit - places).T)
        spread = 1.4826 * float(np.median(off[kept]))
        kept = off <= max(3.0 * spread, 0.1)
        if kept.sum() < FEWEST:
            kept[:] = True
            break
    return np.asarray(fit, np.float64), float(np.sqrt(np.mean(off[kept] ** 2)))
