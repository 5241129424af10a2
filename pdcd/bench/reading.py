"""Tables as written <-> typed values. All faults are found at once, each in the words of the file,
its key first.

The configuration and its files are read by these rules, and so is the `options` table of every
driver. Plain values can be written as TOML text again, so that a resolved configuration can be kept
as a file.
"""

from __future__ import annotations

import datetime
import json
import math
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import msgspec
from msgspec.structs import FieldInfo

from pdcd.errors import ConfigError
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import read_file, read_pipe
from pdcd.meant import suggest_number, suggest_pair, suggest_word
from pdcd.printable import to_one_line

if TYPE_CHECKING:
    from pdcd.bench.tables import Config

_S = TypeVar("_S", bound=msgspec.Struct)

_MAX_BYTES = 2**20
"""Longest file that is read."""
_PIPE_S = 10.0
"""How long the program that started pdcd may take to write the configuration to a pipe."""
_MAX_INTEGER = 2**53
"""Integers stay below this in every message, so that any JSON reader keeps them exactly."""

_FORM = "pdcd config show prints the form of a whole file"


class ConfigFault(NamedTuple):
    """One fault: the keys it is about (dotted) and what to do."""

    keys: tuple[str, ...]
    message: str


def read_toml(
    source: Path, what: str, hint: str, *, form: str = _FORM, may_be_pipe: bool = False
) -> dict[str, Any]:
    """The tables of a TOML file, unchecked except that integers have at most 64 bits.

    `what` names the file for people, `hint` says what to do where it cannot be read, `form` where
    it is not TOML.

    may_be_pipe : only for the configuration, which the program that starts pdcd may pass in a pipe.

    Raises ConfigError for what is no TOML file.
    """
    try:
        if may_be_pipe and source.is_fifo():
            data = read_pipe(source, _MAX_BYTES, _PIPE_S)
        else:
            data = read_file(source, _MAX_BYTES)
        return parse_toml(data.decode(), source, form)
    except UnsoundFileError as err:
        raise ConfigError(f"cannot read {what} {source}: {err.why}", hint=hint) from err
    except OSError as err:
        raise ConfigError(f"cannot read {what} {source}: {err.strerror}", hint=hint) from err
    except UnicodeDecodeError as err:
        raise ConfigError(f"{source} is not TOML: {err}", hint=form) from err


def parse_toml(text: str, called: Path | str, form: str = _FORM) -> dict[str, Any]:
    """The tables of a TOML text, checked like those of a file; `called` names it for people, `form`
    says what to do where it is not TOML.

    Raises ConfigError.
    """
    try:
        return check_integers(tomllib.loads(text), called)
    except RecursionError as err:
        raise ConfigError(f"{called} is nested too deeply") from err
    except ValueError as err:  # not TOML, or a number of thousands of digits
        raise ConfigError(f"{called} is not TOML: {err}", hint=form) from err


def check_integers(table: dict[str, Any], called: Path | str) -> dict[str, Any]:
    """The tables themselves, if all their integers have at most 64 bits. Raises ConfigError."""
    beyond = list(_beyond_64_bits(table))
    if beyond:
        raise make_faults_error(
            called, [f"{key}: a number has more than 64 bits" for key in beyond]
        )
    return table


def make_faults_error(source: Path | str | None, lines: Sequence[str]) -> ConfigError:
    """The error that lists all faults of a file, one a line; None is the mock bench."""
    count = f"{len(lines)} faults" if len(lines) > 1 else "1 fault"
    listed = "\n  ".join(lines)
    return ConfigError(f"{count} in {source or 'the mock bench'}:\n  {listed}")


def merge_table(base: _S, given: Any, where: str, faults: list[ConfigFault]) -> _S:
    """Copy of `base` with the keys of the table `given` put in, each checked against its type.

    Keys that cannot be read are left as they are in `base` and reported in `faults`.
    """
    if not isinstance(given, dict):
        said = f"{where}: must be a table, not {given!r}; write [{where}]"
        faults.append(ConfigFault((where,), said))
        return base
    fields = {f.encode_name: f for f in msgspec.structs.fields(base)}
    values: dict[str, Any] = {}
    for key, value in given.items():
        name = f"{where}.{key}" if where else key
        if key not in fields:
            faults.append(ConfigFault((name,), describe_unknown_key(name, key, fields)))
            continue
        present = getattr(base, fields[key].name)
        if isinstance(present, msgspec.Struct):
            values[key] = merge_table(present, value, name, faults)
            continue
        try:
            values[key] = _convert_field(value, fields[key], name)
        except ValueError as err:
            faults.append(ConfigFault((name,), str(err)))
    return msgspec.structs.replace(base, **values)


def _beyond_64_bits(value: Any, key: str = "") -> Iterator[str]:
    """Keys of integers beyond the range of TOML, which floats cannot always hold."""
    if isinstance(value, dict):
        for name, held in value.items():
            yield from _beyond_64_bits(held, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for held in value:
            yield from _beyond_64_bits(held, key)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        yield key


def find_number_faults(value: Any, key: str) -> Iterator[ConfigFault]:
    """Yield faults for NaN, infinities and integers too large for JSON, at any depth."""
    if isinstance(value, dict):
        for name, item in value.items():
            yield from find_number_faults(item, f"{key}.{name}" if key else name)
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from find_number_faults(item, f"{key}[{index}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield ConfigFault((key,), f"{key}: must be a finite number, not {value}")
    elif isinstance(value, int) and abs(value) >= _MAX_INTEGER:
        yield ConfigFault((key,), f"{key}: must be below 2**53 in size, not {value}")


def read_options(
    given: Mapping[str, Any], kind: type[_S], *, table: str, device: str, hint: str
) -> _S:
    """The options of a driver as a struct.

    Parameters
    ----------
    given : the table as the configuration has it, ``config.trigger.options`` for example.
    kind : the type of the struct; a field without a default must be given.
    table : name of the table in the file, "trigger.options" for example.
    device : whose options they are: "display", "shutter" or "camera".
    hint : where the options are explained.

    Raises ConfigError with all faults, one a line.
    """
    fields = {f.encode_name: f for f in msgspec.structs.fields(kind)}
    values: dict[str, Any] = {}
    faults = []
    for key, value in given.items():
        if key not in fields:
            faults.append(describe_unknown_key(key, key, fields))
            continue
        try:
            values[fields[key].name] = _convert_field(value, fields[key], key)
        except ValueError as err:
            faults.append(str(err))
    faults += [
        f"{f.name}: must be given"
        for f in fields.values()
        if f.required and f.encode_name not in given
    ]
    if not faults:
        try:
            return kind(**values)
        except ValueError as err:  # from the struct's own check of several keys
            raise _wrong([str(err)], table, device, hint) from err
    raise _wrong(faults, table, device, hint)


def merge_camera_options(
    config: Config, drivers: Collection[str], start: Mapping[str, Any] = MappingProxyType({})
) -> tuple[dict[str, Any], str]:
    """The options of a camera that is both readout and shutter, and the name of their table, for
    `read_options`: it is enough to give them in [camera.options] or in [trigger.options].

    drivers : names of the drivers that have these options.
    start : values where nothing else is given.
    Raises ConfigError where the two tables contradict each other.
    """
    roles = (
        ("camera", config.camera.driver, config.camera.options),
        ("trigger", config.trigger.driver, config.trigger.options),
    )
    given = {role: options for role, driver, options in roles if driver in drivers}
    merged = dict(start)
    for name, options in given.items():
        for key, value in options.items():
            if merged.setdefault(key, value) != value:
                raise ConfigError(
                    f"[{name}.options]: {key} = {value!r} is not what [camera.options] says",
                    device="camera",
                    hint="trigger and camera are one device: give each option once",
                )
    return merged, " or ".join(f"{name}.options" for name in given) or "camera.options"


def _wrong(faults: list[str], table: str, device: str, hint: str) -> ConfigError:
    lines = "\n  ".join(f"[{table}] {fault}" for fault in faults)
    return ConfigError(lines, device=device, hint=hint)


def describe_unknown_key(name: str, key: str, known: Collection[str]) -> str:
    """A message that a table has no such key, with the one that is probably meant. `name` is its
    dotted name."""
    close = suggest_word(key, known)
    advice = f"; is {close} meant?" if close else f"; known are {', '.join(known)}"
    return f"{name}: no such key{advice}"


def _convert_field(value: Any, field: FieldInfo, name: str) -> Any:
    """The value of one key in the type of its field. Raises ValueError that begins with `name`."""
    try:
        return msgspec.convert(value, type=field.type, strict=True)
    except msgspec.ValidationError as err:
        fault = _type_fault(name, str(err), field.type)
        raise ValueError(fault + _suggest_value(field.name, value, str(err), field.type)) from err


def _type_fault(name: str, message: str, kind: Any) -> str:
    """A conversion error in the words of the file: the key first, no marks of type notation."""
    what, _, place = message.partition(" - at `$")
    if what.startswith("Invalid enum value"):
        values = re.findall(r"'([^']*)'", str(kind))
        number = ["a number"] if "float" in str(kind) else []
        what = f"{what}; allowed are {', '.join(values + number)}"
    what = what[0].lower() + what[1:].replace("`", "")
    return f"{name}{place.rstrip('`').replace('[...]', '')}: {what}"


def _suggest_value(key: str, value: Any, message: str, kind: Any) -> str:
    """What to write instead of a text where a number, a pair of numbers, or another word is
    needed."""
    if not isinstance(value, str):
        return ""
    wanted = message.partition(", got")[0]
    better: str | None = None
    if message.startswith("Invalid enum value"):
        word = suggest_word(value, re.findall(r"'([^']*)'", str(kind)))
        better = _string(word) if word else None
    elif "array" in wanted and (pair := suggest_pair(value)):
        better = f"[{', '.join(pair)}]"
    elif "int" in wanted or "float" in wanted:
        better = suggest_number(value, whole="float" not in wanted)
    return f"; write {key} = {better}" if better else ""


TOML_TIME_TYPES = (datetime.datetime, datetime.date, datetime.time)
"""The types that TOML has and JSON lacks."""


NO_NOTES: Mapping[tuple[str, ...], str] = MappingProxyType({})


def format_toml(table: Mapping[str, Any], notes: Mapping[tuple[str, ...], str] = NO_NOTES) -> str:
    """Return `table` as TOML 1.0 text that `tomllib.loads` reads back to the same value.

    notes : comments, each for the key or the table at a path.

    Values are those that TOML has: tables, arrays, strings, integers, floats, booleans, dates and
    times. A key whose value is None is left out, for TOML has no such value.
    """
    return "\n".join(_lines(table, (), notes)).strip() + "\n"


def _lines(
    table: Mapping[str, Any], path: tuple[str, ...], notes: Mapping[tuple[str, ...], str]
) -> Iterator[str]:
    """Yield the lines of one table: its own keys first, then its tables under their headers."""

    def noted(line: str, key: str) -> str:
        note = notes.get((*path, key))
        return line if note is None else f"{line}  # {to_one_line(note)}"

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
    return value.isoformat() if isinstance(value, TOML_TIME_TYPES) else repr(value)


def _string(text: str) -> str:
    """Quote as a basic string: JSON's escapes are TOML's, except for DEL, which JSON leaves raw."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
