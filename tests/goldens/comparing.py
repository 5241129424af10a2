"""What differs between two folders of goldens: field by field, array by array, byte by byte."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.goldens.case import SUMS
from tests.goldens.renamed import Renamed, read_renamed

WORDS = frozenset(
    "message hint advice reasons remarks warnings text said prior split limit title see unlike what "
    "description source label meaning".split()
)
"""Fields that hold sentences for people."""
PAGES = (".html", ".html.txt")
"""Files that hold sentences for people among numbers."""
MOST_LINES = 12
"""Differences of a file that are told one by one."""
WIDE = 70
"""Characters of a value that are shown."""


@dataclass(frozen=True)
class Difference:
    """One thing that differs. field : of the file, "" for the file itself."""

    case: str
    file: str
    field: str
    how: str


def compare(before: Path, after: Path, *, words: bool = True, renamed: Renamed | None = None) -> bool:
    """Print what differs; whether nothing does. words : whether sentences count."""
    renamed = renamed or read_renamed()
    found = [
        one for one in differences(before, after, renamed) if words or not _is_words(one)
    ]
    _tell(found)
    ending = f"{len(found)} differences" if found else "no difference"
    sys.stdout.write(f"{ending} in {len(_cases(before) | _cases(after))} cases\n")
    return not found


def differences(before: Path, after: Path, renamed: Renamed) -> Iterator[Difference]:
    """Everything that differs and is not listed as renamed."""
    for case in sorted(_cases(before) | _cases(after)):
        one, two = before / case, after / case
        if renamed.is_another(case):
            continue
        if not one.is_dir() or not two.is_dir():
            yield Difference(case, "", "", "is new" if two.is_dir() else "is missing")
            continue
        yield from _of_case(case, _files(one), _files(two), renamed)


def _cases(folder: Path) -> set[str]:
    """Names of cases: folders that hold a file of their own."""
    own = {path.parent for path in folder.rglob("*") if path.is_file()}
    top = {path for path in own if not any(other in path.parents for other in own)}
    return {path.relative_to(folder).as_posix() for path in top}


def _files(case: Path) -> dict[str, bytes]:
    paths = sorted(path for path in case.rglob("*") if path.is_file())
    return {path.relative_to(case).as_posix(): path.read_bytes() for path in paths}


def _of_case(
    case: str, before: dict[str, bytes], after: dict[str, bytes], renamed: Renamed
) -> Iterator[Difference]:
    for file, data in before.items():
        name = renamed.now(file, "")
        if name is None or after.get(file) == data:
            continue
        if file not in after:
            yield Difference(case, file, "", "is missing")
            continue
        for field, how in _of_file(file, data, after[file], renamed):
            yield Difference(case, file, field, how)
    for file in after:
        if file not in before and not renamed.is_new(file, ""):
            yield Difference(case, file, "", "is new")


def _of_file(
    file: str, before: bytes, after: bytes, renamed: Renamed
) -> Iterator[tuple[str, str]]:
    """Fields of a file that differ, and how."""
    if file.endswith(".json"):
        one, two = _fields(json.loads(before)), _fields(json.loads(after))
        yield from _of_fields(file, one, two, renamed, _unlike)
    elif file.endswith(".npz"):
        one, two = _arrays(before), _arrays(after)
        alike = True
        for told in _of_fields(file, one, two, renamed, _unlike_arrays):
            alike = False
            yield told
        if alike and list(one) == list(two):
            yield "", "arrays are equal, the bytes around them are not"
    elif file.endswith((".csv", ".txt", ".toml")):
        yield from _unlike_lines(before.decode(), after.decode())
    else:
        yield "", _unlike_bytes(before, after)


def _of_fields(
    file: str, before: dict[str, Any], after: dict[str, Any], renamed: Renamed, unlike: Any
) -> Iterator[tuple[str, str]]:
    met = set()
    for path, value in before.items():
        there = renamed.now("" if file == SUMS else file, path)
        if there is None:
            continue
        met.add(there)
        if there not in after:
            yield path, f"is missing, was {_short(value)}"
        elif how := unlike(value, after[there]):
            yield path, how
    for path, value in after.items():
        if path not in met and not renamed.is_new(file, path):
            yield path, f"is new: {_short(value)}"


def _fields(value: Any, at: str = "") -> dict[str, Any]:
    """Plain values by their paths; tables and lists without anything in them, too."""
    if isinstance(value, dict | list) and value:
        items = value.items() if isinstance(value, dict) else enumerate(value)
        found: dict[str, Any] = {}
        for key, held in items:
            found |= _fields(held, f"{at}.{key}" if at else str(key))
        return found
    return {at: value}


def _arrays(data: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(data), allow_pickle=False) as found:
        return {name: found[name] for name in found.files}


def _unlike(one: Any, two: Any) -> str:
    """How two plain values differ; "" where they do not. 1 and 1.0 do, and so do 0.0 and -0.0."""
    first, second = json.dumps(one), json.dumps(two)
    if first == second:
        return ""
    how = f"{_short(one)} -> {_short(two)}"
    if isinstance(one, float) and isinstance(two, float) and one:
        how += f" (by {abs(two - one) / abs(one):.1e} of it)"
    return how


def _unlike_arrays(one: np.ndarray, two: np.ndarray) -> str:
    if one.dtype != two.dtype or one.shape != two.shape:
        return f"{one.dtype}{list(one.shape)} -> {two.dtype}{list(two.shape)}"
    if one.tobytes() == two.tobytes():
        return ""
    if one.dtype.kind not in "fiub":
        return "other values"
    a, b = one.astype(np.float64), two.astype(np.float64)
    off = np.count_nonzero(~((a == b) | (np.isnan(a) & np.isnan(b))))
    if not off:
        return "equal, but for the bytes of -0.0 or NaN"
    with np.errstate(all="ignore"):
        far = float(np.nanmax(np.abs(np.where(a == b, 0.0, a - b))))
        scale = float(np.sqrt(np.nanmean(np.where(np.isfinite(a), a, np.nan) ** 2)))
    share = f", {far / scale:.1e} of its RMS" if scale else ""
    return f"{off} of {a.size} values, by up to {far:.3g}{share}"


def _unlike_lines(one: str, two: str) -> Iterator[tuple[str, str]]:
    first, second = one.splitlines(), two.splitlines()
    if len(first) != len(second):
        yield "", f"{len(first)} lines -> {len(second)}"
    for number, (a, b) in enumerate(zip(first, second, strict=False), 1):
        if a != b:
            at = next((k for k, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), len(a))
            begin = max(at - 20, 0)
            yield f"line {number}", f"{_short(a[begin:])} -> {_short(b[begin:])}"
    if first == second:
        yield "", "ends of lines"


def _unlike_bytes(one: bytes, two: bytes) -> str:
    if len(one) != len(two):
        return f"{len(one)} bytes -> {len(two)}"
    off = np.flatnonzero(np.frombuffer(one, np.uint8) != np.frombuffer(two, np.uint8))
    return f"{off.size} of {len(one)} bytes, the first at {off[0]}"


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{list(value.shape)}"
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= WIDE else text[:WIDE] + "..."


def _is_words(one: Difference) -> bool:
    """Whether it is in a sentence for people."""
    if one.file.endswith(PAGES) or (one.file == SUMS and one.field.endswith(PAGES)):
        return True
    return one.file.endswith(".json") and bool(WORDS & set(one.field.split(".")))


def _tell(found: list[Difference]) -> None:
    """Print them, case by case and file by file."""
    groups: dict[tuple[str, str], list[Difference]] = {}
    for one in found:
        groups.setdefault((one.case, one.file), []).append(one)
    case = ""
    for (name, file), some in groups.items():
        if name != case:
            case = name
            sys.stdout.write(f"{case}\n")
        for one in some[:MOST_LINES]:
            where = " ".join(filter(None, (file, one.field)))
            sys.stdout.write(f"    {where}: {one.how}\n")
        if len(some) > MOST_LINES:
            sys.stdout.write(f"    {file}: and {len(some) - MOST_LINES} more\n")
