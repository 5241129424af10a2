"""The maps of a configuration: where projector, mask and camera lie on the field."""

from __future__ import annotations

from dataclasses import dataclass

from pdcd.bench.tables import Config
from pdcd.frames.panels import PanelView
from pdcd.maps.map import Map
from pdcd.maps.placing import placed


@dataclass(frozen=True)
class Panels:
    """Both panels as `pdcd.frames.draw.draw` wants them."""

    projector: PanelView
    mask: PanelView


def panels_of(config: Config) -> Panels:
    """Both panels, placed. Raises ConfigError for a map that cannot be used."""
    size_px = config.projector.size_px
    return Panels(
        PanelView("projector", placed(config.projector.place, size_px, size_px, "projector")),
        PanelView("mask", placed(config.mask.place, config.mask.size_px, size_px, "mask")),
    )


def camera_map(config: Config, frame: tuple[int, int]) -> Map:
    """The map of a camera whose photos have so many rows and columns of Bayer quads.

    Raises ConfigError for a map that cannot be used.
    """
    rows, cols = frame
    return placed(config.camera.place, (cols, rows), config.projector.size_px, "camera")
