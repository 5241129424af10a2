"""What honest clients ask for: every goal and most ways to take it, on a grid of 12x16 cells."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from pdcd.protocol.request import CaptureRequest

GRID = (12, 16)
CELLS = GRID[0] * GRID[1]


def requests(codes: int = 32) -> list[CaptureRequest]:
    """One of each, seeded."""
    rng = np.random.default_rng(7)
    rows, cols = np.indices(GRID)
    lit = np.round(0.2 + 0.8 * rng.random(GRID), 3).tolist()
    warp = rng.permutation(CELLS).reshape(GRID).tolist()
    other = np.roll(np.arange(CELLS), 5).reshape(GRID).tolist()
    matrix = np.round(rng.normal(size=(CELLS, CELLS)), 2).tolist()
    kernel = [[0.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -1.0, 0.0]]
    asked: list[dict[str, Any]] = [
        {"goal": "white"},
        {"goal": "indirect"},
        {"goal": "indirect", "window": "quarter"},
        {"goal": "indirect", "parts": 4},
        {"goal": "indirect", "method": "multi-image", "codes": 8, "black_level": "none"},
        {"goal": "indirect", "illumination": lit},
        {"goal": "direct"},
        {"goal": "direct", "family": "balanced"},
        {"goal": "direct", "method": "nayar"},
        {"goal": "fraction", "p": 0.25, "family": "balanced"},
        {"goal": "illuminated", "illumination": lit},
        {"goal": "diagonal"},
        {"goal": "off-diagonal", "shift": [0, 1]},
        {"goal": "warped", "warp": warp},
        {"goal": "two-samples", "warp": warp, "warp_b": other, "mix": [0.7, -0.3]},
        {"goal": "relit", "matrix": matrix},
        {"goal": "long-range", "radius": 1, "black_level": "both"},
        {"goal": "short-range", "radius": 1},
        {
            "goal": "blocked",
            "region_a": (rows < GRID[0] // 2).astype(float).tolist(),
            "region_b": (cols < GRID[1] // 2).astype(float).tolist(),
        },
        {"goal": "descattered", "shift": [0, -1]},
        {"goal": "filtered", "kernel": kernel},
        {"goal": "split", "period": 4},
        {"goal": "transport", "rows": [0, 1]},
    ]
    return [msgspec.convert({"codes": codes, **one}, CaptureRequest) for one in asked]
