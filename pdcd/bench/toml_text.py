"""Plain values -> TOML text, so that a resolved configuration can be kept as a file."""

from __future__ import annotations

import datetime
import json
import re
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

from pdcd.printable import one_line

TIMES = (datetime.datetime, datetime.date, datetime.time)
"""The types that TOML has and JSON lacks."""


NO_NOTES: Mapping[tuple[str, ...], str] = MappingProxyType({})


def emit(table: Mapping[str, Any], notes: Mapping[tuple[str, ...], str] = NO_NOTES) -> str:
    """Return `table` as TOML 1.0 text that `tomllib.loads` reads back to the same value.

    notes : comments, each for the key or the table at a path.

    Values are what TOML knows: tables, arrays, strings, integers, floats, booleans, dates and
    times. A key whose value is None is left out, for TOML has no such value.
    """
    return "\n".join(_lines(table, (), notes)).strip() + "\n"


def _lines(
    table: Mapping[str, Any], path: tuple[str, ...], notes: Mapping[tuple[str, ...], str]
) -> Iterator[str]:
    """Yield the lines of one table: its own keys first, then its tables under their headers."""

    def noted(line: str, key: str) -> str:
        note = notes.get((*path, key))
        return line if note is None else f"{line}  # {one_line(note)}"

    for key, value in table.items():
        if value is not None and not isinstance(value, Mapping):
            yield noted(f"{_key(key)} = {_value(value)}", key)
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield ""
            yield noted(f"[{'.'.join(_key(part) for part in (*path, key))}]", key)
            yield from _lines(value, (*path, key), notes)


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _string(key)


def _value(value: Any) -> str:
    """One value on one line; tables inside arrays are written inline."""
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        items = (f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None)
        return "{" + ", ".join(items) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return value.isoformat() if isinstance(value, TIMES) else repr(value)


def _string(text: str) -> str:
    """Quote as a basic string: JSON's escapes are TOML's, but for DEL, which JSON leaves raw."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
