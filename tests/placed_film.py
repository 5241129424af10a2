"""The mock scene on films of any size, placed by a map: RAW files whose truth is known.

Light is that of whole cells, as the mock bench has it for whole windows; each quad gathers it at
SIDE x SIDE points of its own area. Or the bench of pixels says what each quad sees, with windows.
Nothing of how pdcd decodes is used for it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.mock import MockBench
from drivers.virtual_camera import BenchFilm, CameraExposure
from pdcd.bench.devices import DriverContext
from pdcd.panels.map import Map
from pdcd.sensor.dng import encode_dng
from pdcd.sensor.profile import expose_sensor, load_profile, responsivity_e
from tests.cr2 import LEFT_450D, SIZE_450D, TOP_450D, write_cr2
from tests.masked_dng import write_masked_dng

Floats = NDArray[np.float64]
Samples = NDArray[np.uint16]

SIDE = 4
TOP, LEFT = 6, 30
"""Masked rows and columns of `masked_dng`."""


def through(cells: Floats, map_: Map, side: int = SIDE) -> Floats:
    """Values of cells (rows, cols, C) -> of quads (h, w, C), their mean over the area of each, at
    side x side points."""
    rows, cols = cells.shape[:2]
    width, height = map_.size_px
    total = np.zeros((height, width, cells.shape[2]))
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    for down in range(side):
        for right in range(side):
            point = np.stack([x + (right + 0.5) / side, y + (down + 0.5) / side], axis=-1)
            u, v = np.moveaxis(map_.to_field(point), -1, 0)
            inside = (u >= 0.0) & (u < 1.0) & (v >= 0.0) & (v < 1.0)
            column = np.where(inside, u * cols, 0.0).astype(int)
            row = np.where(inside, v * rows, 0.0).astype(int)
            total += cells[row, column] * inside[..., None]
    return total / side**2


@dataclass(frozen=True)
class Shot:
    """What an encoder makes a file of."""

    samples: Samples
    """(H, W) of the picture, RGGB."""
    black: int
    white: int
    iso: int
    f_number: float
    exposure_s: float
    model: str = "test camera"
    orientation: int = 1


Encode = Callable[[Shot], bytes]


def dng(shot: Shot) -> bytes:
    """Without a border."""
    return encode_dng(
        shot.samples,
        black=shot.black,
        white=shot.white,
        iso=shot.iso,
        exposure_s=shot.exposure_s,
        f_number=shot.f_number,
        model=shot.model,
        date=datetime(2026, 1, 2, 3, 4, 5),
    )


def masked_dng(shot: Shot) -> bytes:
    """With masked rows and columns, which are blacker than the tags say, and an orientation."""
    height, width = shot.samples.shape
    sensor = np.full((height + TOP, width + LEFT), shot.black, np.uint16)
    sensor[TOP:, LEFT:] = shot.samples
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "photo.dng"
        write_masked_dng(
            path,
            sensor,
            active=(TOP, LEFT, TOP + height, LEFT + width),
            masked=(TOP, 0, TOP + height, LEFT),
            orientation=shot.orientation,
            black=shot.black - 7,
        )
        return path.read_bytes()


def cr2(shot: Shot) -> bytes:
    """A CR2 of an EOS 450D: masked left and top; takes only its own size, 4290 x 2856."""
    sensor = np.full(SIZE_450D, shot.black, np.uint16)
    height, width = shot.samples.shape
    sensor[TOP_450D : TOP_450D + height, LEFT_450D : LEFT_450D + width] = shot.samples
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "photo.cr2"
        write_cr2(path, sensor, iso=shot.iso, orientation=shot.orientation)
        return path.read_bytes()


class PlacedFilm(BenchFilm):
    """The mock bench, seen through a map by a sensor without noise.

    `encode` makes the file; `change` may exchange map and shot of the exposure of that number,
    counted from 1. Of `windows` the bench of pixels tells, whose camera then is the configured one.
    """

    def __init__(
        self,
        context: DriverContext,
        map_: Map,
        encode: Encode = dng,
        orientation: int = 1,
        change: Callable[[int, Shot], Shot] = lambda _, shot: shot,
        side: int = SIDE,
        *,
        windows: bool = False,
    ) -> None:
        super().__init__(context)
        config = context.config.camera
        self._seen = MockBench.of(context)
        self._map, self._encode, self._change = map_, encode, change
        self._orientation, self._side, self._windows = orientation, side, windows
        self._profile = load_profile(config.profile)
        self._responsivity_e = responsivity_e(config)
        self._f_number = 8.0 if config.f_number == "auto" else float(config.f_number)
        self.count = 0

    def make_raw(self, exposure: CameraExposure) -> bytes:
        self.count += 1
        bench, profile = self._seen, self._profile
        open_ns, close_ns = bench.exposed_ns()
        f_number = exposure.f_number or self._f_number
        quads = self._light() * self._responsivity_e / f_number**2
        mosaic = np.empty((2 * quads.shape[0], 2 * quads.shape[1]))
        mosaic[0::2, 0::2] = quads[..., 0]
        mosaic[0::2, 1::2] = mosaic[1::2, 0::2] = quads[..., 1]
        mosaic[1::2, 1::2] = quads[..., 2]
        seconds = (close_ns - open_ns) * 1e-9
        shot = Shot(
            samples=expose_sensor(mosaic, profile, exposure.iso, seconds, None),
            black=profile.black_dn,
            white=profile.white_dn,
            iso=exposure.iso,
            f_number=f_number,
            exposure_s=seconds,
            orientation=self._orientation,
        )
        bench.photo_taken()
        return self._encode(self._change(self.count, shot))

    def _light(self) -> Floats:
        """Light of the last exposure at the quads, (h, w, 3)."""
        if self._windows:
            return self._seen.quads()
        cells = self._seen.photo().reshape(*self._seen.scene.grid, 3)
        return through(cells, self._map, self._side)
