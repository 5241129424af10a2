"""`pdcd runs prune`: remove runs, after saying which."""

from __future__ import annotations

import argparse
from contextlib import closing
from pathlib import Path

from pdcd.api.progress import tell
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.moment import moment
from pdcd.cli.output import agreed, say, say_json
from pdcd.cli.runs import pages, query_of, refuse_before, say_runs
from pdcd.errors import ConfigError
from pdcd.runs.prune import Unwanted, remove, unwanted


def prune(args: argparse.Namespace) -> int:
    """Say which runs are to go, ask, and remove them; fails when one of them could not be."""
    _check(args)
    older = None if args.older_than is None else moment(args.older_than, "--older-than")
    query = query_of(args, "", newest=1)
    # Of the daemon only where its runs lie is asked: they are removed with the rights of this user.
    with closing(pages(args, query)) as found:
        state = Path(next(found).state_folder)
    going = list(
        unwanted(
            state,
            query_of(args, "", newest=1000),
            older_than=older,
            leftovers=args.failed,
            keep=args.keep or 0,
        )
    )
    if not args.json:
        _say(going, state)
    if args.dry_run or not going:
        _say_json(going, as_json=args.json)
        return DONE
    if not args.yes and not agreed(f"remove {len(going)} runs for good?", silent=args.json):
        return DONE
    gone = [remove(state, one) for one in reversed(going)]
    _say_json(gone, as_json=args.json)
    for one in gone:
        if not args.json and not one.removed:
            say(f"kept {one.run.job}: {one.why}")
    removed = [one for one in gone if one.removed]
    tell(f"removed {len(removed)} of {len(gone)} runs, {_size(removed)}")
    return DONE if len(removed) == len(gone) else FAILED


def _check(args: argparse.Namespace) -> None:
    """Raise ConfigError unless it was said which runs are to go."""
    refuse_before(args)
    if args.keep is not None and args.keep < 0:
        raise ConfigError(f"--keep {args.keep} is less than nothing")
    if args.older_than is None and args.keep is None and not args.failed:
        raise ConfigError(
            "it was not said which runs are to go",
            hint="name at least one of --older-than, --failed and --keep",
        )


def _say(going: list[Unwanted], state: Path) -> None:
    if not going:
        say(f"nothing to remove in {state}")
        return
    say(f"to be removed from {state}, the oldest first:")
    say_runs([one.run for one in reversed(going)])
    say(f"{len(going)} runs, {_size(going)}")


def _say_json(runs: list[Unwanted], *, as_json: bool) -> None:
    for one in runs if as_json else ():
        say_json(one)


def _size(runs: list[Unwanted]) -> str:
    return f"{sum(one.size_bytes for one in runs) / 2**20:.1f} MiB"
