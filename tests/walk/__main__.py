"""Entry point: ``python -m tests.walk [GOAL] [--grid ROWSxCOLS] [--files] [--route]``.

Takes one plain capture on the mock bench, follows it through the source, and weighs the source.
What is counted, in plain words:

- A capture *loads* a file when it runs that file's own lines, because something imports it. It
  *calls* a file when a function of it runs: one that only defines types and constants is loaded and
  never called. Files called `__init__.py` are left out. Processes that the capture starts count
  like the first one.
- A function *holds* a `Plan` when one of its arguments, `self` included, is one or leads to one by
  at most two attributes, or is a short tuple, list or dictionary of some.
- The *way* of `Plan` is the files of the functions that are called holding one, in order of time.
  Each place in the source that calls a function counts when it does so for the first time, so that
  loops count once. A *move* is a change from one file to another on that way; a call of a method of
  `Plan` itself leads to the file that defines it.
- A *return* is a change of rooms, which are folders, to one that the way had left before.

Lines of a function run from its `def` to its end. A circle is a group of modules that import each
other, in functions too; imports for type checkers alone do not count.

Classes are found by their names, wherever they are defined. The exit status is 1 where a bound
below is exceeded.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tests import world
from tests.places import ROOT
from tests.walk.route import Route, homes, room_of, route_of
from tests.walk.trace import Notes, read_notes, traced_environment
from tests.walk.weight import LONG_FILE, LONG_FUNCTION, Weight, weigh

PACKAGES = ("pdcd", "drivers")
CLASSES = ("Plan", "CellMap")
MOST_FILES, MOST_PLAN_MOVES = 225, 32
"""Bounds: files that a plain capture loads, and moves of its plan."""
SITES = 12
"""Rows of a table of moves by who makes them."""


def walk(goal: str, grid: str) -> Notes:
    """Take a capture in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "notes"
        out.mkdir()
        environment = traced_environment(out, ROOT, PACKAGES, CLASSES)
        environment["OMP_NUM_THREADS"] = "1"
        runs = f"{folder}/runs"
        command = [sys.executable, "-m", "tests.walk.take", goal, grid, runs]
        subprocess.run(command, env=environment, cwd=ROOT, check=True)
        return read_notes(out)


def counted(files: set[str]) -> set[str]:
    """All but those that make a folder a package."""
    return {file for file in files if not file.endswith("__init__.py")}


def faults(loaded: int, plan: Route, weight: Weight) -> list[str]:
    """What is over its bound, a line each."""
    found = []
    if loaded > MOST_FILES:
        found.append(f"a capture loads {loaded} files, over {MOST_FILES}")
    if plan.moves > MOST_PLAN_MOVES:
        found.append(f"{plan.held} moves {plan.moves} times, over {MOST_PLAN_MOVES}")
    if not plan.steps:
        found.append(f"no call holds a {plan.held}: is the class called otherwise now?")
    found += [f"{file} has {n} lines, over {LONG_FILE}" for file, n in weight.long_files.items()]
    found += [f"{f} has {n} lines, over {LONG_FUNCTION}" for f, n in weight.long_functions.items()]
    found += [f"circle of imports: {', '.join(circle)}" for circle in weight.circles]
    return found


def table(
    notes: Notes, routes: list[Route], weight: Weight, *, files: bool, steps: bool
) -> Iterator[str]:
    """The report, line by line."""
    loaded, called = counted(notes.loaded), counted(notes.called)
    yield f"files loaded {len(loaded)} (bound {MOST_FILES}), of these called {len(called)}"
    rooms, of_called = (Counter(map(room_of, some)) for some in (loaded, called))
    yield f"  {'room':28}{'loaded':>8}{'called':>8}"
    for room in sorted(rooms):
        yield f"  {room:28}{rooms[room]:8}{of_called[room]:8}"
        for file in sorted(loaded) if files else ():
            if room_of(file) == room:
                mark = "" if file in called else "  loaded only"
                yield f"    {weight.lines[file]:4} {file}{mark}"
    for route in routes:
        yield from _told(route, notes, steps=steps)
    lines = sum(weight.lines.values())
    yield f"product: {len(weight.lines)} files, {lines} lines; tests: {weight.test_lines} lines"
    yield f"contract: {weight.rooms} rooms on {weight.floors} floors"
    yield f"files over {LONG_FILE} lines: {len(weight.long_files)}"
    yield f"functions over {LONG_FUNCTION} lines: {len(weight.long_functions)}"
    yield f"circles of imports: {len(weight.circles)}"


def _told(route: Route, notes: Notes, *, steps: bool) -> Iterator[str]:
    files = set(route.files)
    bound = f" (bound {MOST_PLAN_MOVES})" if route.held == CLASSES[0] else ""
    yield (
        f"{route.held}, of {' and '.join(homes(route.held, notes.steps)) or 'nowhere'}: "
        f"{route.moves} moves{bound} between {len(files)} files of "
        f"{len(set(map(room_of, files)))} rooms, {route.returns} returns"
    )
    back = route.comebacks()
    for step in route.steps if steps else ():
        mark = "<" if step in back else " "
        yield f"  {mark} {step.callee:36} {step.function:36} {step.caller}:{step.line}"
    for site, count in route.sites().most_common(0 if steps else SITES):
        yield f"  {count:4} {site}"


def main() -> int:
    """The exit status: 1 where something is over its bound."""
    world.enter()
    parser = argparse.ArgumentParser(prog="python -m tests.walk", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("goal", nargs="?", default="indirect")
    parser.add_argument("--grid", default="", metavar="ROWSxCOLS", help="cells; default: 48x64")
    parser.add_argument("--files", action="store_true", help="list every file, with its lines")
    parser.add_argument("--route", action="store_true", help="list every move; < is a return")
    given = parser.parse_args()
    notes, weight = walk(given.goal, given.grid), weigh(ROOT, PACKAGES)
    routes = [route_of(name, notes.steps) for name in CLASSES]
    over = faults(len(counted(notes.loaded)), routes[0], weight)
    told = table(notes, routes, weight, files=given.files, steps=given.route)
    lines = [*told, *(f"OVER: {fault}" for fault in over)]
    sys.stdout.write("\n".join(lines) + "\n")
    return 1 if over else 0


if __name__ == "__main__":
    raise SystemExit(main())
