"""Plain captures of all goals that are taken by codes: their errors and error bars.

    python -m tests.bench.plain_goals --seeds 3 [--goal long-range] [--scene mirror] [--once]

With `--once` the same in one exposure of 128 codes, as plain captures of most goals were.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tests import world
from tests.bench.error_bars import SCENES, bench
from tests.taken import take

GRID = (24, 32)
N = GRID[0] * GRID[1]
RNG = np.random.default_rng(0)
LIGHT = np.round(RNG.random(GRID), 3).tolist()
KERNEL = [[0.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -1.0, 0.0]]
GOALS: dict[str, dict[str, Any]] = {
    "indirect": {},
    "indirect, illumination": {"illumination": LIGHT},
    "indirect, shift": {"shift": (0, 3)},
    "direct, illumination": {"illumination": LIGHT},
    "long-range": {"radius": 2},
    "long-range, illumination": {"radius": 2, "illumination": LIGHT},
    "short-range": {"radius": 2},
    "fraction": {"p": 0.25},
    "split": {"period": 8},
    "diagonal": {},
    "descattered": {"shift": (0, -1)},
    "filtered": {"kernel": KERNEL},
    "warped": {"warp": RNG.permutation(N).reshape(GRID).tolist()},
}


def row(scene: str, goal: str, seeds: int, **fields: Any) -> str:
    """Error, sigma over error with its range over the seeds, coverage, exposures, verdicts."""
    asked = {"goal": goal.split(",")[0], **GOALS[goal], **fields}
    figures, parts, verdicts = [], set(), set()
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as folder:
            config = bench(scene, GRID, seed, Path(folder))
            made = take(config, seed=seed, **asked)
            image, sigma = made.image, made.probe["sigma"]
            with np.load(made.folder / "truth.npz") as known:
                truth = known["image"].reshape(image.shape)
        off, light = (float(np.sqrt(np.mean(a**2))) for a in (image - truth, truth))
        covered = float(np.mean(np.abs(image - truth) <= 1.96 * sigma))
        figures.append((off / light, float(np.sqrt(np.mean(sigma**2))) / off, 100.0 * covered))
        summary = made.summary
        parts.add(f"{summary['parts']}" + f" after {summary['pilot']}" * (summary["pilot"] > 0))
        verdicts.add(summary["quality"].verdict)
    error, ratio, covered = np.mean(figures, axis=0)
    least, most = np.min(figures, axis=0)[1], np.max(figures, axis=0)[1]
    return (
        f"| {goal} | {scene} | {100.0 * error:.2g} % | {ratio:.2f} ({least:.2f} to {most:.2f}) | "
        f"{covered:.1f} | {' / '.join(sorted(parts))} | {' / '.join(sorted(verdicts))} |"
    )


def main() -> None:
    """Print the table, row by row."""
    world.enter()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--goal", choices=GOALS, action="append")
    parser.add_argument("--scene", action="append", help="a preset, corner or mirror")
    parser.add_argument("--once", action="store_true", help="one exposure of 128 codes")
    args = parser.parse_args()
    fields = {"pilot": 0, "parts": 1} if args.once else {}
    say = sys.stdout.write
    say("| goal | scene | error | sigma / error | covered | exposures | verdict |\n")
    say("|---|---|---|---|---|---|---|\n")
    for goal in args.goal or GOALS:
        for scene in args.scene or SCENES:
            say(row(scene, goal, args.seeds, **fields) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
