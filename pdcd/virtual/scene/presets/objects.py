"""Things that more than one scene is set up with: round balls, a drinking glass, a glass rod.

Camera and light look along one direction: rays are parallel. What stands on a table is seen a
little from above: a step on the table towards the camera is `_TILT` of a step down in the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.presets.canvas import FrameRaster, Shape

_TILT = 0.40
"""Sine of the angle from which tables are seen."""
_WAVES = 0.10
"""How uneven blown glass is: the angle by which it deflects light sideways, and the share of that
by which it deflects light up or down."""


@dataclass(frozen=True)
class Ball:
    """A ball: its middle and its radius in the frame."""

    x: float
    y: float
    radius: float

    def on(self, raster: FrameRaster) -> Shape:
        """Where it is seen."""
        return raster.disk(self.x, self.y, self.radius)

    def facing(self, raster: FrameRaster) -> Array:
        """Cosine of the light's angle on it, 0 outside, (rows, cols)."""
        square = ((raster.x - self.x) ** 2 + (raster.y - self.y) ** 2) / self.radius**2
        cosine: Array = np.sqrt(np.maximum(1.0 - square, 0.0))
        return cosine

    def glint(self, raster: FrameRaster) -> Array:
        """A window's shine on a polished ball, 0 to 1, (rows, cols)."""
        across = (raster.x - self.x) / self.radius + 0.35
        down = (raster.y - self.y) / self.radius + 0.40
        shine: Array = np.exp(-(((across**2 + down**2) / 0.02) ** 2))
        return shine


@dataclass(frozen=True)
class Tumbler:
    """A round drinking glass on a table, and the caustic that its far side throws in front of it.

    x, y : middle of its foot
    radius, height : in the frame
    """

    x: float
    y: float
    radius: float
    height: float

    def _half(self, x: Array) -> Array:
        """Half of the depth of the glass at places x, 0 outside."""
        across = (x - self.x) / self.radius
        half: Array = self.radius * np.sqrt(np.maximum(1.0 - across**2, 0.0))
        return half

    def on(self, x: Array, y: Array) -> Shape:
        """Where any of the glass is seen."""
        half = _TILT * self._half(x)
        inside: Shape = np.abs(x - self.x) < self.radius
        return inside & (y < self.y + half) & (y > self.y - self.height - half)

    def far_side(self, x: Array, y: Array) -> tuple[Shape, Array]:
        """Where the inner far side is seen, and at what height above the table."""
        height = self.y - _TILT * self._half(x) - y
        inside: Shape = np.abs(x - self.x) < 0.985 * self.radius
        return inside & (height > 0.0) & (height < self.height), height

    def caustic(self, x: Array, y: Array, waves: float = _WAVES) -> tuple[Shape, Array, Array]:
        """Where light arrives on the table that the far side reflects, see `thrown.Landing`.

        A ray meets the round wall at the angle a, goes on at 2 a from where it came, and falls
        until it meets the table: the curve of a coffee cup. While it falls by a height it gets
        `1 / TILT` as far, as those rays do that are seen as points.
        """
        there, height = self.far_side(x, y)
        angle = np.arcsin(np.clip((x - self.x) / self.radius, -1.0, 1.0))
        level = height / self.radius
        aside = 2.0 * angle + waves * np.sin(8.0 * angle + 7.0 * level)
        aside = aside + 0.7 * waves * np.sin(13.0 * angle - 9.0 * level + 1.0)
        far = height / _TILT * (1.0 + waves * np.sin(10.0 * level + 3.0 * angle))
        across = self.radius * np.sin(angle) - far * np.sin(aside)
        near = -self.radius * np.cos(angle) + far * np.cos(aside)
        return there, self.x + across, self.y + _TILT * near

    def draw(self, raster: FrameRaster, image: Array) -> None:
        """Draw the glass over what stands behind and in it: its rims and its shine."""
        x, y = raster.x, raster.y
        across = (x - self.x) / self.radius
        on = self.on(x, y)
        # At its sides, light crosses the glass at a slant: there it takes more of the light.
        image[on] *= (0.92 - 0.35 * np.abs(across[on]) ** 6)[:, None]
        half = self._half(x)
        for middle in (self.y, self.y - self.height):
            for sign in (-1.0, 1.0):
                edge = np.abs(y - middle - sign * _TILT * half) < 0.006
                edge &= np.abs(across) < 0.999
                image[edge] = 0.5 * image[edge] + 0.22
        upright = on & (y < self.y) & (y > self.y - self.height)
        for place, width, most in ((-0.80, 0.05, 0.28), (-0.66, 0.02, 0.16), (0.86, 0.03, 0.2)):
            shine = most * np.exp(-(((across - place) / width) ** 2))[upright, None]
            image[upright] = (1.0 - shine) * image[upright] + shine


@dataclass(frozen=True)
class Rod:
    """A rod of cut glass that stands upright in front of a wall: a lens for each picture row.

    x : its axis; top, bottom : its ends; radius : in the frame
    wall : distance of the wall behind its axis
    """

    x: float
    top: float
    bottom: float
    radius: float
    wall: float

    INDEX = 1.5

    def on(self, x: Array, y: Array) -> Shape:
        """Where it is seen."""
        inside: Shape = np.abs(x - self.x) < self.radius
        return inside & (y > self.top) & (y < self.bottom)

    def caustic(self, x: Array, y: Array) -> tuple[Shape, Array, Array]:
        """Where light arrives that the rod bends, see `thrown.Landing`: in the same row.

        Snell's law on a round rod whose surface is cut in waves.
        """
        there = self.on(x, y)
        across = np.clip((x - self.x) / self.radius, -1.0, 1.0)
        bend = 2.0 * (np.arcsin(across) - np.arcsin(across / self.INDEX))
        bend = bend + 0.16 * np.sin(9.0 * across + 5.0 * (y - self.top))
        bend = np.clip(bend, -1.4, 1.4)
        land = self.x + self.radius * across - self.wall * np.tan(bend)
        return there, land, y

    def draw(self, raster: FrameRaster, image: Array) -> None:
        """Draw the rod over what stands behind it."""
        across = (raster.x - self.x) / self.radius
        on = self.on(raster.x, raster.y)
        wave = 0.06 * np.sin(9.0 * across + 5.0 * (raster.y - self.top))
        image[on] = image[on] * (0.35 + 0.2 * (1.0 - across[on] ** 2))[:, None] + 0.02
        shine = np.exp(-(((across + 0.45 + wave) / 0.06) ** 2))
        shine += 0.6 * np.exp(-(((across - 0.62 - wave) / 0.04) ** 2))
        image[on] += 0.35 * shine[on][:, None]
