"""Plain captures in ambient light against the known truth: what is left of it, and what it costs.

    python -m tests.bench.ambient --seeds 3 [--ambient 0.3] [--noise none]

Captures as those of `tests.bench.error_bars`. The truth is what the scene's own transport makes of
full light, without anything that made the photos.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import msgspec
import numpy as np

from tests import world
from tests.bench.error_bars import SCENES, Found, bench, take


def captures(
    name: str, grid: tuple[int, int], ambient: float, seeds: int, noise: str
) -> list[Found]:
    """Plain captures before a scene, a seed each."""
    found = []
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as folder:
            config = bench(name, grid, seed, Path(folder), noise=noise)
            scene = msgspec.structs.replace(config.scene, ambient=ambient)
            found.append(take(msgspec.structs.replace(config, scene=scene), seed=seed))
    return found


def row(name: str, grid: tuple[int, int], ambient: float, seeds: int, noise: str) -> str:
    """A row of the table: the mean over the seeds, and the worst seed's error."""
    found = captures(name, grid, ambient, seeds, noise)
    errors = [f.error for f in found]
    error, sensor = (
        float(np.sqrt(np.mean([getattr(f, k) ** 2 for f in found]))) for k in ("error", "sensor")
    )
    ratios = [f.sigma / f.error for f in found]
    covered = 100.0 * float(np.mean([f.covered for f in found]))
    parts = "/".join(str(p) for p in sorted({f.summary["parts"] for f in found}))
    exposed = float(np.mean([f.summary["exposure_s"] for f in found]))
    return (
        f"| {name} | {100 * error:.2f} % | {100 * max(errors):.2f} % | {100 * sensor:.2f} % | "
        f"{min(ratios):.2f} to {max(ratios):.2f} | {covered:.1f} | {parts} | {exposed:.0f} s |"
    )


def main() -> None:
    """Print the table, row by row."""
    world.enter()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--ambient", type=float, default=0.3)
    parser.add_argument("--noise", choices=("full", "none"), default="full")
    parser.add_argument("--cells", default="32x24", help="columns x rows of the presets")
    parser.add_argument("--scene", choices=SCENES, action="append")
    args = parser.parse_args()
    cols, rows = (int(n) for n in args.cells.split("x"))
    say = sys.stdout.write
    say("| scene | error | worst | noise | sigma / error | covered | parts | exposed |\n")
    say("|---|---|---|---|---|---|---|---|\n")
    for name in args.scene or SCENES:
        say(row(name, (rows, cols), args.ambient, args.seeds, args.noise) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
