"""Entry point: ``python -m tests.calibrated.checks [--benches 10] [--unchanged 10]``.

Checks random benches some days after their calibration: unchanged, with other noise, and after
each of the changes that a check must find. Prints how many of each were told right.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from pdcd.calibration.figures import Verdict
from tests import world
from tests.e2e.calibration.check_rig import CHANGES, Change, Truth, calibrated, later, verdicts


def main() -> None:
    """Check all of them."""
    world.enter()
    parser = argparse.ArgumentParser(prog="python -m tests.calibrated.checks", description=__doc__)
    parser.add_argument("--benches", type=int, default=10)
    parser.add_argument("--unchanged", type=int, default=10, help="checks of each, unchanged")
    args = parser.parse_args()
    told: dict[str, list[bool]] = {}
    with tempfile.TemporaryDirectory(prefix="pdcd-checks-") as folder:
        for seed in range(args.benches):
            _bench(seed, args.unchanged, Path(folder), told)
    for name, right in told.items():
        sys.stdout.write(f"| {name} | {sum(right)} of {len(right)} |\n")


def _bench(seed: int, unchanged: int, folder: Path, told: dict[str, list[bool]]) -> None:
    rng = np.random.default_rng(seed)
    truth = Truth(
        right_px=rng.uniform(-2.0, 2.0),
        turn_deg=rng.uniform(-1.5, 1.5),
        camera_px=rng.uniform(-4.0, 4.0),
        seed=1000 * seed,
    )
    reference = calibrated(truth, folder / f"{seed}")
    now = [Change("nothing", {}) for _ in range(unchanged)] + list(CHANGES)
    for number, change in enumerate(now, 1):
        there = replace(change.of(truth), seed=1000 * seed + number)
        found = verdicts(later(reference, folder / f"{seed}-{number}", there).run_check())
        # Of a mask that moved the lag may be unknown.
        right = change.found.items() <= found.items() and _worst(found) == _worst(change.found)
        told.setdefault(change.name, []).append(right)
        if not right:
            sys.stdout.write(f"bench {seed}, {change.name}: {found}\n")
            sys.stdout.flush()


def _worst(found: Mapping[str, Verdict]) -> Verdict:
    return max(found.values(), default=Verdict.GOOD)


if __name__ == "__main__":
    main()
