"""The light budget of a page: what became of the time and of the light of each shot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pdcd.pictures.exposed import Exposed
from pdcd.runs.record import RunRecord, ShotRecord

MOST_SHOTS = 64
"""Shots that are told one by one."""
LOOKED_AT = 150
"""Rows and columns of quads that are looked at."""
TOP_PERCENT = 99.9
"""The brightest sample is that which so many stay below."""


def budget(record: RunRecord, shots: Mapping[str, Exposed]) -> list[dict[str, Any]]:
    """A line for each of the first `MOST_SHOTS` shots, shares of 1 and electrons.

    lit : of the exposure, for how long a point was both lit and seen (what direct light gets).
    others : the same for all pairs of cells (what indirect light gets), open : the mask alone.
    electrons : mean of green; full : brightest green sample over saturation.
    """
    return [
        _line(shot, shots[shot.name], record)
        for shot in record.shots[:MOST_SHOTS]
        if shot.name in shots
    ]


def _line(shot: ShotRecord, exposed: Exposed, record: RunRecord) -> dict[str, Any]:
    exposure_s = max((shot.close_ns - shot.open_ns) * 1e-9, 1e-9)
    level = shot.level or 1.0  # what the light of the shot was divided by
    realised, cells = exposed.realised, exposed.realised.coaxial.size
    down, across = (max(n // LOOKED_AT, 1) for n in exposed.saturated.shape)
    green = exposed.light_at(slice(None, None, down), slice(None, None, across))[..., 1]
    row = record.profile.row(shot.iso)
    electrons = green * level * record.responsivity_e[1] / shot.f_number**2
    full_e = record.profile.saturation_dn(shot.iso) * row.gain_e_per_dn
    return {
        "name": shot.name,
        "exposure_s": exposure_s,
        "iso": shot.iso,
        "f_number": shot.f_number,
        "refreshes": shot.refreshes,
        "open": float(realised.open_s.mean()) * level / exposure_s,
        "lit": float(realised.coaxial.mean()) * level / exposure_s,
        "others": realised.total_s * level / cells**2 / exposure_s,
        "electrons": float(electrons.mean()),
        "full": float(np.percentile(electrons, TOP_PERCENT)) / full_e,
        "saturated": float(np.mean(exposed.saturated)),
    }
