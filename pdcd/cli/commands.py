"""Commands of the one parser: how they are added, and all of them for what is made of it.

argparse shows what it holds by names that begin with a line; all use of them is here.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, Protocol

EXIT_CODES = (
    "exit codes: 0 done, 2 usage or configuration, 3 daemon unreachable, 4 busy, 5 failed, "
    "6 denied, 130 cancelled"
)

Fill = Callable[[argparse.ArgumentParser], None]
"""Adds the options of a command to its parser."""


class Add(Protocol):
    """Adds a command: its name, "module:function" and what it does; `fill` adds its options."""

    def __call__(self, name: str, run: str, text: str, fill: Fill) -> None:
        """Add it."""


class CommandParser(argparse.ArgumentParser):
    """The parser of a command, which adds its options once they are needed.

    Most are never: `pdcd --help` needs those of no command, and any command only its own.
    """

    def __init__(self, *args: Any, fill: Fill | None = None, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._fill = fill

    def filled(self) -> CommandParser:
        """The same, with its options."""
        fill, self._fill = self._fill, None
        if fill is not None:
            fill(self)
        return self

    def parse_known_args(  # type: ignore[override]  # of its overloads, argparse uses this one
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """What was typed, by all options of the command."""
        self.filled()
        return super().parse_known_args(args, namespace)

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """Values of an option, as their type has them. argparse takes "--" out of them as if it
        stood by itself: of `--out=--` an empty list would be left, whatever the option's type."""
        if action.option_strings and "--" in arg_strings:
            raise argparse.ArgumentError(action, "expected a value, not --")
        return super()._get_values(action, arg_strings)


def commands_below(parser: argparse.ArgumentParser, **how: Any) -> Add:
    """What adds commands below a parser; `how` is what argparse's `add_subparsers` takes."""
    below = parser.add_subparsers(parser_class=CommandParser, **how)

    def add(name: str, run: str, text: str, fill: Fill) -> None:
        made = below.add_parser(
            name, help=text, description=text, epilog=EXIT_CODES, allow_abbrev=False, fill=fill
        )
        made.set_defaults(run=run)

    return add


class Command(NamedTuple):
    """One command: its parser, whose `prog` is all its words, and the line that says what it does
    in the list of commands."""

    parser: argparse.ArgumentParser
    summary: str


def commands(parser: argparse.ArgumentParser) -> Iterator[Command]:
    """All commands below a parser, each before those of its own, as they were added."""
    for action in parser._actions:  # noqa: SLF001
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            told = {choice.dest: choice.help or "" for choice in action._choices_actions}  # noqa: SLF001
            for name, below in action.choices.items():
                if isinstance(below, CommandParser):
                    below.filled()
                yield Command(below, told.get(name, ""))
                yield from commands(below)


def groups(parser: argparse.ArgumentParser) -> Iterator[tuple[str, list[argparse.Action]]]:
    """What can be typed behind a command, in groups with their titles; commands left out."""
    for group in parser._action_groups:  # noqa: SLF001
        actions = [
            action
            for action in group._group_actions  # noqa: SLF001
            if not isinstance(action, argparse._SubParsersAction)  # noqa: SLF001
        ]
        if actions:
            yield group.title or "options", actions


def help_of(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    """What an option does, as --help has it; and its choices, where nothing else names them."""
    text = (action.help or "") % {**vars(action), "prog": parser.prog}
    if action.choices and action.metavar is None:
        text = "; ".join(filter(None, (text, "one of " + ", ".join(map(str, action.choices)))))
    return text


def words_of(action: argparse.Action) -> str:
    """How the values of an option or an argument are written: "FILE", "DOWN RIGHT", "[RUN ...]"."""
    if action.nargs == 0:
        return ""
    name = action.dest.upper() if action.metavar is None else action.metavar
    if isinstance(name, tuple):
        if action.nargs == "+":
            return f"{name[0]} [{' '.join(name[1:])} ...]"
        return " ".join(name)
    match action.nargs:
        case int():
            return " ".join([name] * action.nargs)
        case "?":
            return f"[{name}]"
        case "*":
            return f"[{name} ...]"
        case "+":
            return f"{name} [{name} ...]"
    return name
