"""Dots of a panel in three photos: found without a prior map, to a few hundredths of a quad.

With R = (dots - black) / (white - black), in which texture and vignetting cancel, dots are local
maxima of a matched filter, and their places centroids of R in a disc with a soft edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
from scipy.spatial import cKDTree

from pdcd.arrays import Bools, Floats, Indices
from pdcd.calibration.geometry.dots import PER_RADIUS, DotGrid
from pdcd.calibration.geometry.lattice import find_lattice_place, index_dots
from pdcd.calibration.geometry.lit import (
    LIT_SIGMAS,
    OFFSETS_QUADS,
    find_panel_light,
)
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.registration.series_faults import find_lit_quads as lit_white
from pdcd.errors import CalibrationError
from pdcd.words import SubjectName

_TELLING_QUADS = 5.0
"""Dots that lie nearer to each other than this may be too small for their holes to be seen."""
_LEAST_DOTS = 60
"""Dots below which neither their code nor a map is sure."""
_FLAT, _EDGE, RING = 1.5, 2.1, 2.6
"""Radii, over that of a dot: of the disc in which a centroid is taken in full, of its soft edge,
and of the ring about it in which the light between dots is measured."""
_ROUNDS = 4
"""How often the disc is centred on the centroid anew."""
_PEAK = 0.35
"""Share of the usual response of the matched filter from which a maximum is a dot."""
_MOST_BLUR = 0.5
"""Blur over the radius of dots beyond which they are out of focus."""
_TEXTURE = 0.25
"""Deviation of the white light about a dot, over its mean, beyond which blur may move the dot."""
_MOST_TEXTURED = MappingProxyType({"card": 0.4, "scene": 0.9})
"""Share of dots that may lie on texture."""
_CHUNK = 2_000_000
"""Quads about dots that are worked on at a time."""


@dataclass(frozen=True, eq=False)
class Dots:
    """The dots of one panel in one colour.

    grid : what the panel showed.
    index : (n, 2) int, (column, row) of each dot in the grid.
    panel_px : (n, 2), their centres on the panel.
    camera_px : (n, 2), their centres in the photo in quads, corrected for where the colour's
        samples lie in the quad.
    sigma_px : (n, 2), standard deviation of these, in quads, by the noise of the photos.
    blur_quads : standard deviation of the blur of the dots' edges, the quads' own width included.
    """

    grid: DotGrid
    index: Indices
    panel_px: Floats
    camera_px: Floats
    sigma_px: Floats
    blur_quads: float


@dataclass(frozen=True, eq=False)
class _Ratio:
    """R of one colour, its variance, and white - black."""

    value: Floats
    variance: Floats
    light: Floats


@dataclass(frozen=True, eq=False)
class _Centroids:
    """at, sigma : (n, 2), NaN where there is none; blur, radius : (n,), all in quads."""

    at: Floats
    sigma: Floats
    blur: Floats
    radius: Floats

    def dots(self, grid: DotGrid, index: Indices, offset_quads: tuple[float, float]) -> Dots:
        """The dots that were found, as dots of a grid."""
        good = np.isfinite(self.sigma).all(axis=-1)
        return Dots(
            grid=grid,
            index=index[good],
            panel_px=grid.centres(index[good]),
            camera_px=self.at[good] + offset_quads,
            sigma_px=self.sigma[good],
            blur_quads=float(np.median(self.blur[good])),
        )


def find_dots(
    white: QuadPhoto,
    black: QuadPhoto,
    dots: QuadPhoto,
    grid: DotGrid,
    *,
    other: DotGrid | None = None,
    pattern: str = "RGGB",
    subject: SubjectName = "card",
) -> tuple[Dots, ...]:
    """The dots of a panel in photos of its three pictures, in each colour.

    other : grid of the other panel, by which swapped outputs are recognised.
    pattern : of the camera's mosaic. subject : a scene may have more edges than a card.

    Raises CalibrationError, which names the cause, where dots cannot be found or identified.
    """
    lit = find_panel_light(white, black, grid.panel)
    main = white.colours // 2
    by_main = _ratio(white, black, dots, lit, main)
    _check_shown(by_main.value, lit, grid)
    rough, radius = _rough(by_main.value, lit, grid)
    points, index = _told_apart(rough, radius, by_main, grid, other)
    points, index = _trusted(points, index, radius, by_main, grid, _MOST_TEXTURED[subject])
    found: list[Dots] = []
    for channel, offset_quads in enumerate(OFFSETS_QUADS[pattern]):
        ratio = by_main if channel == main else _ratio(white, black, dots, lit, channel)
        seen = _measured(ratio, points, radius, grid)
        found.append(seen.dots(grid, index, offset_quads))
    return tuple(found)


def find_known_dots(
    white: QuadPhoto, dots: QuadPhoto, grid: DotGrid, index: Indices, expected: Floats
) -> tuple[Indices, Floats, Floats]:
    """Find dots whose places are nearly known, in two photos only.

    white : both panels white. dots : of one panel, the other white.
    index : (n, 2) (column, row) of dots of the grid. expected : (n, 2) where in quads they should
        be; all may have moved by less than two of their pitches, and turned by a degree or so.

    Returns index (m, 2), places (m, 2) and their standard deviations (m, 2) in quads of the dots
    that were found. Raises CalibrationError where there is no light, or dots cannot be found.
    """
    by = white.main
    lit = lit_white(by, white.main_variance)
    per = np.where(lit, 1.0 / np.where(lit, by, 1.0), 0.0)
    value = dots.main * per
    variance = dots.main_variance + value**2 * white.main_variance
    ratio = _Ratio(value, variance * per**2, by)
    _check_shown(value, lit, grid)
    rough, radius = _rough(value, lit, grid)
    near = expected + _moved_by(rough, expected, PER_RADIUS * radius)
    away, which = cKDTree(rough).query(near)
    good = away < 0.4 * PER_RADIUS * radius
    if good.sum() < _LEAST_DOTS:
        raise _few(int(good.sum()), grid)
    found = _measured(ratio, rough[which[good]], radius, grid)
    seen = np.isfinite(found.sigma).all(axis=-1)
    return index[good][seen], found.at[seen], found.sigma[seen]


def _moved_by(rough: Floats, expected: Floats, pitch: float) -> Floats:
    """By how much all dots have moved, (2,): the least shift that most of them agree on. Dots at
    the edges distinguish it from shifts that are whole pitches larger."""
    reach, bin_quads = 2, 0.25 * pitch
    places = cKDTree(rough)
    near = places.query_ball_point(expected, reach * pitch)
    apart = np.concatenate(
        [rough[some] - at for some, at in zip(near, expected, strict=True) if some]
        or [np.zeros((1, 2))]
    )
    count = 4 * reach + 1
    edges = (np.arange(-count, count + 2) - 0.5) * bin_quads
    votes = _smooth(np.histogram2d(apart[:, 0], apart[:, 1], bins=(edges, edges))[0], 0.7)
    highest = (votes == cv2.dilate(votes, np.ones((3, 3), dtype=np.uint8))) & (votes > 0.0)
    highest &= votes > 0.5 * votes.max()
    shifts = (np.argwhere(highest) - count) * bin_quads
    partners = []
    for shift in shifts:
        close = np.hypot(*(apart - shift).T) < 2.0 * bin_quads
        shift[:] = np.median(apart[close], axis=0)
        partners.append(int((places.query(expected + shift)[0] < bin_quads).sum()))
    most = np.array(partners) >= 0.99 * max(partners)
    return np.asarray(shifts[most][np.argmin(np.hypot(*shifts[most].T))])


def _ratio(white: QuadPhoto, black: QuadPhoto, dots: QuadPhoto, lit: Bools, channel: int) -> _Ratio:
    """R where the panel's light falls, else 0."""
    dark = black.light[..., channel]
    light = white.light[..., channel] - dark
    # A colour may have no light where green has.
    least = np.median(light[lit]) * 0.05
    per = np.where(lit & (light > least), 1.0 / np.maximum(light, least), 0.0)
    value = (dots.light[..., channel] - dark) * per
    variance = (
        dots.variance[..., channel]
        + value**2 * white.variance[..., channel]
        + (1.0 - value) ** 2 * black.variance[..., channel]
    ) * per**2
    return _Ratio(value, variance, light)


def _check_shown(ratio: Floats, lit: Bools, grid: DotGrid) -> None:
    """Raise CalibrationError where the third photo shows nothing that may be dots."""
    mean = float(ratio[lit].mean())
    if mean < 0.02:
        raise _untrusted(
            "the photo of dots is black",
            grid,
            f"see that the {grid.panel} shows pictures, not only white: pdcd show dots",
        )
    if mean > 0.6:
        raise _untrusted(
            "the photo of dots is white",
            grid,
            f"see that the {grid.panel} changes its picture in time: pdcd show dots",
        )


def _rough(ratio: Floats, lit: Bools, grid: DotGrid) -> tuple[Floats, float]:
    """Places of dots, (n, 2) in quads, to about a quad, and their usual radius in quads."""
    smooth = _smooth(ratio, 1.0)
    bright = 0.5 * float(np.percentile(smooth[::2, ::2][lit[::2, ::2]], 98.0))
    _, _, stats, _ = cv2.connectedComponentsWithStats((smooth > bright).astype(np.uint8))
    areas = stats[1:, cv2.CC_STAT_AREA]
    areas = areas[areas >= 5]
    if areas.size < _LEAST_DOTS:
        raise _few(int(areas.size), grid)
    # Half of the dots' light lies in dots of at least this size, however many specks there are.
    ordered = np.sort(areas)
    usual = ordered[np.searchsorted(np.cumsum(ordered), 0.5 * ordered.sum())]
    radius = float(np.sqrt(usual / np.pi))
    narrow, wide = radius / 1.5, radius * 1.5
    matched = _smooth(ratio, narrow) - _smooth(ratio, wide)
    side = 2 * max(1, round(radius)) + 1
    highest = cv2.dilate(matched, np.ones((side, side), dtype=np.uint8))
    row, col = np.nonzero((matched == highest) & (matched > 0.0) & lit)
    response = matched[row, col]
    strongest = np.sort(response)[-min(response.size, grid.shape[0] * grid.shape[1]) :]
    kept = response > _PEAK * float(np.median(strongest))
    return np.stack([col[kept] + 0.5, row[kept] + 0.5], axis=-1), radius


def _told_apart(
    rough: Floats, radius: float, ratio: _Ratio, grid: DotGrid, other: DotGrid | None
) -> tuple[Floats, Indices]:
    """Place of each dot in quads, (n, 2), and its index, (n, 2).

    Raises CalibrationError where the code does not identify them.
    """
    points = _centroids(ratio, rough, radius).at
    points = points[np.isfinite(points).all(axis=-1)]
    count, which = index_dots(points)
    if len(which) < _LEAST_DOTS:
        raise _few(len(which), grid)
    points = points[which]
    count = count - count.min(axis=0)
    cells = _cells(ratio.light, points, count, radius)
    place = find_lattice_place(cells, grid.holes())
    if not place.sure:
        _check_swapped(cells, grid, other)
        apart = float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))
        hint = "hold a flat matt card there, fully lit, and see that nothing scales the picture"
        if apart < _TELLING_QUADS:
            hint = f"the dots lie {apart:.1f} pixels apart: let the field fill the camera's frame"
        raise _untrusted(
            f"dots were found, but cannot be told apart: they agree by {place.score:.0%} with the "
            f"{grid.panel}'s code",
            grid,
            hint,
        )
    return points, place.index(count)


def _check_swapped(cells: Floats, grid: DotGrid, other: DotGrid | None) -> None:
    if other is not None and find_lattice_place(cells, other.holes()).sure:
        raise _untrusted(
            f"the dots of the {other.panel} are seen where the {grid.panel}'s were asked for",
            grid,
            "the outputs are swapped: exchange the cables, or the outputs in the configuration",
        )


def _cells(light: Floats, points: Floats, count: Indices, radius: float) -> Floats:
    """White light between each four neighbouring dots, over that on the dots: -1 is none, 1 is as
    much. (rows, cols), NaN where a dot is missing."""
    cols, rows = (count.max(axis=0) + 1).tolist()
    at = np.full((rows, cols, 2), np.nan)
    at[count[:, 1], count[:, 0]] = points
    smooth = _smooth(light, max(0.5 * radius, 0.5))
    corners = np.stack([at[:-1, :-1], at[1:, :-1], at[:-1, 1:], at[1:, 1:]])
    middle = corners.mean(axis=0)
    known = np.isfinite(middle).all(axis=-1)
    found = np.full(known.shape, np.nan)
    around = np.mean([_sampled(smooth, corner[known]) for corner in corners], axis=0)
    share = _sampled(smooth, middle[known]) / np.maximum(around, 1e-12)
    found[known] = np.clip(2.0 * share - 1.0, -1.0, 1.0)
    # Blur and glare fill holes: what counts is which places are darker than most.
    found -= 0.5 * (np.nanpercentile(found, 10.0) + np.nanpercentile(found, 90.0))
    return np.asarray(np.clip(2.0 * found, -1.0, 1.0))


def _smooth(values: Floats, sigma: float) -> Floats:
    """Blurred by a Gaussian of so many quads."""
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma), dtype=np.float64)


def _sampled(values: Floats, points: Floats) -> Floats:
    rows, cols = values.shape
    col = np.clip(points[:, 0].astype(np.int64), 0, cols - 1)
    row = np.clip(points[:, 1].astype(np.int64), 0, rows - 1)
    return values[row, col]


def _trusted(
    points: Floats, index: Indices, radius: float, ratio: _Ratio, grid: DotGrid, most: float
) -> tuple[Floats, Indices]:
    """The panel's dots that lie on even ground, and their indices."""
    rows, cols = grid.shape
    inside = ((index >= 0) & (index < (cols, rows))).all(axis=-1)
    points, index = points[inside], index[inside]
    even = _unevenness(ratio.light, points, radius) < _TEXTURE
    if even.mean() < 1.0 - most:
        raise _untrusted(
            f"the texture is too strong: {1.0 - even.mean():.0%} of the dots lie on its edges",
            grid,
            "put a flat matt card there, or calibrate on the scene: --scene",
        )
    points, index = points[even], index[even]
    if len(points) < _LEAST_DOTS:
        raise _few(len(points), grid)
    return points, index


def _unevenness(light: Floats, points: Floats, radius: float) -> Floats:
    """Spread of the white light about each dot, over its mean, (n,); noise adds little."""
    smooth = _smooth(light, 0.25 * radius)
    angles = np.arange(8) * (np.pi / 4.0)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=-1) * radius
    values = np.stack([_sampled(smooth, points + step) for step in [*ring, np.zeros(2)]])
    found: Floats = values.std(axis=0) / np.maximum(values.mean(axis=0), 1e-12)
    return found


def _measured(ratio: _Ratio, points: Floats, radius: float, grid: DotGrid) -> _Centroids:
    """Measure in one colour the dots that green has. Raises CalibrationError where they are too
    blurred."""
    found = _centroids(ratio, points, radius)
    # A centroid that moved further belongs to another dot, or to noise.
    with np.errstate(invalid="ignore"):
        lost = ~(np.hypot(*(found.at - points).T) < radius)
    found.sigma[lost] = np.nan
    good = np.isfinite(found.sigma).all(axis=-1)
    if good.sum() < _LEAST_DOTS:
        raise _few(int(good.sum()), grid)
    blur = float(np.median(found.blur[good] / found.radius[good]))
    if blur > _MOST_BLUR:
        raise _untrusted(
            f"the dots are out of focus: their edges are blurred over {blur:.0%} of their radius",
            grid,
            "focus the camera on the mask, then the projector on the card; let them fill its frame",
        )
    return found


def _centroids(ratio: _Ratio, start: Floats, radius: float) -> _Centroids:
    """Centroids about places (n, 2); NaN for those too near to the frame's edge."""
    reach = int(np.ceil(RING * radius)) + 1
    found = np.full((len(start), 6), np.nan)
    rows, cols = ratio.value.shape
    corner = np.floor(start).astype(np.int64) - reach
    side = 2 * reach + 1
    whole = np.flatnonzero(((corner >= 0) & (corner + side <= (cols, rows))).all(axis=-1))
    at_once = max(1, _CHUNK // side**2)
    for first in range(0, len(whole), at_once):
        some = whole[first : first + at_once]
        down = corner[some, 1][:, None, None] + np.arange(side)[:, None]
        right = corner[some, 0][:, None, None] + np.arange(side)
        patch, variance = ratio.value[down, right], ratio.variance[down, right]
        local = _centroid(patch, variance, start[some] - corner[some], radius)
        local[:, :2] += corner[some]
        found[some] = local
    return _Centroids(found[:, :2], found[:, 2:4], found[:, 4], found[:, 5])


def _centroid(patch: Floats, variance: Floats, start: Floats, radius: float) -> Floats:
    """Centroid, its standard deviation, blur and radius, (n, 6), of dots in patches (n, k, k)."""
    middles = np.arange(patch.shape[1]) + 0.5
    at = start
    with np.errstate(all="ignore"):  # a patch without light has no centroid
        for _ in range(_ROUNDS):
            across, down = middles - at[:, :1], middles - at[:, 1:]
            distance = np.sqrt(across[:, None, :] ** 2 + down[:, :, None] ** 2) / radius
            weight = np.clip((_EDGE - distance) / (_EDGE - _FLAT), 0.0, 1.0)
            ring = (distance > _EDGE) & (distance < RING)
            ground = (patch * ring).sum(axis=(1, 2)) / ring.sum(axis=(1, 2))
            dot = patch - ground[:, None, None]
            weighted = weight * dot
            total = weighted.sum(axis=(1, 2))
            x = (weighted.sum(axis=1) * across).sum(axis=1) / total
            y = (weighted.sum(axis=2) * down).sum(axis=1) / total
            at = at + np.stack([x, y], axis=-1)
        spread = weight**2 * variance
        sigma_x = np.sqrt((spread.sum(axis=1) * across**2).sum(axis=1)) / total
        sigma_y = np.sqrt((spread.sum(axis=2) * down**2).sum(axis=1)) / total
        # Along an edge blurred by s, the integral of R (1 - R) across it is s / sqrt(pi).
        size = np.sqrt(total / np.pi)
        within = (weight * (dot * (1.0 - dot) + variance)).sum(axis=(1, 2))
        blur = within / (2.0 * np.sqrt(np.pi) * size)
    dim = ~(total > LIT_SIGMAS * np.sqrt(spread.sum(axis=(1, 2))))
    found = np.column_stack([at, sigma_x, sigma_y, np.maximum(blur, 0.0), size])
    found[dim] = np.nan
    return found


def _few(count: int, grid: DotGrid) -> CalibrationError:
    return _untrusted(
        f"only {count} of {np.prod(grid.shape)} dots were found; {_LEAST_DOTS} are needed",
        grid,
        "let mask and picture cover each other, and the camera see both; clear its way, and focus",
    )


def _untrusted(what: str, grid: DotGrid, hint: str) -> CalibrationError:
    return CalibrationError(what, device=grid.panel, hint=hint)
