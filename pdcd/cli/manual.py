r"""`pdcd man`: the manual page, which has the help of every command as it is printed.

Only macros of man(7) that every formatter knows are used: TH, SH, nf, fi.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial

from pdcd.cli.exits import DONE
from pdcd.cli.parser import build_parser, commands
from pdcd.version import __version__

WIDTH = 72
"""Columns of the help: a formatter puts some in front of it."""
FILES = """\
$XDG_CONFIG_HOME/pdcd/pdcd.toml  the configuration; ~/.config without that variable
$XDG_STATE_HOME/pdcd             runs and calibrations; ~/.local/state without that variable
$XDG_RUNTIME_DIR/pdcd.sock       the daemon's socket
/etc/pdcd/pdcd.toml, /var/lib/pdcd, /run/pdcd.sock: the same of the service
"""


def man(args: argparse.Namespace) -> int:
    """Print the manual page."""
    sys.stdout.write(page())
    return DONE


def page() -> str:
    """The manual page: pdcd(1)."""
    parser = build_parser()
    parts = [
        f'.TH PDCD 1 "" "pdcd {__version__}" "User Commands"',
        ".SH NAME",
        rf"pdcd \- {_text(parser.description or '')}",
        ".SH DESCRIPTION",
        "Results go to the standard output, progress and errors to the standard error.",
    ]
    for each in (parser, *commands(parser)):
        each.formatter_class = partial(argparse.HelpFormatter, width=WIDTH)
        parts += [f".SH {_text(each.prog.upper())}", *_as_it_is(each.format_help())]
    return "\n".join([*parts, ".SH FILES", *_as_it_is(FILES)]) + "\n"


def _as_it_is(text: str) -> list[str]:
    return [".nf", *map(_text, text.rstrip("\n").split("\n")), ".fi"]


def _text(text: str) -> str:
    """A line in which nothing is taken for an order of roff's."""
    escaped = text.replace("\\", r"\e").replace("-", r"\-")
    return rf"\&{escaped}" if escaped[:1] in (".", "'") else escaped
