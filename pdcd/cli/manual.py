r"""`pdcd man`: the manual page, made of the one parser, in the language of man(7).

Only macros that every formatter knows are used: TH, SH, SS, TP, PP, B, I, nf, fi.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

from pdcd.cli.commands import EXIT_CODES, commands, groups, help_of, words_of
from pdcd.cli.exits import DONE
from pdcd.cli.parser import build_parser
from pdcd.version import __version__

FILES = (
    ("$XDG_CONFIG_HOME/pdcd/pdcd.toml", "the configuration; ~/.config without that variable"),
    ("$XDG_STATE_HOME/pdcd", "runs and calibrations; ~/.local/state without that variable"),
    ("$XDG_RUNTIME_DIR/pdcd.sock", "the daemon's socket"),
    ("/etc/pdcd/pdcd.toml, /var/lib/pdcd, /run/pdcd.sock", "the same of the service"),
)


def man(args: argparse.Namespace) -> int:
    """Print the manual page."""
    sys.stdout.write(page())
    return DONE


def page() -> str:
    """The manual page: pdcd(1)."""
    return "\n".join(_page(build_parser())) + "\n"


def _page(parser: argparse.ArgumentParser) -> Iterator[str]:
    yield f'.TH PDCD 1 "" "pdcd {__version__}" "User Commands"'
    yield ".SH NAME"
    yield rf"pdcd \- {_text(parser.description or '')}"
    yield ".SH SYNOPSIS"
    yield ".B pdcd"
    yield r"\fICOMMAND\fR [\fIOPTIONS\fR]"
    yield ".SH DESCRIPTION"
    yield "Results go to the standard output, progress and errors to the standard error."
    yield from _options(parser)
    yield ".SH COMMANDS"
    for command in commands(parser):
        yield f".SS {_text(command.parser.prog)}"
        yield _sentence(command.parser.description or command.summary)
        yield ".PP"
        yield from _synopsis(command.parser)
        yield from _options(command.parser)
    yield ".SH EXIT STATUS"
    yield _sentence(EXIT_CODES.removeprefix("exit codes: "))
    yield ".SH FILES"
    for name, text in FILES:
        yield from (".TP", f".I {_text(name)}", _sentence(text))
    yield ".SH SEE ALSO"
    yield "README.md and docs/ of the sources explain goals, runs, the socket and how it works."


def _synopsis(parser: argparse.ArgumentParser) -> Iterator[str]:
    """How the command is written, all its options in one word."""
    actions = [action for _, found in groups(parser) for action in found]
    places = [words_of(action) for action in actions if not action.option_strings]
    below = ["[COMMAND]"] if any(commands(parser)) else []
    yield f".B {_text(' '.join([parser.prog, '[OPTIONS]', *places, *below]))}"


def _options(parser: argparse.ArgumentParser) -> Iterator[str]:
    for title, actions in groups(parser):
        # What every parser has needs no title of its own.
        if title not in ("options", "positional arguments"):
            yield from (".PP", _sentence(title))
        for action in actions:
            if action.help == argparse.SUPPRESS:
                continue
            words = _text(words_of(action))
            names = ", ".join(rf"\fB{_text(name)}\fR" for name in action.option_strings)
            shown = " ".join(filter(None, (names, words and rf"\fI{words}\fR")))
            yield from (".TP", shown, _sentence(help_of(action, parser)) or r"\&")


def _sentence(text: str) -> str:
    """A text that begins with a capital and ends with a full stop."""
    escaped = _text(text[:1].upper() + text[1:])
    return escaped if not text or text.endswith(".") else f"{escaped}."


def _text(text: str) -> str:
    """A text in which nothing is taken for an order of roff's."""
    escaped = text.replace("\\", r"\e").replace("-", r"\-")
    return rf"\&{escaped}" if escaped[:1] in (".", "'") else escaped
