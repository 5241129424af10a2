"""What a page says of a figure, as data/fig-N.json beside it holds it, and whether it still holds.

::

    index.html            the page; it says so itself while figures are still being made
    fig-1-*.png           pictures and plots
    data/fig-1.json       what the page says of a figure, with the fingerprint of its inputs
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pdcd.figures.figure import Mode, Number, Photo, Take
from pdcd.files.put import put_file
from pdcd.version import __version__


class Shown(msgspec.Struct, frozen=True):
    """One picture or plot of the page. file : beside the page."""

    file: str
    caption: str


class ShownRow(msgspec.Struct, frozen=True):
    """Pictures side by side."""

    title: str
    pictures: tuple[Shown, ...]
    small: bool = False


class Captured(msgspec.Struct, frozen=True, kw_only=True):
    """A capture in figures. Errors are shares of the truth's RMS; `held` is whether that is within
    its bound, where it has one."""

    name: str
    said: str
    goal: str
    scene: str
    codes: int | None
    family: str | None
    exposures: int | None
    exposure_s: float | None
    error: float | None
    bound: float | None
    held: bool

    @classmethod
    def of(cls, name: str, take: Take, photo: Photo) -> Captured:
        """What a capture gave."""
        told = photo.summary
        error = photo.error if photo.transport is None else _error_of_entries(photo)
        number = Number("", error, most=take.bound)
        return cls(
            name=name,
            said=take.said,
            goal=take.goal,
            scene=take.scene,
            codes=_whole(told.get("codes")) if told.get("family") != "none" else None,
            family=told.get("family"),
            exposures=_whole(told.get("shots")),
            exposure_s=told.get("exposure_s"),
            error=number.value,
            bound=take.bound,
            held=number.held or take.bound is None,
        )


class Made(msgspec.Struct, frozen=True, kw_only=True):
    """All that the page says of a figure."""

    number: str
    fingerprint: str
    mode: str
    title: str
    see: str
    paper: str
    unlike: str
    rows: tuple[ShownRow, ...]
    plots: tuple[Shown, ...]
    numbers: tuple[Number, ...]
    captures: tuple[Captured, ...]
    seconds: float
    """Wall time of its captures together, as their runs tell it."""

    @property
    def held(self) -> bool:
        """Whether every number lies within its bounds."""
        return all(n.held for n in self.numbers) and all(c.held for c in self.captures)

    @property
    def files(self) -> Iterator[str]:
        """Its pictures and plots."""
        for row in self.rows:
            yield from (picture.file for picture in row.pictures)
        yield from (plot.file for plot in self.plots)


def _error_of_entries(photo: Photo) -> float:
    """RMS error of photographed entries of T over the RMS of the true ones, where known."""
    if photo.transport is None or photo.transport_truth is None:
        return math.nan
    known = np.isfinite(photo.transport)
    off = np.sum((photo.transport - photo.transport_truth) ** 2, where=known)
    return float(np.sqrt(off / np.sum(photo.transport_truth**2, where=known)))


def _whole(value: Any) -> int | None:
    return int(value) if isinstance(value, int | float) else None


def fingerprint_of(mode: Mode, *, plots: bool) -> str:
    """SHA-256 of all that figures depend on: the mode, and every line of the program."""
    whole = hashlib.sha256(f"{__version__} {np.__version__} {mode} {plots}".encode())
    for name in ("pdcd", "drivers"):
        spec = find_spec(name)
        for place in (spec.submodule_search_locations or ()) if spec else ():
            for path in sorted(Path(place).rglob("*.py")):
                whole.update(hashlib.sha256(path.read_bytes()).digest())
    return whole.hexdigest()


def read_made(folder: Path, number: str, fingerprint: str) -> Made | None:
    """A figure as it was made of these inputs, if all of it is there; else None."""
    try:
        found = msgspec.json.decode(_path(folder, number).read_bytes(), type=Made)
    except (OSError, msgspec.DecodeError):
        return None
    whole = all((folder / file).is_file() for file in found.files)
    return found if whole and found.fingerprint == fingerprint else None


def write_made(folder: Path, made: Made) -> None:
    """Note that a figure is made; its pictures are there. Raises DiskError."""
    put_file(_path(folder, made.number), msgspec.json.format(msgspec.json.encode(made)))


def _path(folder: Path, number: str) -> Path:
    return folder / "data" / f"fig-{number}.json"
