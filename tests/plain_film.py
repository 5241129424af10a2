"""A film of a machine-vision camera that is one function."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers.virtual_genicam.camera import VirtualExposure


class PlainFilm:
    """Exposures begin and end at once, and their samples are those of a function."""

    def __init__(self, make: Callable[[VirtualExposure], NDArray[np.uint16]]) -> None:
        self.make_samples = make

    def open(self, asked_ns: int, exposure_s: float | None) -> int:
        """At once."""
        return asked_ns

    def close(self, asked_ns: int) -> int:
        """At once."""
        return asked_ns
