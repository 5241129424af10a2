r"""`pdcd version`, `completion SHELL`, `man`: information on the program itself.

The manual page has the help of every command as it is printed. Only macros of man(7) that every
formatter knows are used: TH, SH, nf, fi.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from pdcd.cli.exits import DONE
from pdcd.cli.parser import actions_of, build_parser, list_subparsers
from pdcd.cli.streams import write_stdout
from pdcd.errors import ConfigError
from pdcd.extras import suggest_install
from pdcd.version import __version__

_WIDTH = 72
"""Columns of the help; a formatter indents it by a few more."""
_FILES = """\
$XDG_CONFIG_HOME/pdcd/pdcd.toml  the configuration; ~/.config without that variable
$XDG_STATE_HOME/pdcd             runs and calibrations; ~/.local/state without that variable
$XDG_RUNTIME_DIR/pdcd.sock       the daemon's socket
/etc/pdcd/pdcd.toml, /var/lib/pdcd, /run/pdcd.sock: the same of the service
"""


def print_version(args: argparse.Namespace) -> int:
    """Print the version."""
    write_stdout(f"pdcd {__version__}\n")
    return DONE


def print_completion(args: argparse.Namespace) -> int:
    """Print the script for a shell. Raises ConfigError where the library for it is missing."""
    write_stdout(make_completion_script(args.shell))
    return DONE


def make_completion_script(shell: str) -> str:
    """The script for bash, zsh or fish."""
    try:
        import shtab
    except ImportError as err:
        raise ConfigError(
            "the Python package shtab is not installed", hint=suggest_install("shtab")
        ) from err
    parser = build_parser()
    for each in (parser, *list_subparsers(parser)):
        for action in actions_of(each):
            if action.type is Path:
                kind = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE
                action.complete = kind  # type: ignore[attr-defined]
    made: str = shtab.complete(parser, shell)
    return made.rstrip("\n") + "\n"


def print_manual(args: argparse.Namespace) -> int:
    """Print the manual page."""
    write_stdout(make_manual_page())
    return DONE


def make_manual_page() -> str:
    """The manual page: pdcd(1)."""
    parser = build_parser()
    parts = [
        f'.TH PDCD 1 "" "pdcd {__version__}" "User Commands"',
        ".SH NAME",
        rf"pdcd \- {_text(parser.description or '')}",
        ".SH DESCRIPTION",
        "Results go to the standard output, progress and errors to the standard error.",
    ]
    for each in (parser, *list_subparsers(parser)):
        each.formatter_class = partial(argparse.HelpFormatter, width=_WIDTH)
        parts += [f".SH {_text(each.prog.upper())}", *_as_it_is(each.format_help())]
    return "\n".join([*parts, ".SH FILES", *_as_it_is(_FILES)]) + "\n"


def _as_it_is(text: str) -> list[str]:
    return [".nf", *map(_text, text.rstrip("\n").split("\n")), ".fi"]


def _text(text: str) -> str:
    """A line escaped so that roff takes nothing in it for a request."""
    escaped = text.replace("\\", r"\e").replace("-", r"\-")
    return rf"\&{escaped}" if escaped[:1] in (".", "'") else escaped
