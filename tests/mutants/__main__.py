"""Entry point: ``make mutants [ROOM=capture] [COUNT=150] [SEED=1] [OUT=folder] [JOBS=2]``.

Draws small wrong changes, makes them one at a time in a copy of the tree, and runs the tests that
should notice. Writes a table and `mutants.json`; exits 1 where too few were noticed.
"""

from __future__ import annotations

import argparse
import difflib
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

import msgspec

from tests.mutants.draw import EQUIVALENT, drawn, equivalents, files_of, must_fail_closed
from tests.mutants.operators import Mutant
from tests.mutants.related import related
from tests.mutants.trial import Answer, Bench
from tests.places import ROOT

ENOUGH, ENOUGH_CLOSED = 0.85, 0.95
"""Shares that must be noticed: of all, and of those in paths that must fail closed."""


class Told(msgspec.Struct, frozen=True):
    """One mutant and what became of it."""

    where: str
    operator: str
    fail_closed: bool
    noticed_by: str
    """A test, or '' for none."""
    seconds: float
    key: str
    diff: str


def say(text: str) -> None:
    """To the terminal or the log, at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def diff(mutant: Mutant, root: Path) -> str:
    """The lines that a mutant changes, of the copy: the tree itself may be worked on meanwhile."""
    source = (root / mutant.path).read_bytes()
    before, after = (text.decode().splitlines() for text in (source, mutant.applied(source)))
    return "\n".join(list(difflib.unified_diff(before, after, lineterm="", n=0))[3:])


def tried(mutant: Mutant, benches: SimpleQueue[Bench], *, quick: bool) -> Told:
    """Make one change on a free bench and run its tests, or only those of units."""
    bench = benches.get()
    since_s = time.monotonic()
    try:
        change = diff(mutant, bench.copy)
        files = related(mutant.path, bench.copy)
        if quick:
            files = [file for file in files if file.startswith("tests/unit/")]
        test = bench.noticed(mutant, files)
    finally:
        benches.put(bench)
    seconds = time.monotonic() - since_s
    where = f"{mutant.path}:{mutant.line}"
    closed = must_fail_closed(mutant)
    say(f"{'noticed' if test else 'LIVES':8}{where:44}{mutant.operator:22}{test or mutant.key}")
    return Told(where, mutant.operator, closed, test, seconds, mutant.key, change)


def share(told: list[Told]) -> float:
    """Of those that were noticed; 1 of none."""
    return sum(bool(one.noticed_by) for one in told) / len(told) if told else 1.0


def report(told: list[Told], closed: list[Told], unsound: list[str]) -> str:
    """The table, the survivors with their changes, and the test files that could not be used."""
    text = "| mutants | tried | noticed |\n|---|---|---|\n"
    for name, some in (("all", told), ("fail-closed paths", closed)):
        text += f"| {name} | {len(some)} | {share(some):.0%} |\n"
    for one in told:
        if not one.noticed_by:
            kind = ", must fail closed" if one.fail_closed else ""
            text += f"\n{one.where}: {one.operator}{kind}\n{one.key}\n{one.diff}\n"
    return text + "".join(f"\nnot used, fails without any change: {file}\n" for file in unsound)


def main() -> int:
    """Draw, try, report."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--room", default="all")
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, choices=(1, 2), default=2)
    parser.add_argument("--out", type=Path, default=Path("mutants"))
    parser.add_argument("--closed", action="store_true", help="only paths that must fail closed")
    parser.add_argument("--quick", action="store_true", help="unit tests only: what lives may fall")
    args = parser.parse_args()
    known = equivalents(EQUIVALENT.read_text(encoding="utf-8"))
    benches: SimpleQueue[Bench] = SimpleQueue()
    sound: dict[str, Answer] = {}
    made = [Bench(ROOT, sound) for _ in range(args.jobs)]
    try:
        root = made[0].copy
        some = drawn(
            files_of(args.room, root), root, args.count, args.seed, known, closed=args.closed
        )
        say(f"{len(some)} mutants of {args.room}, seed {args.seed}")
        for bench in made:
            benches.put(bench)
        with ThreadPoolExecutor(args.jobs) as pool:
            told = list(pool.map(lambda one: tried(one, benches, quick=args.quick), some))
        unsound = {file for file, first in sound.items() if not first.passed}
    finally:
        for bench in made:
            bench.close()
    closed = [one for one in told if one.fail_closed]
    text = report(told, closed, sorted(unsound))
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "mutants.md").write_text(text, encoding="utf-8")
    (args.out / "mutants.json").write_bytes(msgspec.json.format(msgspec.json.encode(told)))
    say(f"\n{text}\nwritten to {args.out}/")
    return int(share(told) < ENOUGH or share(closed) < ENOUGH_CLOSED)


if __name__ == "__main__":
    sys.exit(main())
