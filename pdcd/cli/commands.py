"""Every command of the one parser, for what is made of it: completion and manual page.

argparse shows what it holds by names that begin with a line; all use of them is here.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import NamedTuple


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
