"""``python -m tests.soak --minutes 60 [--seed 1] [--out REPORT] [--on mocks body ...]``."""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

from tests import world
from tests.bench.report import write_soak
from tests.soak.benches import BENCHES
from tests.soak.episode import LONG, Episode
from tests.soak.page import LivePage
from tests.soak.tally import Tally
from tests.soak.wanted import requests

ABOUT = (
    "Written by `make soak`: a real daemon on four benches in turn, honest clients that want "
    "every goal, hostile ones, kills and faults ([tests](../CONTRIBUTING.md#tests)). In half of "
    "the turns other processes want all cores. Times are seen from outside, after the end of the "
    "job or process; 0.00 s is less than one look."
)
TURN_S = 120.0
"""How long one bench has its turn."""
LONG_S = 480.0
"""How long a life may last that tells whether a daemon grows; it may end after the turn."""
SHORT = (15, 15, 15)
LIVES = {"mocks": (*SHORT, 400), "windows": SHORT, "body": SHORT, "card": SHORT}
"""Photos of a daemon's life on each bench, if nothing ends it sooner. Only the mock bench takes
hundreds of photos in minutes."""
BUSY = "import sys\nwhile True: pass"


@contextmanager
def _watched(socket: Path, tally: Tally) -> Iterator[None]:
    """An honest client asks for the state all the while."""
    command = [sys.executable, "-m", "tests.soak.watch", str(socket)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as watch:
        try:
            yield
        finally:
            told, _ = watch.communicate(b"\n", timeout=60.0)
            tally.answers_s += json.loads(told)


@contextmanager
def _busy(cores: int) -> Iterator[None]:
    """So many processes that want a core each."""
    loops = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(cores)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def main() -> int:
    """Soak; returns 1 when a promise broke."""
    world.enter()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="report to put the table into")
    parser.add_argument("--on", nargs="+", choices=BENCHES, default=list(BENCHES))
    parser.add_argument("--busy", type=int, default=2, help="cores kept busy meanwhile; default 2")
    parser.add_argument("--keep", type=Path, help="folder for the logs of daemons")
    args = parser.parse_args()
    rng, tally = Random(args.seed), Tally()
    until_s = time.monotonic() + 60.0 * args.minutes
    turn = 0
    while time.monotonic() < until_s:
        name = args.on[turn % len(args.on)]
        turn += 1
        wanted = requests(32 if name == "mocks" else 8)
        with (
            tempfile.TemporaryDirectory(prefix="pdcd-soak-") as made,
            BENCHES[name](Path(made)) as bench,
        ):
            ends_s = min(until_s, time.monotonic() + TURN_S)
            # Half of the turns on cores that others use as well.
            with (
                _busy(args.busy * (turn % 2)),
                _watched(bench.folder / "s", tally),
                LivePage(bench.folder / "s", bench.state, tally) as page,
            ):
                while time.monotonic() < ends_s:
                    photos = rng.choice(LIVES[name])
                    last_s = ends_s if photos < LONG else time.monotonic() + LONG_S
                    life = Episode(bench, rng, tally, wanted, photos, page)
                    life.live(min(last_s, until_s))
            if args.keep is not None:
                args.keep.mkdir(parents=True, exist_ok=True)
                shutil.copy(bench.folder / "log", args.keep / f"{turn:03d}-{name}.log")
        sys.stderr.write(
            f"turn {turn} {name}: {tally.captures} captures, {tally.kills} kills, "
            f"{len(tally.broken)} broken\n" + "".join(f"  {b}\n" for b in tally.broken[-3:])
        )
    table = tally.table()
    sys.stdout.write(table)
    if args.out is not None:
        write_soak(args.out, f"{ABOUT}\n\n{table}")
    return 1 if tally.broken else 0


if __name__ == "__main__":
    sys.exit(main())
