"""The maps of a configuration: where projector, mask and camera lie on the field.

The configuration gives places on the projector's picture. The field is that picture, or the part of
it that all three devices share (`PanelConfig.field_px`); this module converts the one into the
other.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pdcd.bench.tables import Config, PanelConfig
from pdcd.errors import ConfigError
from pdcd.panels.atoms import find_shown_cells
from pdcd.panels.map import Map, MapMatrix, PanelView, to_map_matrix
from pdcd.panels.map_file import load_map
from pdcd.panels.map_soundness import (
    check_share,
    compute_field_share,
    find_fewest_pixels,
    is_field_covered,
)
from pdcd.panels.placing import make_placed_map

_Role = Literal["projector", "mask"]


_OBLONG = 1.1
"""Ratio of a cell's sides from which on it is reported as oblong."""


def describe_oblong_cells(config: Config, grid: tuple[int, int]) -> str:
    """A sentence for cells of a grid (rows, columns) that are not square on the scene, with a grid
    that makes them square; "" where they are square."""
    (wide, high), (rows, cols) = config.projector.field_size_px, grid
    across, down = wide / cols, high / rows
    if max(across, down) <= _OBLONG * min(across, down):
        return ""
    return (
        f"cells of {rows} x {cols} are oblong, {across:.4g} x {down:.4g} projector pixels: "
        f"grid = [{max(1, round(high / across))}, {cols}] makes squares"
    )


@dataclass(frozen=True)
class Panels:
    """Both panels as `pdcd.panels.draw.draw` wants them."""

    projector: PanelView
    mask: PanelView


def panels_of(config: Config) -> Panels:
    """Both panels, placed. Raises ConfigError for a map that cannot be used, or that leaves most of
    the field without a pixel of the panel (`pdcd.panels.map_soundness.LEAST_SHARE`)."""
    return place_panels(config.projector, config.mask)


def place_panels(projector: PanelConfig, mask: PanelConfig) -> Panels:
    """The same from the tables of both."""
    return Panels(_view(projector, "projector", projector), _view(mask, "mask", projector))


def map_to_field(map_: Map, projector: PanelConfig) -> Map:
    """The map of a device to the field, given its map to the projector's picture."""
    if projector.field_px is None:
        return map_
    (left, top, wide, high), (width, height) = projector.field_px, projector.size_px
    to_field = np.diag([width / wide, height / high, 1.0])
    to_field[:2, 2] = -left / wide, -top / high
    return map_.then(to_field)


def map_plane_to_field(plane: MapMatrix, projector: PanelConfig) -> MapMatrix:
    """A homography of the projector's picture, converted to one of the field."""
    if projector.field_px is None:
        return plane
    own = map_to_field(Map(size_px=(1, 1), homography=to_map_matrix(np.eye(3))), projector)
    to_field = np.array(own.homography).reshape(3, 3)
    return to_map_matrix(to_field @ np.array(plane).reshape(3, 3) @ np.linalg.inv(to_field))


def place_panel(panel: PanelConfig, role: _Role, projector: PanelConfig) -> Map:
    """The map of one panel to the field. Raises ConfigError for a place that cannot be used."""
    return map_to_field(
        make_placed_map(panel.place, panel.size_px, projector.size_px, role), projector
    )


def make_camera_map(config: Config, frame: tuple[int, int]) -> Map:
    """The map of a camera whose photos have so many rows and columns of Bayer quads.

    Raises ConfigError for a map that cannot be used, that is of photos of another size, or that
    does not show the field at all.
    """
    rows, cols = frame
    map_ = make_placed_map(config.camera.place, (cols, rows), config.projector.size_px, "camera")
    return check_share(map_to_field(map_, config.projector), "camera", least=0.0)


def compute_mock_frame(config: Config, grid: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of the mock camera's quads; `grid` is that of the codes."""
    if config.camera.frame_quads is not None:
        width, height = config.camera.frame_quads
        return height, width
    per_cell = config.camera.quads_per_cell
    return grid[0] * per_cell, grid[1] * per_cell


def find_place_faults(config: Config) -> Iterator[tuple[str, str]]:
    """Each device whose place cannot be used, and why, in one line; no device is touched.

    The number of quads of a real camera is not known here. A homography by hand is only checked for
    faults that any frame would show; the rest follows when the camera reports its size.
    """
    for role in _PANELS:
        try:
            _panel(config, role)
        except ConfigError as err:
            yield role, err.message
    place = config.camera.place
    try:
        given = load_map(place.map, "camera") if isinstance(place.map, str) else place.map
        frame = _FRAME_PX if given is None else given.size_px
        if place.homography is None:
            make_camera_map(config, (frame[1], frame[0]))
        else:
            make_placed_map(place, (1, 1), config.projector.size_px, "camera")
    except ConfigError as err:
        yield "camera", err.message


def find_small_cells(
    config: Config, grid: tuple[int, int], needed_px: float
) -> Iterator[tuple[str, float]]:
    """Each panel on which a cell's side has fewer pixels than needed at the place of its map, and
    how many it has. Panels whose place cannot be used are left out; `find_place_faults` reports
    these."""
    for panel in _usable(config):
        cell_px = find_fewest_pixels(panel.map, grid)
        if cell_px is not None and cell_px < needed_px * (1.0 - _NEAR):
            yield panel.role, cell_px


def find_dark_places(config: Config, grid: tuple[int, int]) -> Iterator[tuple[str, str]]:
    """Each panel that leaves part of the field without a pixel, and how much: such places stay
    dark. Panels whose place cannot be used are left out."""
    for panel in _usable(config):
        blind = int(np.count_nonzero(~find_shown_cells(panel, grid)))
        if blind:
            rows, cols = grid
            yield panel.role, f"{blind} of {rows} x {cols} cells have no pixel on the {panel.role}"
        elif not is_field_covered(panel.map):
            dark = 1.0 - compute_field_share(panel.map, _FINELY)
            much = f"about {dark:.0%}" if dark >= 0.01 else "less than 1%"
            yield panel.role, f"{much} of the field has no pixel of the {panel.role}"


def _usable(config: Config) -> Iterator[PanelView]:
    for role in _PANELS:
        with suppress(ConfigError):
            yield _panel(config, role)


_NEAR = 1e-9
"""Relative rounding error by which a cell may be too small."""
_FINELY = 512
"""Points along a side at which the share of the field is computed."""
_FRAME_PX = (300, 200)
"""Size in quads of an assumed camera frame: only its shape matters, not its resolution."""
_PANELS: tuple[_Role, ...] = ("projector", "mask")


def _panel(config: Config, role: _Role) -> PanelView:
    panel = config.projector if role == "projector" else config.mask
    return _view(panel, role, config.projector)


def _view(panel: PanelConfig, role: _Role, projector: PanelConfig) -> PanelView:
    return PanelView(role, check_share(place_panel(panel, role, projector), role))
