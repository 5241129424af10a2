"""A TOML file -> typed values, all its faults at once, each in the words of the file.

The configuration and what belongs to it are read by these rules.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec

from pdcd.bench.options import convert_field, unknown_key
from pdcd.errors import ConfigError

_S = TypeVar("_S", bound=msgspec.Struct)

MAX_INTEGER = 2**53
"""Integers stay below this in every message, so that any JSON reader keeps them exactly."""


class Fault(NamedTuple):
    """One fault: the keys it is about (dotted) and what to do."""

    keys: tuple[str, ...]
    message: str


def toml_table(source: Path, what: str, hint: str) -> dict[str, Any]:
    """The tables of a TOML file, nothing of them checked but that numbers have at most 64 bits.

    `what` names the file for people, `hint` says what to do where it cannot be read. Raises
    ConfigError for what is no TOML file.
    """
    try:
        return text_table(source.read_text(encoding="utf-8"), source)
    except OSError as err:
        raise ConfigError(f"cannot read {what} {source}: {err.strerror}", hint=hint) from err
    except UnicodeDecodeError as err:
        raise ConfigError(f"{source} is not TOML: {err}") from err


def text_table(text: str, called: Path | str) -> dict[str, Any]:
    """The tables of a TOML text, checked as those of a file; `called` names it for people.

    Raises ConfigError.
    """
    try:
        return sized(tomllib.loads(text), called)
    except RecursionError as err:
        raise ConfigError(f"{called} is nested too deeply") from err
    except ValueError as err:  # not TOML, or a number of thousands of digits
        raise ConfigError(f"{called} is not TOML: {err}") from err


def sized(table: dict[str, Any], called: Path | str) -> dict[str, Any]:
    """The tables themselves, if all their integers have at most 64 bits. Raises ConfigError."""
    beyond = list(_beyond_64_bits(table))
    if beyond:
        raise faults_error(called, [f"{key}: a number has more than 64 bits" for key in beyond])
    return table


def faults_error(source: Path | str | None, lines: Sequence[str]) -> ConfigError:
    """The error that lists all faults of a file, one a line; None is the mock bench."""
    count = f"{len(lines)} faults" if len(lines) > 1 else "1 fault"
    listed = "\n  ".join(lines)
    return ConfigError(f"{count} in {source or 'the mock bench'}:\n  {listed}")


def overlay(base: _S, given: Any, where: str, faults: list[Fault]) -> _S:
    """Copy of `base` with the keys of the table `given` put in, each checked against its type.

    Keys that cannot be read are left as they are in `base` and reported in `faults`.
    """
    if not isinstance(given, dict):
        faults.append(Fault((where,), f"{where}: must be a table, not {given!r}"))
        return base
    fields = {f.encode_name: f for f in msgspec.structs.fields(base)}
    values: dict[str, Any] = {}
    for key, value in given.items():
        name = f"{where}.{key}" if where else key
        if key not in fields:
            faults.append(Fault((name,), unknown_key(name, key, fields)))
            continue
        present = getattr(base, fields[key].name)
        if isinstance(present, msgspec.Struct):
            values[key] = overlay(present, value, name, faults)
            continue
        try:
            values[key] = convert_field(value, fields[key], name)
        except ValueError as err:
            faults.append(Fault((name,), str(err)))
    return msgspec.structs.replace(base, **values)


def _beyond_64_bits(value: Any, key: str = "") -> Iterator[str]:
    """Keys of integers that TOML does not know, and that floats cannot always hold."""
    if isinstance(value, dict):
        for name, held in value.items():
            yield from _beyond_64_bits(held, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for held in value:
            yield from _beyond_64_bits(held, key)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        yield key


def number_faults(value: Any, key: str) -> Iterator[Fault]:
    """Yield NaN, infinities and integers too large for JSON, however deep they lie."""
    if isinstance(value, dict):
        for name, item in value.items():
            yield from number_faults(item, f"{key}.{name}" if key else name)
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from number_faults(item, f"{key}[{index}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield Fault((key,), f"{key}: must be a finite number, not {value}")
    elif isinstance(value, int) and abs(value) >= MAX_INTEGER:
        yield Fault((key,), f"{key}: must be below 2**53 in size, not {value}")
