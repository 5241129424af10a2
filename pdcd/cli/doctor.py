"""`pdcd doctor ...`: what of the bench is fit to work, what is not, and what to do about it."""

from __future__ import annotations

import argparse

from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say, say_json, say_table
from pdcd.config import load


def display(args: argparse.Namespace) -> int:
    """Look at the X server and at both panels; fails when anything must be mended."""
    from pdcd.presenter.examine import examine

    found = list(examine(load(args.config), args.display))
    faults = sum(f.state == "fault" for f in found)
    if args.json:
        say_json({"fit": not faults, "findings": found})
        return FAILED if faults else DONE
    say_table([[f.state, f.what, f.found] for f in found])
    for finding in found:
        if finding.hint is not None:
            say(f"{finding.what}: {finding.hint}")
    say("nothing to mend" if not faults else f"{faults} to mend")
    return FAILED if faults else DONE
