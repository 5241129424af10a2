"""`pdcd completion SHELL`: a script by which a shell completes commands, options, values."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pdcd.cli.exits import DONE
from pdcd.cli.parser import actions_of, build_parser, commands
from pdcd.errors import ConfigError
from pdcd.extras import install_hint


def completion(args: argparse.Namespace) -> int:
    """Print the script for a shell. Raises ConfigError where the library for it is missing."""
    sys.stdout.write(script(args.shell))
    return DONE


def script(shell: str) -> str:
    """The script for bash, zsh or fish."""
    try:
        import shtab
    except ImportError as err:
        raise ConfigError(
            "the Python package shtab is not installed", hint=install_hint("shtab")
        ) from err
    parser = build_parser()
    for each in (parser, *commands(parser)):
        for action in actions_of(each):
            if action.type is Path:
                kind = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE
                action.complete = kind  # type: ignore[attr-defined]
    made: str = shtab.complete(parser, shell)
    return made.rstrip("\n") + "\n"
