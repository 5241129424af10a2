"""Plain captures against the best known options for the same number of codes.

    python -m tests.bench.no_knob --seeds 5 [--noise none]

Every capture has 128 codes in all, a pilot's included, so that the same time is exposed. The best
options are those with the least mean error over the seeds, chosen with the truth at hand, scene by
scene: what somebody would take who had tried them all.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tests import world
from tests.bench.error_bars import SCENES, bench, take

OPTIONS: dict[str, dict[str, Any]] = {
    "one exposure": {},
    "4 parts": {"parts": 4},
    "8 parts": {"parts": 8},
    "balanced, 8 parts": {"parts": 8, "family": "balanced"},
    "pilot 16": {"pilot": 16},
    "pilot 16, 4 parts": {"pilot": 16, "parts": 4},
    "pilot 16, 7 parts": {"pilot": 16, "parts": 7},
    "pilot 64, 4 parts": {"pilot": 64, "parts": 4},
}
"""What is tried, beside 128 codes."""


def errors(name: str, grid: tuple[int, int], seeds: int, noise: str, fields: Any) -> list[float]:
    """RMS error over the RMS of the truth, seed by seed; `fields` None: a plain capture."""
    given = {} if fields is None else {"codes": 128, "pilot": 0, "parts": 1, **fields}
    found = []
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as folder:
            config = bench(name, grid, seed, Path(folder), noise=noise)
            found.append(take(config, seed=seed, **given).error)
    return found


def row(name: str, grid: tuple[int, int], seeds: int, noise: str) -> str:
    """One scene: error of the plain capture, of the best options, and their ratio."""
    plain = errors(name, grid, seeds, noise, None)
    tried = {key: errors(name, grid, seeds, noise, fields) for key, fields in OPTIONS.items()}
    best = min(tried, key=lambda key: float(np.mean(tried[key])))
    mean, least = float(np.mean(plain)), float(np.mean(tried[best]))
    one = float(np.mean(tried["one exposure"]))
    return (
        f"| {name} | {100 * one:.2f} % | {100 * mean:.2f} % | {100 * least:.2f} % | {best} | "
        f"{mean / least:.2f} |"
    )


def main() -> None:
    """Print the table, row by row."""
    world.enter()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--cells", default="32x24", help="columns x rows of the presets")
    parser.add_argument("--noise", choices=("full", "none"), default="full")
    parser.add_argument("--scene", choices=SCENES, action="append")
    args = parser.parse_args()
    cols, rows = (int(n) for n in args.cells.split("x"))
    say = sys.stdout.write
    say("| scene | one exposure | plain | best | which is | plain / best |\n")
    say("|---|---|---|---|---|---|\n")
    for name in args.scene or SCENES:
        say(row(name, (rows, cols), args.seeds, args.noise) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
