"""`pdcd figures`: the paper's experiments on the virtual bench, as one page."""

from __future__ import annotations

import argparse
from dataclasses import replace

from pdcd.api.progress import tell_user
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say, say_json
from pdcd.figures.catalog import choose_figures
from pdcd.figures.figure import FULL_MODE, QUICK_MODE
from pdcd.figures.make import PAGE, make_paper_figures, open_processes


def take_figures(args: argparse.Namespace) -> int:
    """Make the figures; fails if one could not be made, or a number is out of its bounds."""
    mode = replace(FULL_MODE if args.full else QUICK_MODE, profile=args.profile)
    folder = args.out.absolute()
    with open_processes(args.workers) as pool:
        wanted = choose_figures(args.number)
        outcome = make_paper_figures(wanted, folder, mode, pool, plots=args.plots, tell=_tell_ahead)
    if args.json:
        said = {"page": str(folder / PAGE), "held": outcome.held}
        say_json({**said, "figures": outcome.made, "failed": outcome.failed})
        return DONE if outcome.held else FAILED
    for one in outcome.made:
        lost = [n["what"] for n in one["numbers"] if not n["held"]]
        lost += [f"RMS error of {c['name']}" for c in one["captures"] if not c["held"]]
        say(f"{one['number']}: {'held' if not lost else 'NOT HELD: ' + '; '.join(lost)}")
    for number, why in outcome.failed.items():
        say(f"{number}: could not be made: {why}")
    say(f"page  {folder / PAGE}")
    return DONE if outcome.held else FAILED


def _tell_ahead(taken: int, of: int, left_s: float | None) -> None:
    left = "" if left_s is None else f", about {_time(left_s)} left"
    tell_user(f"{taken} of {of} captures{left}")


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"
