"""Turns fields of a request into options, and the options that were typed into a request.

It loops over the fields of `pdcd.protocol.fields`; nothing here depends on the name of a field.
"""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Callable, Container, Sequence
from pathlib import Path
from typing import Any

from pdcd.cli.typed import parse_share
from pdcd.errors import ConfigError
from pdcd.protocol.about import GROUPS
from pdcd.protocol.fields import Field, FieldError, fields_of, list_request_fields
from pdcd.protocol.request import CalibrateRequest, CaptureRequest

_Group = argparse._ActionsContainer  # noqa: SLF001


def add_request_fields(parser: argparse.ArgumentParser, *, without: Container[str] = ()) -> None:
    """Add all fields of a photo, in their groups, except its goal and those in `without`."""
    fields = [
        field
        for field in list_request_fields().values()
        if field.name != "goal" and field.name not in without
    ]
    for name, (title, text) in GROUPS.items():
        in_group = [field for field in fields if field.about.group == name]
        if in_group:
            group = parser.add_argument_group(title, text)
            for field in in_group:
                add_request_field(group, field)


def add_goal(parser: argparse.ArgumentParser, only: str | None = None) -> None:
    """Add the goal as the first argument, or as a constant if there is `only` one."""
    goal = list_request_fields()["goal"]
    if only is not None:
        parser.set_defaults(goal=only)
        return
    parser.add_argument(
        "goal", choices=goal.words, metavar="GOAL", help=f"{goal.text}: {', '.join(goal.words)}"
    )


def add_named(parser: argparse.ArgumentParser, names: Sequence[str]) -> None:
    """Add fields of a photo or of a calibration by their names."""
    fields = {**fields_of(CalibrateRequest), **list_request_fields()}
    for name in names:
        add_request_field(parser, fields[name])


def add_request_field(group: _Group, field: Field) -> None:
    """Add one field. If it is not typed, the request's own default applies."""
    if field.kind == "choice" and "true" in field.takes:
        _add_switched(group, field)
        return
    group.add_argument(option_of(field), dest=field.name, **_how(field))


def option_of(field: Field) -> str:
    """The name of its option on the command line."""
    return "--" + (field.about.option or field.name).replace("_", "-")


def name_options(refusal: str) -> str:
    """A refusal with the names of fields replaced by options. Code that refuses a field does not
    know that it was typed as an option."""
    options = {field.name: option_of(field) for field in list_request_fields().values()}
    names = "|".join(sorted(options, key=len, reverse=True))
    lists = rf"\b(needs|takes no|it takes|give) ((?:{names})(?:, (?:{names}))*)\b"
    first = rf"^({names})(?= \(| is | leaves | must )"

    def rename(found: re.Match[str]) -> str:
        return f"{found[1]} {', '.join(options[name] for name in found[2].split(', '))}"

    return re.sub(first, lambda found: options[found[1]], re.sub(lists, rename, refusal))


def parse_request_options(args: argparse.Namespace) -> CaptureRequest:
    """The request that was typed, checked against its types. Raises ConfigError.

    Files are left out: see `collect_array_files`.
    """
    values, faults = {}, []
    for name, field in list_request_fields().items():
        given = getattr(args, name, None)
        if given is not None and not field.is_file(given):
            try:
                values[name] = field.convert(_value(field, given), option_of(field))
            except FieldError as err:
                faults.append(str(err))
    if faults:
        raise ConfigError("\n".join(faults))
    return CaptureRequest(**values)


def collect_array_files(args: argparse.Namespace) -> dict[str, Path]:
    """The files that were named, by the request's field; this command opens them itself.

    Raises ConfigError for a value that is neither a file nor one of the words allowed instead.
    """
    found = {}
    for name, field in list_request_fields().items():
        given = getattr(args, name, None)
        if given is not None and field.is_file(given):
            found[name] = Path(given)
            there = found[name].suffix or os.path.exists(given)  # noqa: PTH110 - raises nothing
            if field.about.worded and not there:
                raise ConfigError(field.refusal(given, option_of(field)))
    return found


def _value(field: Field, given: Any) -> Any:
    """The typed value in the form of the field."""
    if isinstance(given, Path):
        return str(given.absolute())
    if field.about.one_is_both and len(given) == 1:
        return given * 2
    return given


def _add_switched(group: _Group, field: Field) -> None:
    """Add a field that takes true, false or a word: two switches, and an option for the words."""
    one_of = group.add_mutually_exclusive_group()
    dashed = field.name.replace("_", "-")
    for option, value, text in zip(
        (f"--{dashed}", f"--no-{dashed}"), (True, False), field.about.switched, strict=True
    ):
        one_of.add_argument(option, action="store_const", const=value, dest=field.name, help=text)
    one_of.add_argument(option_of(field), choices=field.words, dest=field.name, help=_help(field))


def _how(field: Field) -> dict[str, Any]:
    """The field's keywords for argparse."""
    how: dict[str, Any] = {"help": _help(field), "default": field.default}
    metavar = field.about.metavar or None
    match field.kind:
        case "switch":
            on = field.optional or field.default
            return how | {"action": argparse.BooleanOptionalAction if on else "store_true"}
        case "choice":
            return how | {"choices": field.words}
        case "array":
            return how | {"metavar": metavar, "type": Path}
        case "words":
            return how | {"metavar": metavar, "action": "append", "default": None}
        case "text":
            return how | {"metavar": metavar, **({"type": Path} if metavar == "DIR" else {})}
        case "numbers":
            how["nargs"] = "+" if field.about.one_is_both else field.count
        case "file":
            return how | {"metavar": metavar}
    return how | {"metavar": metavar, "type": _number(field)}


def _number(field: Field) -> Callable[[str], int | float | str]:
    """A function that reads a number, or a word allowed instead; argparse reports ValueErrors."""
    read: Callable[[str], int | float] = (
        int if field.whole else parse_share if field.share else float
    )

    def number(text: str) -> int | float | str:
        return text if text in field.words else read(text)

    number.__name__ = field.takes  # named in argparse's error for a wrong value
    return number


def _help(field: Field) -> str:
    """The help of a field: its text, the goals that take it, and its default."""
    parts = [field.text]
    if field.share:
        parts.append("1% is 0.01")
    if field.kind == "words":
        parts.append("again for more")
    elif field.default not in (None, "") and field.default is not False:
        parts.append(f"default: {'on' if field.default is True else field.default}")
    if field.goals:
        parts[0] += f" ({_goals(field.goals)})"
    return "; ".join(parts).replace("%", "%%")


def _goals(names: Sequence[str]) -> str:
    """Some goals in words; if they are most of all goals, by naming the others."""
    others = [goal for goal in list_request_fields()["goal"].words if goal not in names]
    if len(others) < len(names):
        return f"all goals but {', '.join(others)}"
    return f"goal{'s' * (len(names) > 1)} {', '.join(names)}"
