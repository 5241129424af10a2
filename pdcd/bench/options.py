"""Tables as written -> typed values, each fault said in the words of the file, its key first.

The configuration file is read by these rules, and so is the `options` table of every driver.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Mapping
from typing import Any, TypeVar

import msgspec
from msgspec.structs import FieldInfo

from pdcd.errors import ConfigError

_S = TypeVar("_S", bound=msgspec.Struct)


def read_options(
    given: Mapping[str, Any], kind: type[_S], *, table: str, device: str, hint: str
) -> _S:
    """The options of a driver as its own struct.

    Parameters
    ----------
    given : the table as the configuration has it, ``config.trigger.options`` for example.
    kind : what it must hold; a field without a default must be given.
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
            faults.append(unknown_key(key, key, fields))
            continue
        try:
            values[fields[key].name] = convert_field(value, fields[key], key)
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
        except ValueError as err:  # of the struct's own check, which is about several keys
            raise _wrong([str(err)], table, device, hint) from err
    raise _wrong(faults, table, device, hint)


def _wrong(faults: list[str], table: str, device: str, hint: str) -> ConfigError:
    lines = "\n  ".join(f"[{table}] {fault}" for fault in faults)
    return ConfigError(lines, device=device, hint=hint)


def unknown_key(name: str, key: str, known: Collection[str]) -> str:
    """Say that a table has no such key, and which is probably meant. `name` is its dotted name."""
    close = difflib.get_close_matches(key, known, n=1)
    advice = f"; is {close[0]} meant?" if close else f"; known are {', '.join(known)}"
    return f"{name}: no such key{advice}"


def convert_field(value: Any, field: FieldInfo, name: str) -> Any:
    """The value of one key in the type of its field. Raises ValueError that begins with `name`."""
    try:
        return msgspec.convert(value, type=field.type, strict=True)
    except msgspec.ValidationError as err:
        raise ValueError(_type_fault(name, str(err), field.type)) from err


def _type_fault(name: str, message: str, kind: Any) -> str:
    """Say a conversion error in the words of the file: the key first, no type notation marks."""
    what, _, place = message.partition(" - at `$")
    if what.startswith("Invalid enum value"):
        values = re.findall(r"'([^']*)'", str(kind))
        number = ["a number"] if "float" in str(kind) else []
        what = f"{what}; allowed are {', '.join(values + number)}"
    what = what[0].lower() + what[1:].replace("`", "")
    return f"{name}{place.rstrip('`').replace('[...]', '')}: {what}"
