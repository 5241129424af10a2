"""Whether both panels lie where they are believed to, from photos of the same random blocks.

One photo shows blocks on the projector behind an open mask, another the same blocks on the mask in
front of a lit projector. Each is divided by a photo of all light. The camera sees the mask's blocks
directly; it sees the projector's blocks by direct light. Each photo gives the place of the pattern
that each quad sees (`pdcd.pictures.found_blocks`). The difference between the two is how far the
mask lies from where it is believed to, independently of the camera. The difference between the
projector's pattern and the camera's map is how far the camera is off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from pdcd.arrays import Bools, Floats
from pdcd.bench.tables import PanelConfig
from pdcd.panels.blocks import BlockPattern
from pdcd.panels.map import Map
from pdcd.pictures.agreeing import FEWEST, fit_bend, fit_without_outliers
from pdcd.pictures.block_blur import measure_block_edges, measure_blur_before_mask
from pdcd.pictures.found_blocks import FLIPS, WINDOW_BLOCKS, FoundPattern, PatternFinder
from pdcd.pictures.raster import HERE, AffineMap, FieldRaster
from pdcd.runs.record import BENT_PLACES, BentPixels, PanelLook, RunRecord, Six

_LIT = 0.03
"""Share of the bright quads' light, in the photo of all light, below which a quad is not used."""
_NOISE_PX = 0.5
"""Least standard deviation of a window's place that is taken for noise, not for a bent mask."""
_IN_PLACE = 4.0
"""Standard deviations from which a pattern counts as present at a place."""
_LEAST_IN_PLACE = 0.01
"""Least contrast of the pattern there, as a share of all light."""
_AWAY = 8.0
"""Distance, in blocks, from which a pattern is uncorrelated with itself, large blocks included."""


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
    known_blur_px: float = 0.0,
) -> PanelLook:
    """Locates the panels in these photos.

    camera, panels : maps of quads, and of the pixels of projector and mask, as they are believed.
    size_px : (width, height) of the field in projector pixels. known_blur_px : of light on its way
        to the mask.
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
    fit, _ = fit_without_outliers(base, here)
    places, bend = _places(size_px), fit_bend(drawn, here - base @ fit)
    bent_px = bend(places)
    rest = _measure_rest(base, here - bend(drawn))
    variance = of_mask.variance(*through, mask, mask.map.inverse()(places))
    variance += finder.variance(*seen, projector, projector.map.inverse()(places))
    # The error of a window's place: that of all together, scaled up as it has fewer blocks.
    of_window = variance[len(places) // 2] * max(1.0, blocks.rows * blocks.cols / WINDOW_BLOCKS**2)
    noise = max(_NOISE_PX**2, float(of_window))
    contrast = projector.contrast[one] / np.maximum(mask.contrast[other], 1e-3)
    direct = float(np.median(contrast))
    edges = measure_block_edges(finder, *seen, projector)
    of_mask_edges = measure_block_edges(of_mask, *through, mask)
    blur = measure_blur_before_mask(edges, of_mask_edges, known_blur_px)
    if blur:
        direct = edges.depth / of_mask_edges.depth
    return PanelLook(
        mask=_six(AffineMap(fit[:2].T, fit[2])),
        camera=_six(projector.map),
        bent_px=tuple((x, y) for x, y in bent_px.tolist()) if bent_px.any() else None,
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
    """Whether the projector's pattern was found mirrored, turned or blocks away, while some of its
    light comes from where the mask's is. Then a mirror in the scene shows it; a misplaced panel
    would leave no light there."""
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
    """Side of a cell of codes in projector pixels; the mean side where it is not square."""
    width, height = record.projector.field_size_px
    return float(np.sqrt(width * height / (record.grid[0] * record.grid[1])))


@dataclass(frozen=True)
class Misplacement:
    """How a picture lies compared with where it is believed to lie.

    flip : "none", "horizontal", "vertical" or "both", which is half a turn. turn_deg : clockwise.
    offset_px : of the field's middle (right, down). median_px, most_px : displacement that half of
    the field does not exceed, and that 95 % of it do not exceed. bent : whether a lens bends it.
    """

    flip: str
    turn_deg: float
    scale: float
    offset_px: tuple[float, float]
    median_px: float
    most_px: float
    bent: bool


def measure_misplacement(
    six: Six,
    size_px: tuple[int, int],
    known_px: tuple[float, float] = (0.0, 0.0),
    bent_px: BentPixels | None = None,
) -> Misplacement:
    """Describes how a picture lies, from its affine map and its bend; `known_shift_px` is
    subtracted."""
    map_ = make_affine_map(six)
    off = field_shifts_px(six, size_px, known_px, bent_px)
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
        bent=bent_px is not None,
    )


def field_shifts_px(
    six: Six,
    size_px: tuple[int, int],
    known_px: tuple[float, float] = (0.0, 0.0),
    bent_px: BentPixels | None = None,
) -> Floats:
    """By how much places all over the field lie further right and down, (n, 2)."""
    shifts = compute_shifts_px(six, _places(size_px), known_px)
    return shifts if bent_px is None else shifts + np.array(bent_px)


def interpolate_bend_px(look: PanelLook, places: Floats) -> Floats:
    """`PanelLook.bent_px` at places of the field, from 0 to 1, (..., 2)."""
    if look.bent_px is None:
        return np.zeros(places.shape)
    bent = np.reshape(look.bent_px, (BENT_PLACES, BENT_PLACES, 2))
    at = np.moveaxis(places[..., ::-1] * BENT_PLACES - 0.5, -1, 0)
    right, down = (
        scipy.ndimage.map_coordinates(bent[..., axis], at, order=1, mode="nearest")
        for axis in (0, 1)
    )
    return np.stack([right, down], axis=-1)


def compute_shifts_px(six: Six, places: Floats, known_px: tuple[float, float]) -> Floats:
    """The same at places (..., 2)."""
    flat = places.reshape(-1, 2)
    return np.asarray(make_affine_map(six)(flat) - flat - known_px).reshape(places.shape)


def _places(size_px: tuple[int, int]) -> Floats:
    """Places all over the field, (n, 2)."""
    along = (np.arange(BENT_PLACES) + 0.5) / BENT_PLACES
    return np.stack(np.meshgrid(*(along * length for length in size_px)), axis=-1).reshape(-1, 2)


def known_shift_px(mask: PanelConfig) -> tuple[float, float]:
    """By how much further right and down the mask's picture is known to lie: a point of the field
    is seen through the mask at that point plus `offset_px`."""
    right, down = mask.offset_px
    return -right, -down


def make_affine_map(six: Six) -> AffineMap:
    """The affine map with these six numbers."""
    table = np.array(six, dtype=np.float64).reshape(2, 3)
    return AffineMap(table[:, :2], table[:, 2])


def _six(map_: AffineMap) -> Six:
    (a, b), (d, e) = map_.linear.tolist()
    c, f = map_.shift.tolist()
    return a, b, c, d, e, f


def _measure_rest(base: Floats, places: Floats) -> float:
    """Standard deviation of the residuals of an affine map of places, (n, 2), without outliers."""
    fit, kept = fit_without_outliers(base, places)
    return float(np.sqrt(np.mean(np.sum((base @ fit - places)[kept] ** 2, axis=1))))
