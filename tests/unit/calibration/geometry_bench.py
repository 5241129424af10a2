"""A bench on paper, by its physics: what a camera sees of pictures on two panels.

Nothing of the program's maps or estimators is used. A point of the photo is sent to the panel in
closed form: lens, keystone, then waves of a fraction of a pixel. Panels are looked up on a fine
raster, blurred by a Gaussian, and get photon and read noise.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import PanelSequence

Floats = NDArray[np.float64]

READ_E, GAIN = 16.8, 2.96
"""Of one sample, in electrons; green is the mean of two."""
PLACES = ((-0.25, -0.25), (0.0, 0.0), (0.25, 0.25))


@dataclass(frozen=True)
class Way:
    """How points of the photo (quads) lie on one panel (pixels)."""

    size_px: tuple[int, int]
    frame: tuple[int, int]
    scale: float = 1.76
    """Quads for each panel pixel, at the middle."""
    turn_deg: float = 0.0
    mirrored: bool = False
    shift_quads: tuple[float, float] = (0.0, 0.0)
    keystone: tuple[float, float] = (0.05, -0.03)
    """Change of scale from the middle to the frame's edge."""
    radial: float = 0.04
    """Shift at the corners by the lens, over the half diagonal."""
    waves_px: float = 0.4
    colour: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Lateral colour: by how much each colour is larger."""

    def to_panel(self, quads: Floats, channel: int = 1) -> Floats:
        """Points (..., 2) of the photo -> of the panel in pixels."""
        rows, cols = self.frame
        half = 0.5 * np.hypot(rows, cols)
        u = (quads - (0.5 * cols, 0.5 * rows)) / half
        u = u * (1.0 + self.radial * (u**2).sum(axis=-1, keepdims=True))
        u = u * (1.0 - self.colour[channel])
        wide = u * (2.0 * half / np.array([cols, rows]))
        per = 1.0 + wide @ np.array(self.keystone)
        u = u / per[..., None] - np.array(self.shift_quads) / half
        angle = np.radians(self.turn_deg)
        cos, sin = np.cos(angle), np.sin(angle)
        back = np.array([[cos, sin], [-sin, cos]])
        x = u @ back.T * (half / self.scale)
        if self.mirrored:
            x = x * (-1.0, 1.0)
        x = x + 0.5 * np.array(self.size_px)
        width, height = self.size_px
        s, t = x[..., 0] / width, x[..., 1] / height
        waves = np.stack(
            [np.sin(5.1 * s + 3.2 * t + 0.4), np.cos(4.3 * t - 2.9 * s + 1.1)], axis=-1
        )
        return np.asarray(x + self.waves_px * waves)


def small_way(panel: str = "projector", **changes: object) -> Way:
    """A panel of 256 x 192 (mask: 320 x 240) pixels in a photo of 320 x 480 quads."""
    size, scale = ((256, 192), 1.6) if panel == "projector" else ((320, 240), 1.28)
    return replace(Way(size, (320, 480), scale=scale), **changes)  # type: ignore[arg-type]


@dataclass(eq=False)
class Bench:
    """Two panels before one camera."""

    projector: Way
    mask: Way
    electrons: float = 25_000.0
    """Of white light, through the open mask, at the middle."""
    blur_quads: float = 1.0
    samples: int = 4
    ambient: float = 0.01
    leak: tuple[float, float] = (1 / 2000, 1 / 500)
    texture: Floats | None = None
    """(rows, cols) of the photo: albedo of the card."""
    covered: Floats | None = None
    """(rows, cols): 1 where light comes through, 0 where something stands before it."""
    full_e: float = 40_000.0
    grey: bool = True
    """Red and blue are copies of green: quicker."""
    groove: tuple[float, float] = (0.0, 1.0)
    """Share and blur (quads) of the light that comes again mirrored, as in a V-shaped groove."""

    def photo(self, shown: PanelSequence, seed: int | None) -> QuadPhoto:
        """What the camera sees; the mean over refreshes. Without a seed: without noise."""
        frame = self.projector.frame
        rng = np.random.default_rng(seed)
        y, x = np.mgrid[: frame[0], : frame[1]]
        away = np.hypot(y - 0.5 * frame[0], x - 0.5 * frame[1]) / np.hypot(*frame) * 2.0
        lamp = self.electrons * (1.0 - 0.4 * away**2)
        values, variance = np.empty((*frame, 3)), np.empty((*frame, 3))
        saturated = np.zeros(frame, dtype=np.bool_)
        for channel in (1, 0, 2):
            if self.grey and channel != 1:
                values[..., channel], variance[..., channel] = values[..., 1], variance[..., 1]
                continue
            light = self._light(shown, channel)
            if self.texture is not None:
                light = light * self.texture
            if self.covered is not None:
                light = light * self.covered
            light = gaussian_filter(light * lamp, self.blur_quads)
            saturated |= light >= self.full_e
            light = np.minimum(light, self.full_e)
            shots = 2.0 if channel == 1 else 1.0
            spread = (light + READ_E**2) / shots
            values[..., channel] = light
            variance[..., channel] = spread
            if seed is not None:
                noise = np.sqrt(spread) * rng.standard_normal(frame)
                values[..., channel] += noise
                measured = np.maximum(values[..., channel], 0.0)
                variance[..., channel] = (measured + READ_E**2) / shots
        return QuadPhoto(values, variance, saturated)

    def photos(self, shown: tuple[PanelSequence, ...], seed: int) -> list[QuadPhoto]:
        """One of each, with noise of its own."""
        return [self.photo(one, 1000 * seed + number) for number, one in enumerate(shown)]

    def _light(self, shown: PanelSequence, channel: int) -> Floats:
        """Mean over refreshes of what both panels let pass; one of them keeps still."""
        sides = (
            (self.projector, shown.projector, shown.projector_index, self.leak[0], self.ambient),
            (self.mask, shown.mask, shown.mask_index, self.leak[1], 0.0),
        )
        assert any((index == index[0]).all() for _, _, index, _, _ in sides)
        passed = []
        for way, patterns, index, leak, more in sides:
            mean = np.zeros(way.size_px[::-1])
            for one, count in zip(*np.unique(index, return_counts=True), strict=True):
                mean += count * (0.0 if one == -1 else 1.0 if one == -2 else patterns[one])
            seen = looked_up(way, mean / index.size, channel, self.samples)
            passed.append(leak + (1.0 - leak) * seen + more)
        share, blur = self.groove
        if share:
            again = gaussian_filter(passed[0][:, ::-1], blur)
            passed[0] = (1.0 - share) * passed[0] + share * again
        return np.asarray(passed[0] * passed[1])


_SEEN: OrderedDict[tuple[Way, int, int, bytes], Floats] = OrderedDict()
_MOST_SEEN = 96


def looked_up(way: Way, picture: Floats, channel: int, samples: int) -> Floats:
    """The same as `_looked_up`, remembered: most tests share their panels and pictures."""
    key = way, channel, samples, hashlib.sha256(picture.tobytes()).digest()
    if key not in _SEEN:
        _SEEN[key] = _looked_up(way, picture, channel, samples)
        if len(_SEEN) > _MOST_SEEN:
            _SEEN.popitem(last=False)
    return _SEEN[key]


def _looked_up(way: Way, picture: Floats, channel: int, samples: int) -> Floats:
    """Mean of a picture over samples x samples points of each quad, (rows, cols)."""
    rows, cols = way.frame
    width, height = way.size_px
    if (picture == 0.0).all():
        return np.zeros(way.frame)
    # Within a quad no lens bends: the map is looked up at corners of quads only.
    x, y = np.arange(cols + 1) + PLACES[channel][0], np.arange(rows + 1) + PLACES[channel][1]
    corners = np.stack(np.meshgrid(x, y), axis=-1)
    corner = np.moveaxis(way.to_panel(corners, channel), -1, 0).copy()
    flat = np.append(picture.ravel(), 0.0)  # beside the panel there is no light
    total = np.zeros(way.frame)
    for down in (np.arange(samples) + 0.5) / samples:
        line = corner[:, :-1] * (1.0 - down) + corner[:, 1:] * down
        for right in (np.arange(samples) + 0.5) / samples:
            at = line[..., :-1] * (1.0 - right) + line[..., 1:] * right
            col, row = np.floor(at).astype(np.int64)
            inside = (col >= 0) & (col < width) & (row >= 0) & (row < height)
            total += flat[np.where(inside, row * width + col, -1)]
    return total / samples**2
