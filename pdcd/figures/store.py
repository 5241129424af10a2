"""The folder of a page: what is in it already, and how files get there whole or not at all.

::

    index.html            the page; it says so itself while figures are still being made
    fig-1-*.png           pictures and plots
    data/fig-1.json       what the page says of a figure, with the fingerprint of its inputs
    data/photos/*.npz     photos of figures that are not made yet; gone when they are
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path

import msgspec
import numpy as np

from pdcd.errors import disk_errors
from pdcd.figures.figure import Figure, Mode, Photo, Take
from pdcd.figures.photo import unpacked
from pdcd.files.put import put_file
from pdcd.version import __version__

PAGE, DATA, PHOTOS = "index.html", "data", "photos"


class Shown(msgspec.Struct, frozen=True):
    """One picture or plot of the page. file : beside the page."""

    file: str
    caption: str
    wide: bool = False


class ShownRow(msgspec.Struct, frozen=True):
    """Pictures side by side."""

    title: str
    pictures: tuple[Shown, ...]
    small: bool = False


class Stated(msgspec.Struct, frozen=True):
    """A number with its bounds, and whether it lies within them."""

    what: str
    value: float | None
    least: float | None
    most: float | None
    paper: str
    percent: bool
    held: bool


class Captured(msgspec.Struct, frozen=True):
    """A capture in figures. Errors are shares of the truth's RMS."""

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


class Made(msgspec.Struct, frozen=True, kw_only=True):
    """All that the page says of a figure, as data/fig-N.json holds it."""

    number: str
    fingerprint: str
    mode: str
    title: str
    see: str
    paper: str
    unlike: str
    rows: tuple[ShownRow, ...]
    plots: tuple[Shown, ...]
    numbers: tuple[Stated, ...]
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


class Store:
    """One folder of figures."""

    def __init__(self, folder: Path, mode: Mode, *, plots: bool = True) -> None:
        """plots : whether plots are drawn. Raises PdcdError where the folder cannot be made."""
        self.folder, self._mode = folder, mode
        self._program = program_digest()
        self._plots = plots
        self._prints: dict[Figure, str] = {}
        with disk_errors(str(folder)):
            (folder / DATA / PHOTOS).mkdir(parents=True, exist_ok=True)

    def made(self, figure: Figure) -> Made | None:
        """The figure as it was made of the same inputs, by this program, if all of it is there."""
        try:
            found = msgspec.json.decode(self._record(figure.number).read_bytes(), type=Made)
        except (OSError, msgspec.DecodeError):
            return None
        whole = all((self.folder / file).is_file() for file in found.files)
        return found if whole and found.fingerprint == self.fingerprint(figure) else None

    def fingerprint(self, figure: Figure) -> str:
        """Of all that a figure depends on: its captures, the mode, every line of the program."""
        if figure not in self._prints:
            takes = {name: told(take) for name, take in figure.takes(self._mode).items()}
            inputs = [self._program, asdict(self._mode), takes, self._plots]
            self._prints[figure] = digest(inputs)
        return self._prints[figure]

    def put(self, made: Made) -> None:
        """Note that a figure is made; its pictures are there."""
        self.write(f"{DATA}/fig-{made.number}.json", msgspec.json.format(msgspec.json.encode(made)))

    def write(self, name: str, data: bytes) -> None:
        """Write a file whole, or not at all."""
        put_file(self.folder / name, data)

    def photo_name(self, take: Take) -> str:
        """Name of the file of a capture's photo. Looks at every number of its arrays."""
        return f"{DATA}/{PHOTOS}/{digest([self._program, asdict(self._mode), told(take)])[:24]}.npz"

    def photo(self, name: str) -> Photo | None:
        """The photo of that name, if it was taken."""
        try:
            return unpacked(self.folder / name)
        except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile):
            return None

    def has(self, name: str) -> bool:
        """Whether there is a photo of that name; files are whole or not there."""
        return (self.folder / name).is_file()

    def forget(self, names: Iterable[str]) -> None:
        """Remove photos."""
        with disk_errors(str(self.folder)):
            for name in names:
                (self.folder / name).unlink(missing_ok=True)

    def _record(self, number: str) -> Path:
        return self.folder / DATA / f"fig-{number}.json"


def told(take: Take) -> object:
    """A capture in plain values, arrays by their digests."""
    asked = {
        key: hashlib.sha256(np.ascontiguousarray(v, np.float64).tobytes()).hexdigest()
        if isinstance(v, np.ndarray)
        else v
        for key, v in take.asked.items()
    }
    fields = {k: v for k, v in vars(take).items() if k not in ("asked", "options")}
    return {**fields, "asked": asked, "options": dict(take.options)}


def digest(value: object) -> str:
    """SHA-256 of plain values."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def program_digest() -> str:
    """SHA-256 of every line of the program: what it would make differently is made again."""
    whole = hashlib.sha256(f"{__version__} {np.__version__}".encode())
    for name in ("pdcd", "drivers"):
        spec = find_spec(name)
        for place in (spec.submodule_search_locations or ()) if spec else ():
            for path in sorted(Path(place).rglob("*.py")):
                whole.update(hashlib.sha256(path.read_bytes()).digest())
    return whole.hexdigest()
