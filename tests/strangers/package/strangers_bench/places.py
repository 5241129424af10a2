"""Where the parts of a bench lie: from points of a device to points of the scene, and back.

Points of the scene are counted in pixels of the projector, whose picture is the scene's own chart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .facts import PlaceFacts

Floats = NDArray[np.float64]


class Place:
    """Device points (x, y) in its own pixels, the first covering 0 to 1, against scene points."""

    def __init__(
        self, facts: PlaceFacts, size_px: tuple[int, int], projector_px: tuple[int, int]
    ) -> None:
        self._facts = facts
        self._middle = np.array(size_px) / 2.0
        self._half = size_px[1] / 2.0
        self._scene_middle = np.array(projector_px) / 2.0 + np.array(facts.offset_px)
        turn = np.deg2rad(facts.turn_deg)
        spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        # Half heights of the device -> pixels of the projector.
        self._spin = spin * (facts.width_px / size_px[0] * self._half)

    def to_scene(self, points: Floats) -> Floats:
        """Points (..., 2) of the device, in its pixels -> of the scene."""
        near = (points - self._middle) / self._half
        near = near * (1.0 + self._facts.bulge * np.sum(near**2, axis=-1, keepdims=True))
        if self._facts.mirrored:
            near = near * np.array([-1.0, 1.0])
        near = near / (1.0 + near @ np.array(self._facts.keystone))[..., None]
        return np.asarray(near @ self._spin.T + self._scene_middle)

    def from_scene(self, points: Floats) -> Floats:
        """Points (..., 2) of the scene -> of the device, in its pixels."""
        plane = (points - self._scene_middle) @ np.linalg.inv(self._spin).T
        # q = n / (1 + k.n), so n = q / (1 - k.q).
        bent = plane / (1.0 - plane @ np.array(self._facts.keystone))[..., None]
        if self._facts.mirrored:
            bent = bent * np.array([-1.0, 1.0])
        near = bent
        for _ in range(12):
            near = bent / (1.0 + self._facts.bulge * np.sum(near**2, axis=-1, keepdims=True))
        return np.asarray(near * self._half + self._middle)
