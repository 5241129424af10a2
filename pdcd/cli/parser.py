"""The parser of the command line, made from the table in `pdcd.cli.typed`.

argparse shows its contents only through names that begin with an underscore; all uses of these are
here.
"""

from __future__ import annotations

import argparse
import functools
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

from pdcd.cli.refusing import CommandParser
from pdcd.cli.typed import COMMANDS, SHARED, WHEN, parse_share
from pdcd.version import __version__
from pdcd.words import GoalName, MovingName, PatternName, StepName

EXIT_CODES = (
    "exit codes: 0 done, 2 usage or configuration, 3 daemon unreachable, 4 busy, 5 failed, "
    "6 denied, 130 cancelled (what lasts until Ctrl-C, as stream and serve do, ends by it with 0)"
)
LISTED = "list_"
"""Prefix for names of the list's own filters. Filters of a command after it have other names, so
that a filter typed in front of the command is not lost."""
_PATTERNS = (*get_args(PatternName), *get_args(MovingName))
_WORDS = {
    "<patterns>": ", ".join(_PATTERNS),
    "<still>": ", ".join(get_args(PatternName)),
    "<steps>": ", ".join(get_args(StepName)),
    "<when>": WHEN,
}
"""Placeholders in the table, for words that are defined elsewhere."""

_How = dict[str, Any]
"""Keywords for argparse's `add_argument`."""


_TYPES: dict[str, Callable[[str], Any]] = {
    **dict.fromkeys(("FILE", "DIR", "PATH", "PNG", "FOLDER"), Path),
    **dict.fromkeys(("N", "ROW"), int),
    **dict.fromkeys(("S", "E", "X", "BLACK", "HZ"), float),
    "SHARE": parse_share,
}
"""Type of a value, by the (first) word that stands for it; other words stand for text."""
_CHOICES = {"GOAL": get_args(GoalName), "PATTERN": _PATTERNS, "STILL": get_args(PatternName)}
"""Allowed values, by the word that stands for a value."""


class ArgumentRow(NamedTuple):
    """One row of a table: its first column, all the text after it, and the rows below it."""

    first: str
    text: str
    below: list[ArgumentRow]


@functools.cache
def _rows_of(table: str) -> list[ArgumentRow]:
    """The rows of a table (see `pdcd.cli.typed`); they are kept, so do not change them."""
    for word, meant in _WORDS.items():
        table = table.replace(word, meant)
    found: list[ArgumentRow] = []
    for line in re.sub(r"\n {10,}", " ", table).strip("\n").splitlines():
        first, _, text = line.strip().partition("  ")
        row = ArgumentRow(first, text.strip(), [])
        if line.startswith(" "):
            found[-1].below.append(row)
        elif line:
            found.append(row)
    return found


def build_parser(typed: Sequence[str] | None = None) -> argparse.ArgumentParser:
    """Return the parser; it sets `run` to the "module:function" of the command.

    typed : the words of the command line. Commands that are not among them get no options, as
    options import modules, which takes time. None: all commands get their options.
    """
    parser = CommandParser(
        prog="pdcd",
        description="Photograph chosen light paths: a projector, an LCD mask and a camera.",
        epilog=EXIT_CODES,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"pdcd {__version__}")
    parser.set_defaults(json=False)
    _add_commands(parser, _rows_of(COMMANDS), "command", typed, required=True)
    return parser


def _add_commands(
    parser: argparse.ArgumentParser,
    rows: list[ArgumentRow],
    dest: str,
    typed: Sequence[str] | None,
    *,
    required: bool,
) -> None:
    """Add commands of one word, each with its options and its own commands of a second word."""
    below = parser.add_subparsers(
        parser_class=CommandParser, dest=dest, required=required, metavar="COMMAND"
    )
    for row in rows:
        name, _, more = row.first.partition(" ")
        if more:
            continue
        run, _, text = row.text.partition("  ")
        told = {each.first: each.text for each in row.below}
        made = below.add_parser(
            name,
            help=text.strip(),
            description=told.get("more", text.strip()),
            epilog=EXIT_CODES,
            allow_abbrev=False,
        )
        made.set_defaults(run=run)
        if typed is not None and name not in typed:
            continue
        own = [
            each._replace(first=each.first.removeprefix(f"{name} "))
            for each in rows
            if each.first.startswith(f"{name} ")
        ]
        if own:
            _add_commands(made, own, f"{name}_command", None, required=run == "-")
        usages = [f"%(prog)s {each.text}" for each in row.below if each.first == "usage"]
        if usages:  # only now, else the names of its own commands would begin with it
            made.usage = "\n       ".join(usages)
        _add_options(made, row.below)


def _add_options(
    parser: argparse.ArgumentParser,
    rows: list[ArgumentRow],
    before: str = "",
    how: _How | None = None,
) -> None:
    """Add options. before : prefix of their names in the namespace. how : keywords for all."""
    for row in rows:
        what, *words = row.first.split()
        if what.startswith("@"):
            _add_shared(parser, what[1:], words, how)
        elif what not in ("usage", "more"):
            names, told = _read_option(row.first)
            if before:
                told["dest"] = before + (told.get("dest") or names[-1].lstrip("-"))
            said = [row.text]
            if "default" in told:
                said.append(f"default: {told['default']}".removesuffix(".0"))
            text = "; ".join(filter(None, said)).replace("%", "%%")
            parser.add_argument(*names, **told | (how or {}), help=text or None)


def _add_shared(
    parser: argparse.ArgumentParser, name: str, words: list[str], how: _How | None
) -> None:
    """Add lines that several commands share, or fields of a request."""
    if name in ("photo", "fields"):
        from pdcd.cli import request

        if name == "fields":
            request.add_named(parser, words)
            return
        told = dict(word.split("=") for word in words)
        request.add_goal(parser, told.get("goal"))
        _add_options(parser, [ArgumentRow("@client", "", []), ArgumentRow("@local", "", [])])
        request.add_request_fields(parser, without=told.get("without", "").split(","))
        return
    if name == "again":  # an option typed before the command applies unless repeated
        name, how = "runs", {"default": argparse.SUPPRESS}
    (rows,) = (row.below for row in _rows_of(SHARED) if row.first == name)
    _add_options(parser, rows, LISTED if words else "", how)


def _read_option(text: str) -> tuple[list[str], _How]:
    """Names of an option or an argument, and its keywords for argparse; see `pdcd.cli.typed`."""
    words = text.split()
    how: _How = {}
    if ">" in words:
        *words, _, how["dest"] = words
    if "!" in words:
        words.remove("!")
        how["required"] = True
    names = [word for word in words if word.startswith("-")] or words[:1]
    value, _, default = " ".join(words[len(names) :]).partition("=")
    if not value:
        off = names[-1] == f"--no-{how.get('dest')}"
        return names, how | {"action": "store_false" if off else "store_true"}
    optional, again = value.startswith("["), "..." in value
    values = value.strip("[]").replace("...", "").split()
    kind = _TYPES.get(values[0], str)
    if values[0].startswith("{"):
        how["choices"] = tuple(values[0].strip("{}").split(","))
    else:
        how |= {"type": kind, "metavar": values[0], "choices": _CHOICES.get(values[0])}
    if len(values) > 1:
        how |= {"metavar": tuple(values), "nargs": len(values)}
    elif optional:
        how["nargs"] = "*" if again else "?"
    elif again and names[0].startswith("-"):
        how["action"] = "append"
    elif again:
        how["nargs"] = "+"
    if default:
        how["default"] = kind(default)
    return names, how


def list_subparsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The parsers of all commands below one, in order; each comes before its own commands."""
    for action in parser._actions:  # noqa: SLF001
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for below in action.choices.values():
                yield below
                yield from list_subparsers(below)


def actions_of(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """The options and arguments of a command, without its own commands."""
    return [
        action
        for action in parser._actions  # noqa: SLF001
        if not isinstance(action, argparse._SubParsersAction)  # noqa: SLF001
    ]
