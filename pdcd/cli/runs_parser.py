"""What can be typed behind `pdcd runs`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pdcd.cli.options import GOALS, export_options, json_option, rig_options

WHEN = "a date (2026-01-31, 2026-01-31T12:00), or how long ago: 30m, 12h, 7d, 2w"

Make = Callable[[str, str, str], argparse.ArgumentParser]
"""Makes the parser of a command: its name, "module:function" and what it does."""


LISTED = "list_"
"""What the names of filters of the list itself begin with. Those of a command behind it have their
own: one that was typed before the command must not be lost."""


def runs_options(parser: argparse.ArgumentParser, add: Make) -> None:
    """Add which runs to list, and what else can be done with runs; `add` makes those commands."""
    parser.usage = "%(prog)s [OPTIONS] [show|export|verify|prune]"
    rig_options(parser, socket="ask the daemon that listens there")
    json_option(parser)
    _where(parser)
    _filters(parser, LISTED)
    parser.add_argument(
        "--all",
        action="store_true",
        dest=f"{LISTED}all",
        help="every run on disk, and the quick looks of previews; default: the newest 50 captures",
    )
    shown = add("show", "runs:show", "say all that is known of a run")
    _one(shown)
    exported = add("export", "runs:export", "write pictures of a run for other programs")
    _one(exported)
    export_options(exported)
    verified = add("verify", "runs:verify", "say whether runs are whole and unchanged")
    verified.add_argument(
        "run_name", nargs="*", metavar="RUN", help="job, name or folder; default: all finished runs"
    )
    _filters(verified)
    pruned = add("prune", "runs_prune:prune", "remove runs that are no longer wanted")
    pruned.description = (
        "Remove captures, after saying which. Name at least one of --older-than, --failed and "
        "--keep; what is named together must hold together."
    )
    _filters(pruned)
    pruned.add_argument("--older-than", metavar="T", help=f"started before that: {WHEN}")
    pruned.add_argument(
        "--keep", type=int, metavar="N", help="not the newest N of those chosen, of any age"
    )
    pruned.add_argument("--dry-run", action="store_true", help="only say what would be removed")
    pruned.add_argument("--yes", action="store_true", help="do not ask")
    for made in (shown, exported, verified, pruned):
        _again(made)


def _one(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_name", metavar="RUN", help="its job, its name or its folder")


def _where(parser: argparse.ArgumentParser, **more: Any) -> None:
    parser.add_argument(
        "--state-dir",
        type=Path,
        metavar="DIR",
        help="look below this folder; default: where the daemon has its runs, else where "
        "captures without a daemon go",
        **more,
    )


def _again(parser: argparse.ArgumentParser) -> None:
    """Add what may be typed before the name of the command as well, and counts where it stands."""
    kept: dict[str, Any] = {"default": argparse.SUPPRESS}
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="configuration; default: the mock bench", **kept
    )
    parser.add_argument(
        "--socket", type=Path, metavar="PATH", help="ask the daemon that listens there", **kept
    )
    _where(parser, **kept)
    parser.add_argument("--json", action="store_true", help="print JSON, one object a line", **kept)


def _filters(parser: argparse.ArgumentParser, before: str = "") -> None:
    """Add which runs are meant; `before` is what their names in the namespace begin with."""
    parser.add_argument(
        "--goal",
        choices=GOALS,
        dest=f"{before}goal",
        metavar="GOAL",
        help="photos of this goal",
    )
    parser.add_argument(
        "--since", dest=f"{before}since", metavar="T", help=f"started then or later: {WHEN}"
    )
    parser.add_argument(
        "--tag",
        action="append",
        dest=f"{before}tags",
        metavar="WORD",
        help="with this tag; again for more, all of which they must have",
    )
    parser.add_argument(
        "--failed",
        action="store_true",
        dest=f"{before}failed",
        help="of which no whole run came; prune: leftovers without a manifest",
    )
