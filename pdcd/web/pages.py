"""What the page is made of: its files, the headers that say what a browser may do with them, and
the fields of a request as it draws them.

The page knows no field by name; what is wrong with a value is told by `pdcd.web.app`, in the words
of `pdcd.protocol.fields`.
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
    # Else the library tells its name and version.
    "Server": "pdcd",
}
OURS = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "require-trusted-types-for 'script'; trusted-types 'none'"
)
"""What our own page may do: use its own files, and ask its own server. No text becomes a script."""
REPORTS = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; connect-src data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What a report may do: run what stands in it, as a page of no origin, which has no cookie and
reaches nothing. Anybody who may write into the state folder could have made it."""


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
    """What is told in JSON types, its options of a command line as the form calls their fields:
    "--parts 4" as "parts 4". For what advice says, from wherever it comes."""
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
    """Behind a label that does not say it, by what stands for the value on the command line."""
    unit = _UNITS.get(field.about.metavar, "")
    return f" ({unit})" if unit and not field.label.startswith(unit) else ""


def _described(field: Field) -> dict[str, Any]:
    """One field.

    `values` are those that it may be, or words that it may be in the place of a number; `each` says
    what each of several numbers is; `common` fields are shown at once.
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
