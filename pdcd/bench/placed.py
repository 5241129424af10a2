"""The maps of a configuration: where projector, mask and camera lie on the field."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from pdcd.bench.tables import Config
from pdcd.errors import ConfigError
from pdcd.frames.panels import PanelView
from pdcd.maps.map import Map
from pdcd.maps.placing import placed
from pdcd.maps.sound import check_share


@dataclass(frozen=True)
class Panels:
    """Both panels as `pdcd.frames.draw.draw` wants them."""

    projector: PanelView
    mask: PanelView


def panels_of(config: Config) -> Panels:
    """Both panels, placed. Raises ConfigError for a map that cannot be used, or that leaves most
    of the field without a pixel of the panel (`pdcd.maps.sound.LEAST_SHARE`)."""
    return Panels(_panel(config, "projector"), _panel(config, "mask"))


def camera_map(config: Config, frame: tuple[int, int]) -> Map:
    """The map of a camera whose photos have so many rows and columns of Bayer quads.

    Raises ConfigError for a map that cannot be used, that is of photos of another size, or that
    does not show the field at all.
    """
    rows, cols = frame
    map_ = placed(config.camera.place, (cols, rows), config.projector.size_px, "camera")
    return check_share(map_, "camera", least=0.0)


def place_faults(config: Config) -> Iterator[tuple[str, str]]:
    """Each device whose place cannot be used, and why, on one line; nothing is read or touched.

    How many quads a real camera has is not known here: a homography by hand is only looked at for
    what would be wrong with any frame, and the rest when the camera tells its size.
    """
    for role in PANELS:
        try:
            _panel(config, role)
        except ConfigError as err:
            yield role, err.message
    place = config.camera.place
    frame = place.map.size_px if isinstance(place.map, Map) else FRAME_PX
    try:
        if place.homography is None:
            camera_map(config, (frame[1], frame[0]))
        else:
            placed(place, (1, 1), config.projector.size_px, "camera")
    except ConfigError as err:
        yield "camera", err.message


FRAME_PX = (300, 200)
"""Quads of a camera of which only the form counts, not how fine it is."""
PANELS: tuple[Literal["projector", "mask"], ...] = ("projector", "mask")


def _panel(config: Config, role: Literal["projector", "mask"]) -> PanelView:
    panel = config.projector if role == "projector" else config.mask
    map_ = placed(panel.place, panel.size_px, config.projector.size_px, role)
    return PanelView(role, check_share(map_, role))
