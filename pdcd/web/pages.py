"""The parts of the page: its files, the headers that say what a browser may do with them, and the
fields of a request as the page draws them.

The page knows no field by name; `pdcd.web.app` says what is wrong with a value, in the words of
`pdcd.protocol.fields`.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from pdcd.protocol.about import GROUPS
from pdcd.protocol.fields import Field, list_request_fields

_TYPES: Mapping[str, str] = {
    "html": "text/html",
    "css": "text/css",
    "js": "text/javascript",
    "svg": "image/svg+xml",
}
INDEX = "index.html"
_UNITS: Mapping[str | tuple[str, ...], str] = {
    "CELLS": "cells",
    ("DOWN", "RIGHT"): "cells",
    ("LOW", "HIGH"): "cells",
    "S": "s",
    **dict.fromkeys("CEP", "share of 1"),
}
_OPTION = re.compile(r"(?<![\w-])--([a-z][a-z-]*)")

ALWAYS: Mapping[str, str] = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=(), usb=()",
    # Otherwise the library sends its own name and version.
    "Server": "pdcd",
}
OURS = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "require-trusted-types-for 'script'; trusted-types 'none'"
)
"""What our own page may do: use its own files and ask its own server. No text runs as a script."""
REPORTS = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; connect-src data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What a report may do: run its own scripts, as a page without origin, which has no cookies and
reaches no server. Anybody who can write into the state folder could have made it."""


def read_page_files() -> dict[str, tuple[str, bytes]]:
    """Type and contents of every file of the page, by name."""
    found = {}
    for file in files("pdcd.web").joinpath("page").iterdir():
        kind = _TYPES.get(file.name.rpartition(".")[2])
        if kind is not None:
            found[file.name] = kind, file.read_bytes()
    return found


def list_form_groups() -> list[dict[str, Any]]:
    """All fields but the goal, group by group: `title` and `fields`; parameters of goals first."""
    groups = []
    for name in sorted(GROUPS, key=lambda name: name != "goal"):
        fields = [
            _described(field)
            for field in list_request_fields().values()
            if field.about.group == name and field.name != "goal"
        ]
        if fields:
            groups.append({"title": GROUPS[name][0], "fields": fields})
    return groups


def name_fields(told: Any) -> Any:
    """A message in JSON types, with command line options replaced by the form's names of fields:
    "--parts 4" becomes "parts 4". It is for advice from any part of the program."""
    if isinstance(told, str):
        return _OPTION.sub(_name_field, told) if "--" in told else told
    if isinstance(told, dict):
        return {key: name_fields(value) for key, value in told.items()}
    return [name_fields(value) for value in told] if isinstance(told, list | tuple) else told


def _name_field(option: re.Match[str]) -> str:
    return _labels().get(option[1], option[0])


@functools.cache
def _labels() -> Mapping[str, str]:
    fields = list_request_fields().values()
    return {each.about.option or each.name.replace("_", "-"): each.label for each in fields}


def _unit(field: Field) -> str:
    """The unit to add to a label that lacks it, by the value's placeholder on the command line."""
    unit = _UNITS.get(field.about.metavar, "")
    return f" ({unit})" if unit and not field.label.startswith(unit) else ""


def _described(field: Field) -> dict[str, Any]:
    """One field, for the page.

    `values` are its allowed values, or words allowed in place of a number; `each` names each of
    several numbers; `common` fields are shown at once.
    """
    values: list[bool | str] = list(field.words)
    several = field.about.metavar if isinstance(field.about.metavar, tuple) else ()
    if field.kind == "switch" or "true" in field.takes:
        values = [True, False, *values]
    return {
        "name": field.name,
        "label": field.label + _unit(field),
        "text": field.text,
        "takes": field.takes,
        "kind": field.kind,
        "values": values,
        "count": field.count,
        "each": [name.lower() for name in several],
        "optional": field.optional,
        "default": field.default or None if field.kind == "text" else field.default,
        "common": field.about.common,
        "of_goals": bool(field.goals),
    }
