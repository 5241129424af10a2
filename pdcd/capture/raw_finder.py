"""A finder for cameras without one: short photos, one after the other, as fast as possible."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.devices import CameraSettings, PhotoFrame, RawFile
from pdcd.bench.exposure_time import tell_exposure_time
from pdcd.capture.rig import Rig
from pdcd.errors import ExposureError
from pdcd.sensor.colours import to_colours
from pdcd.sensor.finder_picture import choose_finder_gain, draw_finder_picture
from pdcd.sensor.profile import load_profile
from pdcd.sensor.raw import read_raw

_FIRST_S, _SHORTEST_S, _LONGEST_S = 0.05, 0.002, 0.2
"""Exposures: the first one, and their shortest and longest."""
_MOST_STEP = 8.0
"""Largest factor from one exposure to the next."""
_SATURATED, _MOST_SATURATED = 0.98, 0.05
"""Light from which a quad is saturated, and the share of quads that may be."""
_STOP = 5.6
"""Aperture of the lens, or the nearest to it, where the configuration gives none."""
_MOST_QUADS = 640
"""Quads along the longer side that are used; from more, every n-th is taken."""


class RawFinder:
    """Shutter and readout of a rig as a `Preview`, which chooses its exposures itself. The panels
    are lit meanwhile, so such photos are only looked at, never measured."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._exposure_s = _FIRST_S

    def connect(self) -> dict[str, str]:
        """Nothing to do: the rig has opened its devices already."""
        return {}

    def grab(self, timeout_s: float) -> NDArray[np.uint8]:
        """Take one photo. Raises what shutter and readout raise."""
        with tempfile.TemporaryDirectory(prefix="pdcd-live-") as folder:
            light = self._expose(Path(folder), timeout_s)
        step = choose_finder_gain(light)
        if float(np.mean(light >= _SATURATED)) > _MOST_SATURATED:  # nobody knows by how much
            step = 1.0 / _MOST_STEP
        wanted_s = self._exposure_s * min(max(step, 1.0 / _MOST_STEP), _MOST_STEP)
        self._exposure_s = min(max(wanted_s, _SHORTEST_S), _LONGEST_S)
        # Light that the next exposure does not make up for.
        gain = 1.0 if step <= 1.0 else min(step, _MOST_STEP)
        shown = light[..., 0] if light.shape[-1] == 1 else light
        return draw_finder_picture(shown * gain)

    def disconnect(self) -> None:
        """Close the shutter; the rig keeps its devices."""
        with self._rig.context.patience.deaf():
            self._rig.shutter.close()

    def _expose(self, folder: Path, timeout_s: float) -> Floats:
        """The light of one photo at some of its quads, with 1 for white, (h, w, C)."""
        rig, config = self._rig, self._rig.config
        info = rig.camera_info
        fixed = config.camera.f_number
        f_numbers = () if info is None else info.f_numbers
        nearest = min(f_numbers, key=lambda each: abs(each / _STOP - 1.0), default=None)
        f_number = nearest if fixed == "auto" else float(fixed)
        settings = CameraSettings(
            iso=config.camera.iso or load_profile(config.camera.profile).isos[0],
            f_number=f_number if f_numbers else None,
            exposure_s=self._exposure_s,
            longest_s=self._exposure_s + 1.0,
        )
        rig.readout.arm(settings)
        tell_exposure_time(rig.shutter, settings)
        rig.context.shared.exposed_ns = rig.context.shared.played = None
        open_ns = rig.shutter.open()
        try:
            rig.context.patience.sleep(self._exposure_s)
        finally:
            with rig.context.patience.deaf():
                close_ns = rig.shutter.close()
        rig.context.shared.exposed_ns = open_ns, close_ns
        photo = rig.readout.fetch(folder, "live", timeout_s)
        light = _read_frame(photo) if isinstance(photo, PhotoFrame) else _read_file(photo)
        # White balance: a white scene has equal colours.
        if info is None:
            return light
        return np.asarray(light * info.responsivity_e.max() / info.responsivity_e)


def _read_file(photo: RawFile) -> Floats:
    frame = read_raw(photo.path, sha256=photo.sha256, size_bytes=photo.size_bytes)
    some = slice(None, None, max(1, -(-max(frame.frame) // _MOST_QUADS)))
    light = to_colours(frame.planes[:, some, some])
    return light / float(frame.white - frame.black.mean())


def _read_frame(photo: PhotoFrame) -> Floats:
    """The same for samples in memory. Raises ExposureError for an unknown mosaic."""
    step = max(1, -(-max(photo.samples.shape) // (2 * _MOST_QUADS)))
    black = np.broadcast_to(np.asarray(photo.black, np.float64).ravel(), 4)
    span = photo.white - float(black.mean())
    if photo.cfa is None:
        samples = photo.samples[:: 2 * step, :: 2 * step].astype(np.float64)
        return np.asarray((samples - black[0]) / span)[..., None]
    colours = photo.cfa
    if sorted(colours) != sorted("RGGB"):
        raise ExposureError("the camera has no Bayer mosaic", device="camera", hint="use another")
    planes: dict[str, list[Floats]] = {}
    for place, colour in enumerate(colours):
        row, column = divmod(place, 2)
        samples = photo.samples[row :: 2 * step, column :: 2 * step].astype(np.float64)
        planes.setdefault(colour, []).append((samples - black[place]) / span)
    return np.stack([np.mean(planes[colour], axis=0) for colour in "RGB"], axis=-1)
