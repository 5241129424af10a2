"""Pictures as the projector sees the scene: the field, sampled through the map of the camera.

The camera may stand askew, upside down or behind a mirror; its map says where each of its Bayer
quads lies on the field. Here the field is cut into pixels of its own, and each is interpolated
linearly between four quads of the camera's picture. Where that has more quads than the field gets
pixels, it is shrunk by area first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Singles
from pdcd.bench.placed import map_to_field, place_panels
from pdcd.panels.map import Map
from pdcd.panels.map_soundness import is_field_covered
from pdcd.panels.placing import make_placed_map
from pdcd.runs.record import RunRecord
from pdcd.sensor.bands import run_in_bands
from pdcd.sensor.cells import CellMap

_STEP_PX, _LEAST_STEPS = 16, 64
"""The map is evaluated every so many pixels, and at no fewer places; linear interpolation between
them is off by less than a hundredth of a quad."""
_HALF = 0.5
"""Share of a pixel that must be known for the pixel to be known."""


@dataclass(frozen=True)
class FieldView:
    """Where the camera stood, and what the field looks like.

    map : from the camera's quads to the field.
    aspect : width of the field over its height.
    white_patch : (x, y) of something white on the field, 0 to 1 each; None where none was named.
    """

    map: Map
    aspect: float
    white_patch: tuple[float, float] | None = None

    @classmethod
    def of(cls, record: RunRecord, cells: CellMap) -> FieldView:
        """The view of a run by the map of its photos."""
        width, height = record.projector.field_size_px
        return cls(cells.filled, width / height, record.white_patch)

    def size_px(self, least_px: int, most_px: int) -> tuple[int, int]:
        """(width, height) of a raster of the field, about as fine as the quads at its centre.

        least_px, most_px : bounds of the width.
        """
        across, down = self.quads()
        width = int(np.clip(np.rint(max(across, down * self.aspect)), least_px, most_px))
        return width, max(round(width / self.aspect), 1)

    def quads(self) -> tuple[float, float]:
        """Quads over the field's width and height, as at its centre; 0 where that is not seen."""
        centre = self.map.from_field((0.5, 0.5))
        if not np.isfinite(centre).all():
            return 0.0, 0.0
        quads = np.linalg.inv(self.map.jacobian(centre))
        return float(np.hypot(*quads[:, 0])), float(np.hypot(*quads[:, 1]))


def find_known_pixels(*values: NDArray[np.floating]) -> Bools:
    """Where all of the values (h, w, C) are finite in every channel, (h, w) bool."""
    # A product with ones is much faster than `all` along a short axis.
    sums = [value @ np.ones(value.shape[-1], value.dtype) for value in values]
    return np.asarray(np.logical_and.reduce([np.isfinite(s) for s in sums]), dtype=np.bool_)


class FieldSampler:
    """Samples pictures of one camera on one raster of the field."""

    def __init__(self, view: FieldView, size_px: tuple[int, int]) -> None:
        """`size_px`: (width, height) of the raster."""
        cols, rows = view.map.size_px
        across, down = view.quads()
        shrink = max(across / size_px[0], down / size_px[1], 1.0)
        self._last: tuple[Bools, Bools, Singles] | None = None
        self._shrunk = max(round(cols / shrink), 1), max(round(rows / shrink), 1)
        places = _places(view.map, size_px)
        x, y = places[..., 0], places[..., 1]
        self._inside: Bools = (x >= 0.0) & (x <= cols) & (y >= 0.0) & (y <= rows)
        places *= np.array([self._shrunk[0] / cols, self._shrunk[1] / rows], np.float32)
        # OpenCV counts from the centre of the first pixel.
        places = np.where(self._inside[..., None], places, np.float32(0.5)) - np.float32(0.5)
        self._right, self._down = (np.ascontiguousarray(places[..., axis]) for axis in (0, 1))

    def __call__(self, image: NDArray[np.floating], known: Bools) -> tuple[Singles, Bools]:
        """A picture (h, w, C), known at some quads (h, w) -> that of the field, (H, W, C) float32,
        and where that is known, (H, W) bool. It is 0 elsewhere."""
        # What is not known may be infinite, or no number.
        light, mask = np.empty(image.shape, np.float32), known.view(np.uint8)

        def band(rows: slice) -> None:
            whole = cv2.copyTo(np.ascontiguousarray(image[rows], np.float32), mask[rows])
            light[rows] = whole.reshape(light[rows].shape)  # OpenCV drops an axis of one

        run_in_bands(len(light), band)
        seen, weight = self._weighed(known)
        picture = self._sampled(light)
        picture *= weight[..., None]
        return picture, seen

    def _weighed(self, known: Bools) -> tuple[Bools, Singles]:
        """Where a picture on the field is known, and the factor to multiply it by there."""
        if self._last is None or not np.array_equal(self._last[0], known):
            share = self._sampled(known.astype(np.float32))
            seen: Bools = self._inside & (share >= _HALF)
            weight = np.divide(np.float32(1.0), share, out=np.zeros_like(share), where=seen)
            self._last = known, seen, weight  # pictures of one run mostly know the same quads
        return self._last[1:]

    def _sampled(self, values: NDArray[Any]) -> Singles:
        """Values of quads, (h, w) or (h, w, C) -> of pixels of the field, (H, W) or (H, W, C)."""
        channels = values.shape[2:]
        if self._shrunk != values.shape[1::-1]:
            values = np.asarray(cv2.resize(values, self._shrunk, interpolation=cv2.INTER_AREA))
        sampled = cv2.remap(
            values, self._right, self._down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(sampled, dtype=np.float32).reshape(*self._right.shape, *channels)


def _places(map_: Map, size_px: tuple[int, int]) -> Singles:
    """Where the centre of each pixel of the field lies in the camera, (H, W, 2) float32, quads."""
    x, y = (_nodes(n) for n in size_px)
    field = np.stack(np.meshgrid(x / size_px[0], y / size_px[1]), axis=-1)
    nodes = map_.from_field(field).astype(np.float32)
    return _between(_between(nodes, y, size_px[1]).swapaxes(0, 1), x, size_px[0]).swapaxes(0, 1)


def _nodes(length_px: int) -> NDArray[np.float64]:
    """Places from the centre of the first to that of the last pixel."""
    return np.linspace(0.5, length_px - 0.5, max(-(-length_px // _STEP_PX), _LEAST_STEPS) + 1)


def _between(nodes: Singles, at: NDArray[np.float64], length_px: int) -> Singles:
    """Values at nodes along the first axis -> at the centres of all pixels, linearly."""
    step = (at[-1] - at[0]) / (len(at) - 1) or 1.0
    along = (np.arange(length_px) + 0.5 - at[0]) / step
    first = np.minimum(along.astype(np.int64), len(at) - 2)
    rest = (along - first).astype(np.float32)[:, None, None]
    found: Singles = nodes[first] * (1 - rest) + nodes[first + 1] * rest
    return found


def place_quads(record: RunRecord, frame: tuple[int, int]) -> CellMap:
    """Where the quads of a run's frames of (h, w) lie, as it is configured. The darkroom calls this
    when the first photo has shown how large a frame is."""
    map_ = make_placed_map(record.camera_place, frame[::-1], record.projector.size_px, "camera")
    panels = place_panels(record.projector, record.mask)
    return CellMap(
        grid=record.grid,
        frame=frame,
        map=map_to_field(map_, record.projector),
        blur_quads=record.blur_quads,
        panels=tuple(
            view.map for view in (panels.projector, panels.mask) if not is_field_covered(view.map)
        ),
    )
