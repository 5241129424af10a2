"""``python -m tests.hostile --count 10000 --seed 1``: what comes back from so many attacks. With
``--web`` they are put to the page of `pdcd web`, with ``--photos`` RAW files are damaged, else they
are put to the methods of the daemon. With ``--crowd 60`` attackers come for so many seconds at
once, over the socket, and to the page, to a daemon that takes photos ``--on`` a bench: the camera
of ``body`` and the folder of ``card`` mean harm, too."""

from __future__ import annotations

import argparse
import asyncio
import logging
import sys
import tempfile
import time
from pathlib import Path

from tests import world
from tests.hostile import crowd, photos, web_trial
from tests.hostile.trial import trial
from tests.soak.benches import BENCHES


def main() -> int:
    """Print the outcome; 1 if a promise was broken."""
    world.enter()
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--web", action="store_true")
    parser.add_argument("--photos", action="store_true")
    parser.add_argument("--crowd", type=float, metavar="SECONDS")
    parser.add_argument("--on", choices=BENCHES, default="mocks", help="bench of the crowd")
    given = parser.parse_args()
    logging.disable(logging.ERROR)
    if given.crowd:
        return _crowd(given.crowd, given.on)
    if given.photos:
        return _photos(given.seed, given.count)
    return _web(given.seed, given.count) if given.web else _methods(given.seed, given.count)


def _web(seed: int, count: int) -> int:
    with tempfile.TemporaryDirectory() as folder:
        outcome = asyncio.run(web_trial.trial(Path(folder), seed, count))
    for line in outcome.broken[:20]:
        sys.stdout.write(f"broken: {line}\n")
    statuses = ", ".join(f"{n} of {status}" for status, n in sorted(outcome.statuses.items()))
    sys.stdout.write(f"{count} attacks in {outcome.seconds:.0f} s: {statuses}\n")
    return 1 if outcome.broken else 0


def _photos(seed: int, count: int) -> int:
    with tempfile.TemporaryDirectory() as folder:
        outcome = photos.trial(Path(folder), seed, count)
    for line in outcome.wrong[:20]:
        sys.stdout.write(f"broken: {line}\n")
    sys.stdout.write(outcome.told() + "\n")
    return 1 if outcome.wrong or outcome.over_s > 1.0 else 0


def _crowd(seconds: float, on: str) -> int:
    with tempfile.TemporaryDirectory() as folder, BENCHES[on](Path(folder)) as bench:
        outcome = crowd.trial(bench, seconds)
    for line in outcome.broken():
        sys.stdout.write(f"broken: {line}\n")
    sys.stdout.write(outcome.told() + "\n")
    return 1 if outcome.broken() else 0


def _methods(seed: int, count: int) -> int:
    begun_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)  # so that others could read there
        outcome = trial(Path(folder), seed, count)
    took_s = time.monotonic() - begun_s
    for line in outcome.broken[:20]:
        sys.stdout.write(f"broken: {line}\n")
    sys.stdout.write(
        f"{count} attacks in {took_s:.0f} s: {dict(outcome.kinds)}\n"
        f"slowest {outcome.slowest_s:.2f} s, event loop held up {outcome.longest_pause_s:.2f} s, "
        f"peak memory {outcome.peak_mib:.0f} MiB\nslowest: {outcome.slowest!r}\n"
    )
    return 1 if outcome.broken else 0


if __name__ == "__main__":
    sys.exit(main())
