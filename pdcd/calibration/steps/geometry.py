"""Where projector, mask and camera lie on one field: dots of both panels on a card."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.placed import camera_map, panels_of
from pdcd.calibration.arrows import arrows
from pdcd.calibration.charts import sheet
from pdcd.calibration.compose import Composed, compose, one_field
from pdcd.calibration.dots import DotGrid
from pdcd.calibration.finding import Dots, find_dots
from pdcd.calibration.fit import Fitted
from pdcd.calibration.panel_map import (
    believed_map,
    check_believed,
    convergence,
    figures,
    fit_dots,
    turned_against,
)
from pdcd.calibration.photo import Photo
from pdcd.calibration.script import Ask, Measured, Outcome, Script, Session, Taken, Wanted, take
from pdcd.calibration.stripes import slope_at
from pdcd.errors import CalibrationError, ConfigError
from pdcd.maps.map import Map

Floats = NDArray[np.float64]

GREEN = 1
"""The colour that cells go by."""
LEAST_RADIUS_QUADS = 1.2
"""Radius of a dot in a photo below which its centre is not found."""
ALIKE_DEG = 20.0
"""Turns of both panels that differ by less are one turn of the camera."""


def geometry(session: Session) -> Script:
    """White, black and dots of each panel: six photos.

    The maps that come out replace the places of all three devices.
    """
    projector, mask = grids(session)
    of_projector, first, _ = yield from panel_dots(session, projector, mask)
    of_mask, second, _ = yield from panel_dots(session, mask, projector)
    composed = compose(first[GREEN], second[GREEN])
    _refuse_unlike(session, composed)
    field = one_field(composed)
    maps = {"projector": field.projector, "mask": field.mask, "camera": field.camera}
    words = {f"{name}.place.map": Measured("maps.npz") for name in maps}
    words["mask.offset_px"] = Measured((0.0, 0.0))
    told = [
        *figures(first[GREEN], "projector"),
        *figures(second[GREEN], "mask", finer(field.mask, field.projector)),
        *convergence(first, "projector", second)[1],
    ]
    return Outcome(
        figures=tuple(told),
        picture=_picture((of_projector[GREEN], first[GREEN]), (of_mask[GREEN], second[GREEN])),
        words=words,
        maps=maps,
        arrays={
            **_kept("projector", of_projector[GREEN], first[GREEN]),
            **_kept("mask", of_mask[GREEN], second[GREEN]),
        },
    )


def finer(mask: Map, projector: Map) -> float:
    """Pixels of the mask to one of the projector, along a side, in the middle of the mask."""
    middle = 0.5 * np.array([mask.size_px], dtype=np.float64)
    slopes = [slope_at(axis, projector, mask, middle)[0] for axis in (0, 1)]
    return float(1.0 / np.sqrt(abs(np.linalg.det(np.array(slopes)))))


def grids(session: Session) -> tuple[DotGrid, DotGrid]:
    """The dots of projector and mask."""
    projector, mask = session.sizes
    return DotGrid.usual("projector", projector), DotGrid.usual("mask", mask)


def panel_dots(
    session: Session, grid: DotGrid, other: DotGrid, prefix: str = ""
) -> Generator[Wanted | Ask, Taken | None, tuple[Sequence[Dots], list[Fitted], float]]:
    """Photos of one panel's pictures: its dots and maps in red, green and blue, and how bright the
    white one was in DN. prefix : of the photos' names."""
    photos: list[Photo] = []
    pattern = "RGGB"
    for shown in grid.shown(session.full):
        taken = yield from take(Wanted(replace(shown, name=prefix + shown.name)))
        photos.append(session.photo(taken))
        _refuse_coarse(photos[0].frame, grid)
        pattern = taken.raw.pattern
    dots = find_dots(photos[0], photos[1], photos[2], grid, other=other, pattern=pattern)
    bright = float(np.percentile(photos[0].light[..., GREEN], 90.0))
    return dots, [fit_dots(one, photos[0].frame, other=other) for one in dots], bright


def _refuse_coarse(frame: tuple[int, int], grid: DotGrid) -> None:
    """Raise CalibrationError where quads are so large that a dot has hardly any, even if the panel
    fills the photo."""
    across = max(frame[0] / grid.size_px[1], frame[1] / grid.size_px[0])
    if across * grid.radius_px < LEAST_RADIUS_QUADS:
        raise CalibrationError(
            f"a photo of {frame[1]} x {frame[0]} quads is too coarse for the {grid.panel}'s dots",
            device="camera",
            hint="set the camera to full-size RAW; of a mock bench, set camera.frame_quads",
        )


def _refuse_unlike(session: Session, composed: Composed) -> None:
    """Raise CalibrationError for a panel that is mirrored or turned unlike the configuration, where
    the other one is not: what both show alike is the camera's own way of looking."""
    found = composed.projector_of.map, composed.mask_of.map
    width, height = found[0].size_px
    try:
        panels = panels_of(session.config)
        camera = camera_map(session.config, (height, width))
    except ConfigError:
        return  # a belief that cannot be tells nothing
    believed = [believed_map(camera, one.map) for one in (panels.projector, panels.mask)]
    turns = [turned_against(*both) for both in zip(found, believed, strict=True)]
    apart = abs((turns[0][0] - turns[1][0] + 180.0) % 360.0 - 180.0)
    if turns[0][1] == turns[1][1] and apart < ALIKE_DEG:
        return
    for number, panel in enumerate(("projector", "mask")):
        check_believed(found[number], believed[number], panel, believed[1 - number])


def _picture(*panels: tuple[Dots, Fitted]) -> NDArray[np.uint8]:
    """What the maps of projector and mask leave of each dot."""
    picture = sheet(900, 420)
    for number, (dots, fitted) in enumerate(panels):
        size = np.array(dots.grid.size_px, dtype=np.float64)
        height = round(420 * size[1] / size[0])
        box = (20 + 440 * number, 60, 420, min(height, 480))
        title = f"{dots.grid.panel}: what the map leaves of {len(dots.index)} dots"
        arrows(picture, box, dots.panel_px / size, fitted.residual_px, title)
    return picture


def _kept(panel: str, dots: Dots, fitted: Fitted) -> dict[str, NDArray[np.generic]]:
    """What checks and later steps need of a panel."""
    return {
        f"{panel}.dots.index": dots.index,
        f"{panel}.dots.quads": dots.camera_px,
        f"{panel}.dots.sigma": dots.sigma_px,
        f"{panel}.blur_quads": np.array(dots.blur_quads),
        f"{panel}.fit.covariance": fitted.covariance,
        f"{panel}.fit.residual_px": fitted.residual_px,
    }
