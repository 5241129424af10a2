"""What differs between two folders of goldens: field by field, array by array, byte by byte."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tests.goldens.case import SUMS
from tests.goldens.renamed import Renamed, read_renamed

Kept = TypeVar("Kept", bytes, str)
"""A file as it was kept, or its digest."""

WORDS = frozenset(
    "message hint advice reasons remarks warnings text prior split limit title see unlike what"
    " description label meaning paper caption keeps cause stage detail".split()
)
"""Fields whose texts are sentences for people."""
PAGES = (".html", ".html.txt")
"""Files that hold sentences for people among numbers."""
MOST_LINES = 12
"""Differences of a file that are told one by one."""
WIDE = 70
"""Characters of a value that are shown."""


@dataclass(frozen=True)
class Difference:
    """One thing that differs. field : of the file, "" for the file itself. words : whether it is
    in a sentence for people."""

    case: str
    file: str
    field: str
    how: str
    words: bool = False


def compare(
    before: Path, after: Path, *, words: bool = True, renamed: Renamed | None = None
) -> bool:
    """Print what differs; whether nothing does. words : whether sentences count."""
    wanted = read_renamed() if renamed is None else renamed
    found = [one for one in differences(before, after, wanted) if words or not one.words]
    _tell(found)
    count = len(_cases(before) | _cases(after))
    sys.stdout.write(f"{len(found) or 'no'} differences in {count} cases\n")
    return not found and count > 0


def differences(before: Path, after: Path, renamed: Renamed) -> Iterator[Difference]:
    """Everything that differs and is not listed as renamed."""
    ours, theirs = _cases(before), _cases(after)
    for case in sorted(ours | theirs):
        if renamed.is_another(case):
            continue
        if case not in ours or case not in theirs:
            yield Difference(case, "", "", "is new" if case in theirs else "is missing")
            continue
        yield from _of_case(case, _files(before / case), _files(after / case), renamed)


def _cases(folder: Path) -> set[str]:
    """Names of cases: the uppermost folders that hold a file of their own."""
    own = {path.parent for path in folder.rglob("*") if path.is_file()}
    top = {path for path in own if not own.intersection(path.parents)}
    return {path.relative_to(folder).as_posix() for path in top}


def _files(case: Path) -> dict[str, bytes]:
    paths = sorted(path for path in case.rglob("*") if path.is_file())
    return {path.relative_to(case).as_posix(): path.read_bytes() for path in paths}


def _of_case(
    case: str, before: Mapping[str, bytes], after: Mapping[str, bytes], renamed: Renamed
) -> Iterator[Difference]:
    def unlike(file: str, old: bytes, new: bytes) -> Iterator[Difference]:
        return _of_file(case, file, old, new, renamed)

    return _of_files(case, before, after, renamed, unlike)


def _of_files(
    case: str,
    before: Mapping[str, Kept],
    after: Mapping[str, Kept],
    renamed: Renamed,
    unlike: Callable[[str, Kept, Kept], Iterator[Difference]],
) -> Iterator[Difference]:
    """What differs between files by their names; `unlike` tells how two of one name do."""
    met = set()
    for file, kept in before.items():
        name = renamed.file_now(file)
        if name is None:
            continue
        met.add(name)
        if name not in after:
            yield Difference(case, file, "", "is missing")
        elif after[name] != kept:
            yield from unlike(file, kept, after[name])
    for file in after:
        if file not in met and not renamed.is_new(file, ""):
            yield Difference(case, file, "", "is new")


def _of_file(
    case: str, file: str, before: bytes, after: bytes, renamed: Renamed
) -> Iterator[Difference]:
    """What differs in a file."""
    if file == SUMS:
        yield from _of_sums(case, json.loads(before), json.loads(after), renamed)
    elif file.endswith(".json"):
        one, two = _fields(json.loads(before)), _fields(json.loads(after))
        yield from _of_fields(case, file, one, two, renamed, _unlike)
    elif file.endswith(".npz"):
        one, two = _arrays(before), _arrays(after)
        found = list(_of_fields(case, file, one, two, renamed, _unlike_arrays))
        yield from found
        if not found and list(one) == list(two):
            yield Difference(case, file, "", "arrays are equal, the bytes around them are not")
    elif file.endswith((".csv", ".txt", ".toml")):
        for field, how in _unlike_lines(before.decode(), after.decode()):
            yield Difference(case, file, field, how, file.endswith(PAGES))
    else:
        yield Difference(case, file, "", _unlike_bytes(before, after))


def _of_sums(
    case: str, before: Mapping[str, str], after: Mapping[str, str], renamed: Renamed
) -> Iterator[Difference]:
    """Files of which there are digests only."""

    def unlike(file: str, old: str, new: str) -> Iterator[Difference]:
        yield Difference(case, file, "", "has another digest", file.endswith(PAGES))

    return _of_files(case, before, after, renamed, unlike)


def _of_fields(
    case: str,
    file: str,
    before: Mapping[str, Any],
    after: Mapping[str, Any],
    renamed: Renamed,
    unlike: Callable[[Any, Any], str],
) -> Iterator[Difference]:
    met = set()
    for path, value in before.items():
        there = renamed.field_now(file, path)
        if there is None:
            continue
        met.add(there)
        if there not in after:
            how = f"is missing, was {_short(value)}"
            yield Difference(case, file, path, how, _is_words(path, value))
        elif how := unlike(value, after[there]):
            words = _is_words(path, value, after[there])
            yield Difference(case, file, path, how, words)
    for path, value in after.items():
        if path not in met and not renamed.is_new(file, path):
            how = f"is new: {_short(value)}"
            yield Difference(case, file, path, how, _is_words(path, value))


def _is_words(path: str, *values: Any) -> bool:
    """Whether these are sentences for people."""
    return bool(WORDS.intersection(path.split("."))) and all(isinstance(v, str) for v in values)


def _fields(value: Any, at: str = "") -> dict[str, Any]:
    """Plain values by their paths; tables and lists without anything in them, too."""
    if isinstance(value, dict | list) and value:
        items = value.items() if isinstance(value, dict) else enumerate(value)
        found: dict[str, Any] = {}
        for key, held in items:
            found |= _fields(held, f"{at}.{key}" if at else str(key))
        return found
    return {at: value}


def _arrays(data: bytes) -> dict[str, NDArray[Any]]:
    with np.load(io.BytesIO(data), allow_pickle=False) as found:
        return {name: found[name] for name in found.files}


def _unlike(one: Any, two: Any) -> str:
    """How two plain values differ; "" where they do not. 1 and 1.0 do, and so do 0.0 and -0.0."""
    if json.dumps(one) == json.dumps(two):
        return ""
    how = f"{_short(one)} -> {_short(two)}"
    if isinstance(one, float) and isinstance(two, float) and one:
        how += f" (by {abs(two - one) / abs(one):.1e} of it)"
    return how


def _unlike_arrays(one: NDArray[Any], two: NDArray[Any]) -> str:
    if one.dtype != two.dtype or one.shape != two.shape:
        return f"{_short(one)} -> {_short(two)}"
    if one.tobytes() == two.tobytes():
        return ""
    if one.dtype.kind not in "fiub":
        return "other values"
    a, b = one.astype(np.float64), two.astype(np.float64)
    off = np.count_nonzero(~((a == b) | (np.isnan(a) & np.isnan(b))))
    if not off:
        return "equal, but for the bytes of -0.0 or NaN"
    known = np.isfinite(a) & np.isfinite(b)
    far = float(np.abs(a - b)[known].max(initial=0.0))
    scale = float(np.sqrt(np.mean(a[known] ** 2))) if known.any() else 0.0
    share = f", {far / scale:.1e} of its RMS" if scale else ""
    return f"{off} of {a.size} values, by up to {far:.3g}{share}"


def _unlike_lines(one: str, two: str) -> Iterator[tuple[str, str]]:
    first, second = one.splitlines(), two.splitlines()
    if len(first) != len(second):
        yield "", f"{len(first)} lines -> {len(second)}"
    for number, (a, b) in enumerate(zip(first, second, strict=False), 1):
        if a != b:
            at = next((k for k, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), 0)
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
