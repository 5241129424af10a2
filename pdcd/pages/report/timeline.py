"""The time line of a page (when each refresh of each shot came, and which were late) and its light
budget: how the time and the light of each shot were used.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pdcd.pages.report.packing import pack_integers
from pdcd.pictures.exposed import ExposedShot
from pdcd.runs.frame_table import FRAMES_FILE, read_frame_columns
from pdcd.runs.record import RunRecord, ShotRecord

MOST_TIMELINE_REFRESHES = 60_000
"""Most refreshes that are listed one by one; of further shots only late ones are."""
_UNITS = 2_000_000_000
"""Longest time of a shot in units of the page: fits 31 bits."""
_LATE_MISSED, _LATE_DROPPED, _BLACK = 1, 2, 4
"""Bits of a refresh: refreshes were lost before it, a panel showed another one, the mask is black
by plan."""
_WANTED = ("t_primal_ns", "t_dual_ns", "missed", "dropped", "guard")


def make_timeline(folder: Path, record: RunRecord) -> list[dict[str, Any]]:
    """The page's data on each shot, in the order in which the shots were taken.

    Times are whole numbers of `unit_s` from the opening of the shutter. Raises DecodeError for a
    damaged table.
    """
    table = _table(folder / FRAMES_FILE)
    found, told = [], 0
    first_ns = min((shot.open_ns for shot in record.shots), default=0)
    for shot in sorted(record.shots, key=lambda shot: shot.open_ns):
        rows = table.get(shot.name, np.zeros((len(_WANTED), 0), np.int64))
        every = told + rows.shape[1] <= MOST_TIMELINE_REFRESHES
        told += rows.shape[1] if every else 0
        found.append(_shot(shot, rows, first_ns, every=every))
    return found


def _shot(shot: ShotRecord, rows: np.ndarray[Any, Any], first_ns: int, *, every: bool) -> Any:
    primal_ns, dual_ns, missed, dropped, guard = rows
    flags = _LATE_MISSED * (missed > 0) + _LATE_DROPPED * (dropped > 0) + _BLACK * (guard > 0)
    length_ns = max(shot.close_ns - shot.open_ns, 1)
    unit_ns = max(1000, -(-length_ns // _UNITS))
    kept = slice(None) if every else flags & (_LATE_MISSED | _LATE_DROPPED) > 0
    number = np.arange(primal_ns.size)[kept]
    return {
        "name": shot.name,
        "begin_s": (shot.open_ns - first_ns) * 1e-9,
        "length_s": length_ns * 1e-9,
        "refreshes": shot.refreshes,
        "missed": int(missed.sum()),
        "late": int(((missed > 0) | (dropped > 0)).sum()),
        "source": shot.source,
        "verified": shot.verified,
        "every": every,
        "unit_s": unit_ns * 1e-9,
        "number": pack_integers(number),
        "projector": pack_integers(_units(primal_ns[kept] - shot.open_ns, unit_ns)),
        "mask": pack_integers(_units(dual_ns[kept] - shot.open_ns, unit_ns)),
        "flags": pack_integers(flags[kept]),
        "lost": pack_integers(missed[kept]),
    }


def _units(times_ns: Any, unit_ns: int) -> Any:
    """Times in whole units; times of a forged table beyond any exposure are clipped."""
    return np.clip(np.rint(times_ns / unit_ns), -_UNITS, _UNITS).astype(np.int64)


def _table(path: Path) -> dict[str, np.ndarray[Any, Any]]:
    """Columns `_WANTED` of each shot, (5, refreshes) int64."""
    columns = read_frame_columns(path, ("shot", *_WANTED))
    names, shot, counts = np.unique(columns["shot"], return_inverse=True, return_counts=True)
    rows = np.stack([columns[name] for name in _WANTED])[:, np.argsort(shot, kind="stable")]
    ends = np.cumsum(counts)
    return {
        str(name): rows[:, end - count : end]
        for name, count, end in zip(names, counts, ends, strict=True)
    }


MOST_SHOTS = 64
"""Most shots that are listed one by one."""
_LOOKED_AT = 150
"""Most rows and columns of quads that are sampled."""
_TOP_PERCENT = 99.9
"""The percentile of samples that counts as the brightest sample."""


def make_light_budget(record: RunRecord, shots: Mapping[str, ExposedShot]) -> list[dict[str, Any]]:
    """A line for each of the first `MOST_SHOTS` shots, in shares of 1 and electrons.

    lit : share of the exposure in which a point was both lit and seen (for direct light).
    others : the same for all pairs of cells (for indirect light). open : for the mask alone.
    electrons : mean of green, or of grey. full : the brightest of these samples over saturation.
    """
    return [
        _line(shot, shots[shot.name], record)
        for shot in record.shots[:MOST_SHOTS]
        if shot.name in shots
    ]


def _line(shot: ShotRecord, exposed: ExposedShot, record: RunRecord) -> dict[str, Any]:
    exposure_s = max(shot.open_s, 1e-9)
    level = shot.level or 1.0  # the divisor of the shot's light
    realised, cells = exposed.realised, exposed.realised.coaxial.size
    down, across = (max(n // _LOOKED_AT, 1) for n in exposed.saturated.shape)
    light = exposed.light_at(slice(None, None, down), slice(None, None, across))
    main = light.shape[-1] // 2  # green, or the only colour
    row = record.profile.row(shot.iso)
    electrons = light[..., main] * level * record.responsivity_e[main] / shot.f_number**2
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
        "full": float(np.percentile(electrons, _TOP_PERCENT)) / full_e,
        "saturated": float(np.mean(exposed.saturated)),
    }
