"""What can be typed behind the commands that take or plan a photo."""

from __future__ import annotations

import argparse
from collections.abc import Container
from pathlib import Path

from pdcd.cli.commands import Add
from pdcd.cli.options import client_options, queue_option, rig_options


def add_photo_commands(add: Add) -> None:
    """Add the daemon, and what takes or plans a photo."""
    add("serve", "serve:serve", "run the daemon in the foreground", _serve)
    add("capture", "capture:capture", "take a photo and wait for it", _capture)
    add("transport", "capture:capture", "photograph entries of the transport matrix", _transport)
    add("compare", "compare:compare", "take a photo by every method, side by side", _compare)
    add("demo", "demo:demo", "start a daemon on the mock bench and take one photo with it", _demo)
    add("plan", "capture:plan", "say what a capture would do, without doing it", _plan)


def _serve(parser: argparse.ArgumentParser) -> None:
    rig_options(parser, socket="listen here")
    parser.add_argument("--state-dir", type=Path, metavar="DIR", help="keep runs below this folder")
    parser.add_argument(
        "-v",
        "--verbose",
        action="store_true",
        help="log everything at a terminal, too, not warnings alone",
    )


def _capture(parser: argparse.ArgumentParser) -> None:
    _photo(parser)
    _detach_option(parser)
    queue_option(parser)


def _transport(parser: argparse.ArgumentParser) -> None:
    _photo(parser, goal="transport", without=["method"])
    parser.usage = "%(prog)s [OPTIONS] [--rows R [R2]]"
    _detach_option(parser)
    queue_option(parser)


def _compare(parser: argparse.ArgumentParser) -> None:
    _photo(parser, without=["method"])


def _plan(parser: argparse.ArgumentParser) -> None:
    _photo(parser, without=["out"])
    queue_option(parser)


def _demo(parser: argparse.ArgumentParser) -> None:
    from pdcd.cli.request import add_field
    from pdcd.protocol.fields import request_fields

    parser.add_argument(
        "--out", type=Path, default=Path("demo"), metavar="DIR", help="default: demo"
    )
    for name in ("codes", "seed"):
        add_field(parser, request_fields()[name])
    parser.set_defaults(codes=128)


def _photo(
    parser: argparse.ArgumentParser, *, goal: str | None = None, without: Container[str] = ()
) -> None:
    """Add one photo as asked for, with its goal if it is not this one; what is left out takes the
    configuration's value."""
    from pdcd.cli.request import add_fields, add_goal

    if goal is None:
        # All options in the first line of a mistake would hide the mistake: --help has them.
        parser.usage = "%(prog)s [OPTIONS] GOAL"
        add_goal(parser)
    else:
        parser.set_defaults(goal=goal)
    client_options(parser)
    parser.add_argument(
        "--local", action="store_true", help="drive the rig from this process, without a daemon"
    )
    add_fields(parser, without=without)


def _detach_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--detach", action="store_true", help="start only; the job outlives this command"
    )
