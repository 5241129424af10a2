"""`python -m tests.request_page`: writes docs/request.md from the fields of a request."""

from __future__ import annotations

from collections.abc import Iterator

from pdcd.cli.parser import build_parser, list_subparsers
from pdcd.protocol.about import GROUPS
from pdcd.protocol.fields import (
    Field,
    fields_of,
    list_needed_fields,
    list_optional_fields,
    list_request_fields,
)
from pdcd.protocol.request import CalibrateRequest
from pdcd.recipes.goals import KEEPS
from tests.places import ROOT

PATH = ROOT / "docs" / "request.md"
HEAD = """\
# What can be asked for

A request names a goal and may set the fields below. They are the options of `pdcd capture`, `plan`,
`compare` and `transport`, the keywords of `capture` and `plan` of a bench ([python.md](python.md)),
the members of `capture.start` and `capture.plan` ([protocol.md](protocol.md)), and the form of the
page ([web.md](web.md)). What is left out comes from the configuration, or the program finds it
([no-knob.md](planning.md#what-a-plain-request-decides)).

`python -m tests.request_page` writes this page; its texts stand in `pdcd/protocol/request.py`.
"""
SHARES = """\
On the command line a share may be typed in percent (`--error 1%`), a pair of equal numbers as one
(`--rows 12`), a tag by each `--tag`, and an array is the name of a file. From Python arrays may be
arrays; for the socket see [protocol.md](protocol.md#arrays). A value of a wrong type or out of its
bounds is refused before any light, in the words of the column "takes"; what the grid of the rig
cannot mean, by the limit that the grid sets.
"""


def page() -> str:
    """The whole page."""
    return "\n".join([HEAD, *_goals(), SHARES, *_groups()]).rstrip("\n") + "\n"


def _goals() -> Iterator[str]:
    yield "## Goals\n"
    yield "| goal | keeps | needs | may have |"
    yield "|---|---|---|---|"
    for goal, keeps in KEEPS.items():
        needs, may = (
            ", ".join(f"`{n}`" for n in names(goal))
            for names in (list_needed_fields, list_optional_fields)
        )
        yield f"| `{goal}` | {keeps} | {needs} | {may} |"
    yield ""


def _groups() -> Iterator[str]:
    photo, calibration = _options("pdcd capture"), _options("pdcd calibrate")
    # On the command line these have names of their own.
    calibration |= {"steps": "`STEP ...`", "attended": "unless `--yes`", "subject": "`--scene`"}
    for name, (title, text) in GROUPS.items():
        yield f"## {_sentence(title)}\n"
        yield f"{_sentence(text)}.\n"
        yield "| field | option | takes | unless given | what it is |"
        yield "|---|---|---|---|---|"
        for kind, options in (
            (list_request_fields(), photo),
            (fields_of(CalibrateRequest), calibration),
        ):
            for field in kind.values():
                if field.about.group == name and field.name != "goal":
                    yield _row(field, options[field.name])
        yield ""


def _options(command: str) -> dict[str, str]:
    """By field, how a command calls it."""
    (parser,) = (each for each in list_subparsers(build_parser()) if each.prog == command)
    found: dict[str, list[str]] = {}
    for action in parser._actions:
        found.setdefault(action.dest, []).extend(f"`{name}`" for name in action.option_strings)
    return {field: ", ".join(names) for field, names in found.items()}


def _row(field: Field, options: str) -> str:
    usual = "" if field.default in (None, "", ()) else _value(field.default)
    cells = (f"`{field.name}`", options, field.takes, usual, _sentence(field.text))
    return f"| {' | '.join(cells)} |"


def _value(default: object) -> str:
    return str(default).lower() if isinstance(default, bool) else str(default)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


if __name__ == "__main__":
    PATH.write_text(page(), encoding="utf-8")
