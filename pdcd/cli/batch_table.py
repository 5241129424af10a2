"""The table of a batch: TOML with a table for each photo, or CSV with a line for each.

It holds keywords of a request; all faults of the file are reported at once.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pdcd.api.arguments import make_request
from pdcd.bench.reading import make_faults_error, read_toml
from pdcd.cli.typed import parse_share
from pdcd.errors import ConfigError, PdcdError
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import read_file
from pdcd.meant import suggest_word
from pdcd.protocol.fields import Field, list_request_fields

_MAX_BYTES = 2**20
"""Longest file that is read."""
_HINT = "give a .toml file with a [[photo]] for each, or a .csv file with a line for each"
_FLAGS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}

_Photo = dict[str, Any]


def read_batch_table(source: Path) -> list[_Photo]:
    """The photos of a file, each as keywords with its "goal". Paths are relative to its folder.

    Raises ConfigError naming all faults, one a line.
    """
    if source.suffix == ".csv":
        found = list(_read_csv(source))
    else:
        found = _read_tables(source)
    if not found:
        raise ConfigError(f"{source} lists no photo", hint=_HINT)
    faults: list[str] = []
    photos = [_check(photo, source, f"photo {n + 1}", faults) for n, photo in enumerate(found)]
    if faults:
        raise make_faults_error(source, faults)
    return photos


def _read_tables(source: Path) -> list[_Photo]:
    """Photos of a TOML file: [[photo]] tables, which override values in [all]."""
    tables = read_toml(source, "the table", _HINT, form=_HINT)
    shared, listed = tables.pop("all", {}), tables.pop("photo", [])
    if tables or not isinstance(shared, dict) or not isinstance(listed, list):
        named = ", ".join(tables) or "all" * (not isinstance(shared, dict)) or "photo"
        raise ConfigError(
            f"{source}: {named} is not a table of a batch",
            hint="write [all] for what all photos share, and [[photo]] for each",
        )
    if not all(isinstance(photo, dict) for photo in listed):
        raise ConfigError(f"{source}: a photo is not a table", hint="write [[photo]] for each")
    return [{**shared, **photo} for photo in listed]


def _read_csv(source: Path) -> Iterator[_Photo]:
    """Photos of a CSV file: a line of names, then a line for each; empty cells are left out."""
    try:
        text = read_file(source, _MAX_BYTES).decode("utf-8-sig")
        lines = list(csv.reader(io.StringIO(text), strict=True))
    except UnsoundFileError as err:
        raise ConfigError(f"cannot read the table {source}: {err.why}", hint=_HINT) from err
    except (UnicodeDecodeError, csv.Error) as err:
        raise ConfigError(
            f"{source} is not CSV: {err}", hint="save it as UTF-8, with commas"
        ) from err
    heads, *rows = [[cell.strip() for cell in line] for line in lines if any(line)] or [[]]
    fields, faults = list_request_fields(), list[str]()
    photos = []
    for number, cells in enumerate(rows):
        photo: _Photo = {}
        if len(cells) > len(heads):
            faults.append(f"photo {number + 1}: {len(cells)} values for {len(heads)} names")
        for name, cell in zip(heads, cells, strict=False):
            if cell:
                photo[name] = _convert(cell, fields[name]) if name in fields else cell
        photos.append(photo)
    if faults:
        raise make_faults_error(source, faults)
    yield from photos


def _convert(text: str, field: Field) -> Any:
    """A cell in the type of its field; as text if that fails, which is then refused later."""
    read = int if field.whole else parse_share if field.share else float
    try:
        if field.kind == "number":
            return text if text in field.words else read(text)
        if field.kind == "numbers":
            found = [read(part) for part in text.replace(";", " ").split()]
            return found * 2 if field.about.one_is_both and len(found) == 1 else found
    except ValueError:
        return text
    if field.kind == "words":
        return text.replace(";", " ").split()
    if "true" in field.takes:
        return _FLAGS.get(text.lower(), text)
    return text


def _check(photo: _Photo, source: Path, called: str, faults: list[str]) -> _Photo:
    """The keywords of a photo, with paths relative to the file's folder; faults go to `faults`."""
    fields = list_request_fields()
    found = dict(photo)
    for name, value in photo.items():
        if name in fields and isinstance(value, str) and fields[name].is_file(value):
            found[name] = source.absolute().parent / value
    if "goal" not in found:
        near = suggest_word("goal", (name for name in found if name not in fields))
        said = f"{near}: no such keyword; is goal meant?" if near else "goal: must be given"
        faults.append(f"{called}: {said}" + ", such as indirect" * (not near))
        return found
    asked: Mapping[str, Any] = {n: v for n, v in found.items() if n not in ("goal", "config")}
    try:
        make_request(str(found["goal"]), asked, lambda: (1, 1))
    except PdcdError as err:
        faults += [f"{called}: {line}" for line in err.message.splitlines()]
    return found
