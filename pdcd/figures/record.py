"""The record of a figure for the page, data/fig-N.json, and whether it is still valid.

::

    index.html            the page; it says so itself while figures are still being made
    fig-1-*.png           pictures and plots
    data/fig-1.json       what the page says of a figure, with the fingerprint of its inputs

A record has the texts of its `PaperFigure`, and

    fingerprint, mode     of its inputs
    rows                  title, small, and pictures: file and caption of each
    plots                 file and caption of each
    numbers               the fields of each `BoundedNumber`
    captures              `capture_told` of each
    seconds               wall time of its captures together, from their runs
    held                  whether every number and error lies within its bounds
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pdcd.figures.figure import (
    BoundedNumber,
    FigureMode,
    FigurePhoto,
    FigureTake,
    PaperFigure,
    Photos,
)
from pdcd.files.opening import UnsoundFileError
from pdcd.files.put import replace_file
from pdcd.files.reading import hash_file, read_file
from pdcd.files.text import encode_json
from pdcd.version import __version__

PaperFigureRecord = dict[str, Any]


def record_of(
    figure: PaperFigure,
    takes: Mapping[str, FigureTake],
    photos: Photos,
    numbers: list[BoundedNumber],
    mode: FigureMode,
    **more: Any,
) -> PaperFigureRecord:
    """The record of a figure made in a mode; more : its other fields."""
    captures = [capture_told(name, takes[name], photos[name]) for name in takes]
    texts = ("number", "title", "see", "paper", "unlike")
    return {
        **{name: getattr(figure, name) for name in texts},
        "mode": mode.name,
        **more,
        "numbers": msgspec.to_builtins(numbers),
        "captures": captures,
        "seconds": sum(float(photo.summary.get("wall_s") or 0.0) for photo in photos.values()),
        "held": all(n.held for n in numbers) and all(c["held"] for c in captures),
    }


def capture_told(name: str, take: FigureTake, photo: FigurePhoto) -> dict[str, Any]:
    """The figures of a capture. `error` is a share of the truth's RMS, over entries of T if these
    were photographed; `held` is whether it is within its `bound`, if it has one."""
    told, bound = photo.summary, take.bound
    number = BoundedNumber("", _error(photo), most=bound)
    return {
        "name": name,
        "said": take.said,
        "goal": take.goal,
        "scene": take.scene,
        "codes": _whole(told.get("codes")) if told.get("family") != "none" else None,
        "family": told.get("family"),
        "exposures": _whole(told.get("shots")),
        "exposure_s": told.get("exposure_s"),
        "error": number.value,
        "bound": bound,
        "held": number.held or bound is None,
    }


def _error(photo: FigurePhoto) -> float:
    if photo.transport is None:
        return photo.error
    if photo.transport_truth is None:
        return math.nan
    known = np.isfinite(photo.transport)
    off = np.sum((photo.transport - photo.transport_truth) ** 2, where=known)
    return float(np.sqrt(off / np.sum(photo.transport_truth**2, where=known)))


def _whole(value: Any) -> int | None:
    return int(value) if isinstance(value, int | float) else None


_MAX_BYTES = 2**24
"""Longest record that is read."""


def fingerprint_of(mode: FigureMode, *, plots: bool) -> str:
    """SHA-256 of everything that figures depend on: the mode, and every line of the program."""
    whole = hashlib.sha256(f"{__version__} {np.__version__} {mode} {plots}".encode())
    for name in ("pdcd", "drivers"):
        spec = find_spec(name)
        for place in (spec.submodule_search_locations or ()) if spec else ():
            for path in sorted(Path(place).rglob("*.py")):
                whole.update(bytes.fromhex(hash_file(path, _MAX_BYTES)))
    return whole.hexdigest()


def read_record(folder: Path, number: str, fingerprint: str) -> PaperFigureRecord | None:
    """The record of a figure made from these inputs, if all its files are there; else None."""
    try:
        found = msgspec.json.decode(
            read_file(_path(folder, number), _MAX_BYTES), type=PaperFigureRecord
        )
        files = [one["file"] for one in found["plots"]]
        files += [one["file"] for row in found["rows"] for one in row["pictures"]]
    except (UnsoundFileError, msgspec.DecodeError, KeyError, TypeError):
        return None
    whole = all((folder / file).is_file() for file in files)
    return found if whole and found.get("fingerprint") == fingerprint else None


def write_record(folder: Path, record: PaperFigureRecord) -> None:
    """Write the record of a figure, after its pictures. Raises DiskError."""
    replace_file(_path(folder, record["number"]), msgspec.json.format(encode_json(record)))


def _path(folder: Path, number: str) -> Path:
    return folder / "data" / f"fig-{number}.json"
