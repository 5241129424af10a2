"""``python -m tests.hostile --count 10000 --seed 1``: what comes back from so many attacks."""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import time
from pathlib import Path

from tests.hostile.trial import trial


def main() -> int:
    """Print the outcome; 1 if a promise was broken."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    logging.disable(logging.ERROR)
    begun_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)  # so that others could read there
        outcome = trial(Path(folder), given.seed, given.count)
    took_s = time.monotonic() - begun_s
    for line in outcome.broken[:20]:
        sys.stdout.write(f"broken: {line}\n")
    sys.stdout.write(
        f"{given.count} attacks in {took_s:.0f} s: {dict(outcome.kinds)}\n"
        f"slowest {outcome.slowest_s:.2f} s, event loop held up {outcome.longest_pause_s:.2f} s, "
        f"peak memory {outcome.peak_mib:.0f} MiB\nslowest: {outcome.slowest!r}\n"
    )
    return 1 if outcome.broken else 0


if __name__ == "__main__":
    sys.exit(main())
