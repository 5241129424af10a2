"""What single-code photos hold, seen as random projections of each row of the transport."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def signs(codes: Bools) -> Floats:
    """+1 where a cell is lit, -1 where it is dark."""
    found: Floats = np.where(codes, 1.0, -1.0)
    return found


def projections(photos: Floats) -> Floats:
    """``T h_k`` (K0, N): the mean photo is ``T 1 / 2``, as every cell is lit half of the time."""
    found: Floats = 2.0 * (photos - photos.mean(axis=0))
    return found


def direct_light(codes: Bools, photos: Floats) -> Floats:
    """Estimate the direct image (N,) from balanced signs: the mean of ``h_k (T h_k)``."""
    estimate: Floats = np.mean(signs(codes) * projections(photos), axis=0)
    return estimate


def check_photos(codes: Bools, photos: Floats, cells: int) -> None:
    """Raise ConfigError unless there is a photo of all cells for each code, lit half of the
    time."""
    if codes.ndim != 2 or codes.shape != photos.shape or codes.shape[1] != cells:
        raise ConfigError(
            f"pilot codes {codes.shape} and photos {photos.shape} do not fit {cells} cells",
            hint="give one photo of all cells for each code",
        )
    if np.any(2 * np.count_nonzero(codes, axis=0) != codes.shape[0]):
        raise ConfigError(
            "a cell is not lit in half of the pilot codes", hint="use the codes of `pilot_codes`"
        )
