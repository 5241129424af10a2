"""The camera's map to a panel, out of dots or decoded stripes, and whether to believe it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pdcd.arrays import Floats
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.geometry.dots import DotGrid
from pdcd.calibration.geometry.finding import RING, Dots
from pdcd.calibration.geometry.fit import FittedMap, PointPairs, fit_map, mad_px
from pdcd.calibration.geometry.phase import DecodedQuads
from pdcd.errors import CalibrationError
from pdcd.panels.distortion import make_residual
from pdcd.panels.map import Map, map_between
from pdcd.words import SubjectName

_DISC = 3, 12
"""Rings of a dot, and places in each, at which its disc is sampled."""
_FLOOR_QUADS = 0.01
"""Error of a dot's place without any noise: quads are coarse, and so are the panel's pixels."""
_NEIGHBOURS = 2
"""Dots to either side that are considered to decide whether a place counts as seen."""
_LEAST_SEEN = MappingProxyType({"card": 0.9, "scene": 0.5})
"""Share of the dots in the frame that must be seen; the model bridges what a scene hides."""
_LEAST_IN_FRAME = 0.5
"""Share of all dots that must be in the frame."""
_BLOCK = 12
"""Side, in quads, of a block whose decoded places are averaged."""
_LEAST_IN_BLOCK = 0.25
_CLIPPED = 3.0 * 1.4826
_CLOSE_PX = 0.05

_SWAPPED = "the outputs are swapped: exchange the cables, or the outputs in the configuration"

_INLIERS = MappingProxyType({"card": 0.95, "scene": 0.8})
_MAD_PX, _WORST_PX, _RESIDUAL_PX, _SIGMA_PX = 0.1, 0.3, 2.0, 0.05
"""Limits: least share of inliers; largest median and 95th percentile of the fit's residuals;
largest displacement of the residual spline; largest 95th percentile of the map's own error."""
_SEEN, _NEAR = 0.6, 0.05
"""Share of the photo of a scene that has points near it, and how near, over its diagonal."""
_REFUSED, _UNSURE = 3.0, 10.0
"""Times the limit beyond which a map is bad, not only doubtful. The second is for the map's own
error: half a pixel at its worst edge, which says nothing of the rest."""
_APART_PX = 0.5
"""Colours of a panel that lie further apart are worth a look at its convergence."""


def fit_dots(dots: Dots, frame: tuple[int, int], subject: SubjectName = "card") -> FittedMap:
    """The map from quads to the panel's pixels, fitted to its dots in one colour.

    frame : rows and columns of the photo.

    Where the scale changes across a disc, its centroid in a photo is not where its centre is seen.
    A first map gives this shift, which is subtracted before the second fit. Raises CalibrationError
    where the map cannot be trusted; `check_dot_coverage` checks whether the panel is seen at all.
    """
    grid = dots.grid
    first = _fit_dots(dots, frame)
    seen = dots.camera_px - _disc_shift(first, dots.panel_px, grid.radius_px)
    return check_fitted_map(_fit_dots(replace(dots, camera_px=seen), frame), grid.panel, subject)


def fit_decoded_quads(
    decoded: DecodedQuads,
    size_px: tuple[int, int],
    panel: str,
    *,
    offset_quads: tuple[float, float] = (0.0, 0.0),
    subject: SubjectName = "card",
) -> FittedMap:
    """The same map from stripes: residuals of a first fit are averaged over blocks, and fitted
    again.

    offset_quads : of the colour's samples from the middle of their quad. subject : on a scene,
        light that comes round corners decodes to other places, and is left out. Raises
        CalibrationError where the map cannot be trusted.
    """
    rows, cols = decoded.valid.shape
    middle = _BLOCK // 2
    row, col = np.nonzero(decoded.valid[middle::_BLOCK, middle::_BLOCK])
    row, col = row * _BLOCK + middle, col * _BLOCK + middle
    some = PointPairs(
        np.stack([col + 0.5, row + 0.5], axis=-1) + offset_quads,
        decoded.panel_px[row, col],
        decoded.sigma_px[row, col],
    )
    size = (cols, rows)
    first = fit_map(some, size, size_px, panel)
    blocks = _blocks(decoded, first, _BLOCK, np.array(offset_quads))
    return check_fitted_map(fit_map(blocks, size, size_px, panel), panel, subject)


def compare_orientation(found: Map, believed: Map) -> tuple[float, bool]:
    """How a found map (from quads to the panel) differs from the believed one at the middle of the
    photo: turned clockwise by so many degrees, -180 to 180, and whether mirrored."""
    middle = 0.5 * np.array([found.size_px], dtype=np.float64)
    # The sides of the fields may differ: compare in the panel's own directions as seen in the
    # photo.
    change = found.jacobian(middle)[0] @ np.linalg.inv(believed.jacobian(middle)[0])
    if np.linalg.det(change) < 0.0:
        return 0.0, True
    left, _, right = np.linalg.svd(np.linalg.inv(change))
    turn = left @ right
    return float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))), False


def check_orientation(found: Map, believed: Map, panel: str, other: Map | None = None) -> None:
    """Raise CalibrationError for a panel that is seen mirrored, upside down or on its side, unlike
    what the configuration says; or that is seen where the other panel is believed to be.

    found, believed, other : from quads of the photo to the unit square of the panel's pixels: the
        map that was found, the believed map of this panel, and that of the other.
    """
    if other is not None and _apart(found, other) < 0.25 * _apart(found, believed):
        raise CalibrationError(
            f"the {panel}'s picture is seen where that of the other panel is believed to be",
            device=panel,
            hint=_SWAPPED,
        )
    turn, mirrored = compare_orientation(found, believed)
    what = ""
    if mirrored:
        what = "mirrored"
    elif abs(turn) > 135.0:
        what = "upside down"
    elif abs(turn) > 45.0:
        what = "turned by a quarter"
    if what:
        raise CalibrationError(
            f"the {panel} is seen {what}, which is not what [{panel}.place] says",
            device=panel,
            hint=f"correct flip and turn_deg in [{panel}.place], or the mount; see that the "
            "desktop does not rotate its output, and that the outputs are not swapped",
        )


def make_believed_map(camera: Map, panel: Map) -> Map:
    """The believed map from quads to the unit square of a panel's pixels, without lens and
    residual: exact at the middle of the photo, near enough elsewhere to compare with."""
    width, height = camera.size_px
    corners = np.array([[0.2, 0.2], [0.8, 0.2], [0.8, 0.8], [0.2, 0.8]]) * (width, height)
    there = map_between(camera, panel, corners) / panel.size_px
    rows = []
    for (x, y), (u, v) in zip(corners.tolist(), there.tolist(), strict=True):
        rows.append([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y])
        rows.append([0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y])
    a, b, c, d, e, f, g, h = np.linalg.solve(np.array(rows), there.ravel()).tolist()
    return Map(size_px=camera.size_px, homography=(a, b, c, d, e, f, g, h, 1.0))


def check_fitted_map(fitted: FittedMap, panel: str, subject: SubjectName = "card") -> FittedMap:
    """Return the map. Raises CalibrationError where it is far beyond the limits."""
    left = np.hypot(fitted.residual_px[:, 0], fitted.residual_px[:, 1])
    inliers = _share_of_inliers(fitted, left, 1.0)
    worst = float(np.percentile(left, 95.0))
    if 1.0 - inliers > _REFUSED * (1.0 - _INLIERS[subject]) or np.median(left) > _REFUSED * _MAD_PX:
        raise CalibrationError(
            f"no smooth map fits: {1.0 - inliers:.0%} of the points lie elsewhere; the others "
            f"are {np.median(left):.2f} pixels off, 5 % of them more than {worst:.2f}",
            device=panel,
            hint="hold a flat matt card without texture still; see that keystone, scaler and "
            "overscan are off",
        )
    return fitted


def _share_of_inliers(fitted: FittedMap, left_px: Floats, scale: float) -> float:
    """Share of the points that are inliers, or whose residual is within the limit for the worst:
    where the others fit far better, these are still no outliers."""
    return float(np.mean(fitted.inlier | (left_px <= scale * _WORST_PX)))


def list_map_figures(
    fitted: FittedMap,
    panel: str,
    scale: float = 1.0,
    subject: SubjectName = "card",
    beside: FittedMap | None = None,
) -> list[MeasuredFigure]:
    """How good a map is, as figures with their limits.

    scale : pixels of this panel per pixel of the projector. A finer panel may be off by more of its
        own pixels: what counts is the place on the projector.
    beside : the other panel's map: a map is used only where that panel lets light pass, too.
    """
    scale = max(1.0, scale)
    left = np.hypot(fitted.residual_px[:, 0], fitted.residual_px[:, 1])
    count, least = len(left), _INLIERS[subject]
    inliers, middle = _share_of_inliers(fitted, left, scale), mad_px(fitted.residual_px)
    # In a scene, points that lie elsewhere are light that took another way.
    worst = float(np.percentile(left if subject == "card" else left[fitted.inlier], 95.0))
    places = _on_panel(fitted)
    if beside is not None:
        places = places[_within(beside.to_target(places), beside.target_size_px)]
    moved = float(
        np.hypot(*make_residual(fitted.map.residual, fitted.map.size_px).at(places).T).max()
    )
    more = []
    if subject == "scene":  # dark places of a scene cannot be measured, nor are they used
        share = _near_points(fitted, places)
        more.append(_figure(f"{panel}.seen", share, 0.0, _SEEN))
        places = fitted.source_px[fitted.inlier]
    own = float(np.percentile(fitted.sigma_px(places).max(axis=-1), 95.0))
    return [
        _figure(f"{panel}.inliers", inliers, np.sqrt(inliers * (1.0 - inliers) / count), least),
        _figure(f"{panel}.fit_px", middle, middle / np.sqrt(count), scale * _MAD_PX),
        _figure(f"{panel}.fit_worst_px", worst, 3.0 * middle / np.sqrt(count), scale * _WORST_PX),
        _figure(f"{panel}.residual_px", moved, own, scale * _RESIDUAL_PX),
        _figure(f"{panel}.map_px", own, own / np.sqrt(2.0 * count), scale * _SIGMA_PX, _UNSURE),
        *more,
    ]


def _within(px: Floats, size_px: Sequence[int], margin: float = 0.0) -> NDArray[np.bool_]:
    """Which places of a panel (n, 2) are on it, and at least `margin` from its edges."""
    with np.errstate(invalid="ignore"):
        inside = (px >= margin) & (px <= np.array(size_px, dtype=np.float64) - margin)
    return np.asarray(inside.all(axis=-1))


def _near_points(fitted: FittedMap, places: Floats) -> float:
    """Share of places of the photo that have points near them."""
    reach = _NEAR * np.hypot(*fitted.map.size_px)
    away, _ = cKDTree(fitted.source_px[fitted.inlier]).query(places)
    return float(np.mean(away < reach))


def measure_convergence(
    colours: Sequence[FittedMap], panel: str, beside: Sequence[FittedMap] | None = None
) -> tuple[Floats, list[MeasuredFigure]]:
    """How far red and blue of a panel lie from green; nothing where the camera sees no colours.

    colours : the maps in red, green and blue, or in grey.
    beside : maps of a panel that a single light shines through, and that has no convergence of its
        own. How far its colours are apart in the photo is the camera's doing, and is subtracted.

    Returns (places, 2, 2) float64, red minus green and blue minus green over the photo, right and
    down in panel pixels; and the 95th percentiles of their lengths as figures.
    """
    if len(colours) == 1:
        return np.zeros((0, 2, 2)), []
    green = colours[1]
    places = _both_see(green, None if beside is None else beside[1])
    found = _colours_apart(colours, places)
    if beside is not None:
        # The shift in the photo, converted to pixels of this panel.
        in_photo = _times(np.linalg.inv(beside[1].slope(places)), _colours_apart(beside, places))
        found = found - _times(green.slope(places), in_photo)
    given = []
    for number, (name, other) in enumerate((("red", colours[0]), ("blue", colours[2]))):
        far = float(np.percentile(np.hypot(*found[:, number].T), 95.0))
        sigma = float(np.median(np.hypot(other.sigma_px(places), green.sigma_px(places))))
        given.append(_figure(f"{panel}.{name}_apart_px", far, sigma, _APART_PX))
    return found, given


def _both_see(one: FittedMap, other: FittedMap | None) -> Floats:
    """Places (n, 2) over the photo that lie on a panel, and on the other one where it is given."""
    width, height = one.map.size_px
    places = np.stack(
        np.meshgrid((np.arange(24) + 0.5) / 24 * width, (np.arange(16) + 0.5) / 16 * height), -1
    ).reshape(-1, 2)
    for fitted in (one,) if other is None else (one, other):
        places = places[_within(fitted.to_target(places), fitted.target_size_px)]
    return np.asarray(places)


def _colours_apart(colours: Sequence[FittedMap], places: Floats) -> Floats:
    """Red minus green and blue minus green at places (n, 2) of the photo, (n, 2, 2), in pixels of
    the panel.

    Light of one pixel is seen at different places in two colours: the shift in the photo, in panel
    pixels, is the difference of the maps with its sign reversed.
    """
    red, green, blue = (one.to_target(places) for one in colours)
    return np.stack([green - red, green - blue], axis=1)


def _times(slopes: NDArray[np.floating[Any]], vectors: Floats) -> Floats:
    """Slopes (n, 2, 2) times vectors (n, colours, 2)."""
    return np.asarray(np.einsum("nij,ncj->nci", slopes, vectors))


def _figure(
    name: str, value: float, sigma: float, limit: float, refused: float = _REFUSED
) -> MeasuredFigure:
    """A figure that must not exceed its limit, and is bad beyond `refused` times that; inliers must
    not fall below theirs."""
    if name.endswith(("inliers", "seen")):
        good, bad = value >= limit, 1.0 - value > refused * (1.0 - limit)
        text, unit = f"at least {limit:g}", ""
    else:
        good, bad = value <= limit, value > refused * limit
        text, unit = f"at most {limit:.3g} px", "px"
    verdict = Verdict.GOOD if good else Verdict.BAD if bad else Verdict.DOUBTFUL
    return MeasuredFigure(name, value, float(sigma), unit, text, verdict)


def _fit_dots(dots: Dots, frame: tuple[int, int]) -> FittedMap:
    """A map fitted to dots as they are; their errors are those of the photo."""
    grid, size = dots.grid, (frame[1], frame[0])
    slope = np.linalg.lstsq(
        np.column_stack([dots.camera_px, np.ones(len(dots.index))]), dots.panel_px, rcond=None
    )[0][:2]
    sigma = np.sqrt((dots.sigma_px**2 + _FLOOR_QUADS**2) @ slope**2)
    return fit_map(PointPairs(dots.camera_px, dots.panel_px, sigma), size, grid.size_px, grid.panel)


def _disc_shift(fitted: FittedMap, panel_px: Floats, radius_px: float) -> Floats:
    """Centroids of discs in the photo less the places where their centres are seen, (n, 2) in
    quads."""
    rings, around = _DISC
    radii = radius_px * np.sqrt((np.arange(rings) + 0.5) / rings)
    angles = 2.0 * np.pi * np.arange(around) / around
    steps = radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    points = panel_px[:, None, :] + steps.reshape(-1, 2)
    size = fitted.target_size_px
    seen = fitted.map.from_field(points / size)
    area = 1.0 / np.abs(np.linalg.det(fitted.slope(seen)))[..., None]
    middle = fitted.map.from_field(panel_px / size)
    return np.asarray((seen * area).sum(axis=1) / area.sum(axis=1) - middle)


def check_dot_coverage(
    fitted: FittedMap,
    dots: Dots,
    *,
    other: DotGrid | None = None,
    beside: FittedMap | None = None,
    subject: SubjectName = "card",
) -> None:
    """Raise CalibrationError where dots are missing in the part of a panel that the camera sees, or
    where that part is too small.

    other : dots of the other panel, by which swapped outputs are recognised. beside : its map;
        where the panels differ in shape, the light that it lets pass falls only on a part of this
        one. subject : a scene hides some dots.
    """
    grid, frame = dots.grid, fitted.map.size_px
    rows, cols = grid.shape
    every = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1).reshape(-1, 2)
    places = fitted.map.from_field(grid.centres(every) / grid.size_px)
    margin = RING * grid.radius_px * quads_per_px(fitted) + 2.0
    framed = inside = _within(places, frame, margin)
    if beside is not None:
        # As far from its edges as a dot and its ring reach, in its own pixels.
        reach = margin / quads_per_px(beside)
        inside = framed & _within(beside.to_target(places), beside.target_size_px, reach)
    found = np.zeros((rows, cols), dtype=np.bool_)
    found[dots.index[:, 1], dots.index[:, 0]] = True
    padded = np.pad(found, _NEIGHBOURS)
    side = 2 * _NEIGHBOURS + 1
    near = np.lib.stride_tricks.sliding_window_view(padded, (side, side)).mean(axis=(2, 3)) >= 0.2
    seen = float(near.ravel()[inside].mean()) if inside.any() else 0.0
    if seen < _LEAST_SEEN[subject]:
        _check_cut(dots, other)
        raise CalibrationError(
            f"dots are seen on {seen:.0%} only of the part of the {grid.panel} that the camera "
            "sees",
            device=grid.panel,
            hint="something covers the field, or the card is too small: clear the way, use a "
            "larger card",
        )
    if framed.mean() < _LEAST_IN_FRAME:
        raise CalibrationError(
            f"only {framed.mean():.0%} of the {grid.panel} lies in the camera's frame",
            device=grid.panel,
            hint="move the camera back or zoom out until it sees the whole picture",
        )


def _check_cut(dots: Dots, other: DotGrid | None) -> None:
    """Raise CalibrationError where only as much is seen as a panel of the other one's size
    shows."""
    grid = dots.grid
    if other is None or other.size_px == grid.size_px:
        return
    most = dots.panel_px.max(axis=0) + grid.pitch_px
    least = np.minimum(other.size_px, grid.size_px)
    cut = np.array(other.size_px) < np.array(grid.size_px)
    # The last dot that is wholly within lies at most a pitch from the edge of what is shown.
    if cut.any() and (np.abs(most - least)[cut] <= 1.0 * grid.pitch_px).all():
        raise CalibrationError(
            f"of the {grid.panel}'s picture, {grid.size_px[0]} x {grid.size_px[1]} pixels, only "
            f"the upper left {other.size_px[0]} x {other.size_px[1]} are seen",
            device=grid.panel,
            hint=_SWAPPED,
        )


def _blocks(decoded: DecodedQuads, first: FittedMap, step: int, offset_quads: Floats) -> PointPairs:
    """Residuals of a first fit, averaged over blocks without outliers, at the mean places."""
    rows, cols = (side // step for side in decoded.valid.shape)
    whole = np.s_[: rows * step, : cols * step]
    y, x = np.mgrid[: rows * step, : cols * step] + 0.5
    x, y = x + offset_quads[0], y + offset_quads[1]
    error = decoded.panel_px[whole] - first.to_target(np.stack([x, y], axis=-1))
    good = decoded.valid[whole] & np.isfinite(error).all(axis=-1)
    middle = np.median(error[good][:: max(1, step)], axis=0)
    spread = mad_px(error[good][:: max(1, step)] - middle)
    good &= np.hypot(*np.moveaxis(error - middle, -1, 0)) < _CLIPPED * spread + _CLOSE_PX

    def sums(values: Floats) -> Floats:
        kept = np.where(good, values, 0.0).reshape(rows, step, cols, step)
        return np.asarray(kept.sum(axis=(1, 3)).ravel())

    count = sums(np.ones(good.shape))
    enough = count >= _LEAST_IN_BLOCK * step**2
    per = 1.0 / np.maximum(count, 1.0)
    source = np.stack([sums(x) * per, sums(y) * per], axis=-1)[enough]
    moved = np.stack([sums(error[..., axis]) * per for axis in (0, 1)], axis=-1)[enough]
    variance = [sums(decoded.sigma_px[whole][..., axis] ** 2) * per**2 for axis in (0, 1)]
    sigma = np.sqrt(np.stack(variance, axis=-1)[enough])
    return PointPairs(source, first.to_target(source) + moved, sigma)


def _on_panel(fitted: FittedMap) -> Floats:
    """Places of the photo, evenly over what it shows of the panel, (n, 2)."""
    at = (np.arange(12) + 0.5) / 12
    places = fitted.map.from_field(np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2))
    return np.asarray(places[_within(places, fitted.map.size_px)])


def quads_per_px(fitted: FittedMap) -> float:
    """Quads per pixel of the panel, along a side, in the middle of the photo."""
    middle = 0.5 * np.array([fitted.map.size_px], dtype=np.float64)
    return float(1.0 / np.sqrt(abs(np.linalg.det(fitted.slope(middle)[0]))))


def quads_across_px(panel: Map, camera: Map) -> float:
    """Quads of the photo from one pixel of a panel to the next one in its row, in its middle."""
    middle = 0.5 * np.array(panel.size_px, dtype=np.float64)
    ends = [map_between(panel, camera, middle + np.array([step, 0.0])) for step in (-0.5, 0.5)]
    return float(np.hypot(*(ends[1] - ends[0])))


def _apart(one: Map, two: Map) -> float:
    """Mean distance of two maps over the middle of the photo, in their unit square."""
    at = np.linspace(0.3, 0.7, 5)
    places = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2) * one.size_px
    return float(np.hypot(*(one.to_field(places) - two.to_field(places)).T).mean())
