"""What can be typed behind the commands that look at runs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, get_args

from pdcd.cli.commands import Add, commands_below
from pdcd.cli.options import export_options, json_option, rig_options
from pdcd.words import GoalName

WHEN = "a date (2026-01-31, 2026-01-31T12:00), or how long ago: 30m, 12h, 7d, 2w"
LISTED = "list_"
"""What the names of filters of the list itself begin with. Those of a command behind it have their
own: one that was typed before the command must not be lost."""


def add_run_commands(add: Add) -> None:
    """Add what looks at runs, and what takes the paper's figures."""
    add("runs", "runs:list_runs", "list runs on disk, and do things with them", _runs)
    add("decode", "tools:decode", "decode a run folder again from its RAW files", _decode)
    add("verify", "verify:verify_runs", "say whether runs are whole and unchanged", _verify)
    add("export", "export:export", "write pictures of a finished run for other programs", _export)
    add("report", "report:report", "make a page of a finished run, with its pictures", _report)
    add("row", "row:row", "show which paths a finished run kept for one cell", _row)
    add("figures", "figures:figures", "take the paper's experiments again, as one page", _figures)


def _runs(parser: argparse.ArgumentParser) -> None:
    """Add which runs to list, and what else can be done with runs."""
    add = commands_below(parser, dest="runs_command", metavar="COMMAND")
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
    add("show", "runs:show", "say all that is known of a run", _runs_show)
    add("export", "runs:export", "write pictures of a run for other programs", _runs_export)
    add("verify", "runs:verify", "say whether runs are whole and unchanged", _runs_verify)
    add("prune", "runs_prune:prune", "remove runs that are no longer wanted", _runs_prune)


def _runs_show(parser: argparse.ArgumentParser) -> None:
    _one(parser)
    _again(parser)


def _runs_export(parser: argparse.ArgumentParser) -> None:
    _one(parser)
    export_options(parser)
    _again(parser)


def _runs_verify(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "run_name", nargs="*", metavar="RUN", help="job, name or folder; default: all finished runs"
    )
    _filters(parser)
    _again(parser)


def _runs_prune(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Remove captures, after saying which. Name at least one of --older-than, --failed and "
        "--keep; what is named together must hold together."
    )
    _filters(parser)
    parser.add_argument("--older-than", metavar="T", help=f"started before that: {WHEN}")
    parser.add_argument(
        "--keep", type=int, metavar="N", help="not the newest N of those chosen, of any age"
    )
    parser.add_argument("--dry-run", action="store_true", help="only say what would be removed")
    parser.add_argument("--yes", action="store_true", help="do not ask")
    _again(parser)


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
        choices=get_args(GoalName),
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


def _decode(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument(
        "--partial", action="store_true", help="of a run that was interrupted: a new folder"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="where that is made; default: beside the old one"
    )
    json_option(parser)


def _verify(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, nargs="+", metavar="FOLDER")
    parser.add_argument(
        "--manifest-sha256",
        metavar="HEX",
        help="what capture told of the run: shows a change that was made on purpose, too",
    )
    json_option(parser)


def _export(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    export_options(parser)
    json_option(parser)


def _report(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="default: parser.html in the run's folder"
    )
    json_option(parser)


def _row(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument(
        "--cell", type=int, nargs=2, required=True, metavar=("ROW", "COLUMN"), help="counted from 0"
    )
    parser.add_argument("--photo", metavar="NAME", help="default: the one that the answer rests on")
    parser.add_argument(
        "--out", type=Path, metavar="PNG", help="default: row-PHOTO-ROW-COLUMN.png in FOLDER"
    )
    json_option(parser)


def _figures(parser: argparse.ArgumentParser) -> None:
    """Add which figures, how finely, and where to."""
    parser.add_argument(
        "number", nargs="*", metavar="N", help="such as 1, 12, table-1, appendix; default: all"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the page")
    quality = parser.add_mutually_exclusive_group()
    quality.add_argument(
        "--quick",
        action="store_true",
        help="a coarser camera and fewer codes, some two minutes on two cores (the default)",
    )
    quality.add_argument(
        "--full", action="store_true", help="the camera's own resolution, the paper's codes; hours"
    )
    parser.add_argument(
        "--no-plots", action="store_false", dest="plots", help="leave out what needs matplotlib"
    )
    parser.add_argument("--workers", type=int, metavar="N", help="processes; default: 2")
    json_option(parser)
