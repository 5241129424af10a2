"""Whether the paths that a pilot found are worth avoiding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pdcd.codes.pilot.codes import SCOUTS
from pdcd.codes.pilot.signs import Bools, Floats, check_photos, direct_light
from pdcd.errors import ConfigError

CLEARLY = 0.7
"""Error with the paths found, over that without, from which they are believed. Few are there in
smooth light, and avoiding what is not there disturbs the codes a little."""


@dataclass(frozen=True)
class Worth:
    """Predicted RMS errors of the indirect image, over the RMS of the true one.

    `alone` for all codes in one shot and no pilot. After a pilot, for the other codes: `piloted` if
    they avoid the paths found, `unguided` if they do not.
    """

    alone: float
    piloted: float
    unguided: float

    @property
    def pays(self) -> bool:
        """Whether to avoid the paths found. What the pilot has cost is spent either way."""
        return self.piloted < CLEARLY * self.unguided


def worth(
    codes: Bools,
    photos: Floats,
    paths: Any,
    count: int,
    *,
    sigma: float | Floats = 0.0,
) -> Worth:
    """Predict from the photos of `pilot_codes` whether to use the paths found.

    Each of the two Hadamard sets of the pilot estimates the direct image; both hold the same truth,
    so their difference shows the error of that many codes. Photos without the light of the paths
    found show in the same way the error of codes that avoid these paths. Errors are carried over
    to other numbers of codes by the share of pairs of cells that have a code in common: right for
    unrelated paths, too much for smooth light, and this for both ways alike. Where each set keeps
    all cells apart, or there is no indirect light, nothing can be told, and nothing pays: all 0.

    Parameters
    ----------
    codes, photos, sigma :
        As for `estimate_links`, the codes those of `pilot_codes`.
    paths : sparse (N, N)
        What `estimate_links` found.
    count : int
        Number of codes in all, pilot included; more than the pilot has.

    Raises
    ------
    ConfigError
        The pilot leaves no codes, or the arrays do not fit each other.
    """
    check_photos(codes, photos, paths.shape[0])
    pilot, quarter = codes.shape[0], codes.shape[0] // 4
    if count <= pilot:
        raise ConfigError(
            f"a pilot of {pilot} leaves nothing of {count} codes", hint="take more codes"
        )
    first = slice(SCOUTS, SCOUTS + quarter)
    second = slice(SCOUTS + quarter, SCOUTS + 2 * quarter)
    cleared = photos - (paths @ codes.T.astype(np.float64)).T
    noise = np.broadcast_to(sigma, photos.shape)[first.start : second.stop]
    blur = 8.0 / quarter * np.mean(noise**2)  # variance of a difference of two direct images
    indirect = 2.0 * photos.mean(axis=0) - direct_light(codes, photos)
    light, shared = float(np.mean(indirect**2)), _shared(quarter, codes.shape[1])
    if light == 0.0 or shared == 0.0:
        return Worth(alone=0.0, piloted=0.0, unguided=0.0)
    spread = []
    for series in (photos, cleared):
        differ = direct_light(codes[first], series[first]) - direct_light(
            codes[second], series[second]
        )
        square = max(float(np.mean(differ**2) - blur), 0.0) / 2.0
        spread.append(square / light / shared)
    alone, left = _shared(count, codes.shape[1]), _shared(count - pilot, codes.shape[1])
    return Worth(
        alone=float(np.sqrt(spread[0] * alone)),
        piloted=float(np.sqrt(spread[1] * left)),
        unguided=float(np.sqrt(spread[0] * left)),
    )


def _shared(count: int, cells: int) -> float:
    """Share of the pairs of cells that have the same of `count` - 1 columns, all used alike."""
    if count < 2:
        return 1.0
    return max(cells / (count - 1) - 1.0, 0.0) / max(cells - 1, 1)
