"""Results that are kept in a file of `tests/data`, and compared up to rounding.

Of an array only its shape and a few sums are kept: they change with any of its values, and with
their order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

NEAR = 1e-6
"""Largest relative difference: rounding of another machine is far less."""
ROUNDING = 1e-7
"""Largest difference of what is small beside the light of 1 that it was worked out from, which is
kept in float32: processors round it apart."""


def plain(value: Any) -> Any:
    """What is kept of a value."""
    if isinstance(value, np.ndarray):
        flat = value.astype(np.float64).ravel()
        known = np.isfinite(flat)
        flat = np.where(known, flat, 0.0)
        rms = float(np.sqrt(np.mean(flat**2))) if flat.size else 0.0
        unit = flat / rms if rms > 0.0 else flat
        slope = 1.0 + np.arange(flat.size) / max(flat.size - 1, 1)
        sums = rms, float(np.mean(unit + 2.0)), float(np.mean((unit + 2.0) * slope))
        return [*value.shape, int(known.sum()), *map(_rounded, sums)] if flat.size else []
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, Mapping):
        return {str(name): plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, float):
        return _rounded(value) if math.isfinite(value) else str(value)
    return value if value is None or isinstance(value, bool | int | str) else repr(value)


def _rounded(value: float) -> float:
    return float(f"{value:.9g}")


def alike(found: Any, wanted: Any, where: str) -> None:
    """Assert that two such results are equal, numbers to rounding."""
    if isinstance(wanted, float) or isinstance(found, float):
        assert isinstance(found, float | int) and isinstance(wanted, float | int), where
        assert found == pytest.approx(wanted, rel=NEAR, abs=ROUNDING), where
    elif isinstance(wanted, dict):
        assert isinstance(found, dict) and list(found) == list(wanted), where
        for name, value in wanted.items():
            alike(found[name], value, f"{where}: {name}")
    elif isinstance(wanted, list):
        assert isinstance(found, list) and len(found) == len(wanted), where
        for k, value in enumerate(wanted):
            alike(found[k], value, f"{where}: {k}")
    else:
        assert found == wanted, where


def kept_in(path: Path) -> dict[str, Any]:
    """What a file holds."""
    told: dict[str, Any] = msgspec.json.decode(path.read_bytes())
    return told


def keep(path: Path, told: Mapping[str, Any]) -> None:
    """Write such a file, with a line for each result, so that a change shows which."""
    parts = []
    for part, results in told.items():
        lines = (f"{_json(name)}: {_json(result)}" for name, result in results.items())
        parts.append(f"{_json(part)}: {{\n" + ",\n".join(lines) + "\n}")
    path.write_text("{\n" + ",\n".join(parts) + "\n}\n", encoding="utf-8")


def _json(value: Any) -> str:
    return msgspec.json.encode(value).decode()
