"""Figures of each picture of a live view: sharpness, brightness, saturation, and where the field
is."""

from __future__ import annotations

import math
from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.placed import make_camera_map
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError, ExposureError
from pdcd.files.images import encode_jpeg
from pdcd.panels.map import Map
from pdcd.protocol.views import LiveFrame
from pdcd.sensor.finder_picture import read_finder_light

_MOST_PX = 800
"""Longest side of a picture that is sent on: as a JPEG it then fits easily into a line of the
socket."""
_FINE_PX = 2.0
"""Standard deviation, in pixels of the camera, of the blur that removes fine detail."""
_WHITE = 254
"""Level from which a pixel of a JPEG is white."""
_EDGE_POINTS = 12
"""Points of the field's outline on each side: maps may bend it."""
_RATE_S, _LEAST_S = 2.0, 0.25
"""Time over which pictures are counted, and time below which no rate is given yet."""

_Outline = tuple[tuple[float, float], ...]


class PictureRate:
    """Counts the pictures of a live view or a stream."""

    def __init__(self) -> None:
        self._came_s: deque[float] = deque()

    def count(self, now_s: float) -> float:
        """Count a picture that came now; returns the recent rate in pictures per second."""
        self._came_s.append(now_s)
        while now_s - self._came_s[0] > _RATE_S and len(self._came_s) > 2:
            self._came_s.popleft()
        span_s = now_s - self._came_s[0]
        return (len(self._came_s) - 1) / span_s if span_s > _LEAST_S else 0.0


class LiveFrames:
    """Makes the frames of one live view, in their order."""

    def __init__(self, config: Config, frame_quads: tuple[int, int] | None) -> None:
        """frame_quads : width and height of the camera's photos, where they are known."""
        self._outline = find_field_outline(config, frame_quads)
        self._masks: dict[tuple[int, ...], NDArray[np.uint8]] = {}
        self._rate = PictureRate()
        self.count = 0
        self._best = 0.0

    def make(self, picture: NDArray[np.uint8], came_ns: int) -> LiveFrame:
        """The frame for a picture. Raises ExposureError for an array that is not a picture."""
        if picture.dtype != np.uint8 or 0 in picture.shape or picture.shape[2:] not in ((), (3,)):
            raise ExposureError(
                f"the finder gave no picture but {picture.dtype} of {picture.shape}",
                device="camera",
                hint="update the driver",
            )
        self.count += 1
        inside = self._inside(picture.shape[:2])
        light = read_finder_light(picture)
        most = (_WHITE - 1.0,) * (picture.shape[2] if picture.ndim == 3 else 1)
        below = cv2.inRange(picture, (0.0,) * len(most), most)
        focus = measure_detail(light, inside)
        self._best = max(self._best, focus)
        small = _shrink(picture)
        return LiveFrame(
            number=self.count,
            t_mono_ns=came_ns,
            rate_hz=self._rate.count(came_ns * 1e-9),
            focus=focus,
            best=self._best,
            mean=cv2.mean(light, inside)[0],
            saturated=1.0 - cv2.mean(below, inside)[0] / 255.0,
            outline=self._outline,
            size_px=(small.shape[1], small.shape[0]),
            jpeg=encode_jpeg(small),
        )

    def _inside(self, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """1 for the pixels of the field; 1 for all pixels where nothing of the field is seen."""
        if shape not in self._masks:
            drawn = np.zeros(shape, np.uint8)
            if self._outline:
                corners = np.array(self._outline) * shape[::-1] - 0.5
                cv2.fillPoly(drawn, [np.rint(corners).astype(np.int32)], (1,))
            self._masks = {shape: drawn if drawn.any() else np.ones(shape, np.uint8)}
        return self._masks[shape]


def find_field_outline(config: Config, frame_quads: tuple[int, int] | None) -> _Outline:
    """Edge of the field in a picture of the camera, 0..1 right and down, by the calibration in use
    or by the places in the configuration; () where neither gives it."""
    place = config.camera.place
    if isinstance(place.map, Map):
        frame_quads = place.map.size_px
    elif not place.by_hand or frame_quads is None:
        return ()
    width, height = frame_quads
    try:
        map_ = make_camera_map(config, (height, width))
    except ConfigError:
        return ()
    along = np.arange(_EDGE_POINTS) / _EDGE_POINTS
    none = np.zeros(_EDGE_POINTS)
    top = np.stack([along, none], axis=1)
    right = np.stack([none + 1.0, along], axis=1)
    edge = np.concatenate([top, right, 1.0 - top, 1.0 - right])
    points = map_.from_field(edge) / (width, height)
    if not np.isfinite(points).all():
        return ()
    return tuple((float(x), float(y)) for x, y in np.clip(points, -1.0, 2.0))


def measure_detail(light: NDArray[np.float32], inside: NDArray[np.uint8]) -> float:
    """How deep the finest detail is: amplitude over mean light, the measure that the focus step of
    a calibration uses for its stripes. Here it depends on the scene, so values are comparable only
    with each other.

    light : (h, w), linear. inside : (h, w), 1 where it counts.
    """
    mean = cv2.mean(light, inside)[0]
    if mean <= 0.0:
        return 0.0
    fine = light - cv2.GaussianBlur(light, (0, 0), _FINE_PX, borderType=cv2.BORDER_REPLICATE)
    return math.sqrt(2.0 * cv2.mean(np.square(fine), inside)[0]) / mean


def _shrink(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = picture.shape[:2]
    over = max(height, width) / _MOST_PX
    if over <= 1.0:
        return picture
    size = max(1, round(width / over)), max(1, round(height / over))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
