"""Ways to spoil a finished run, each of which must be noticed: for tests, and for long trials.

`flips` changes one bit of any file. `TAMPERINGS` are what happens to files and what a clumsy
forger does. `FORGERIES` are manifests that cannot be true, with a digest that fits them; `HIDDEN`
are those that nobody can notice who does not know the manifest's digest from elsewhere.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

MANIFEST, DIGEST = "capture.json", "capture.json.sha256"

Told = dict[str, Any]
"""A manifest as JSON has it."""


@dataclass(frozen=True)
class Tampering:
    """One way to spoil a run folder, by its name."""

    name: str
    spoil: Callable[[Path], object]

    def __str__(self) -> str:
        return self.name


def files(folder: Path) -> list[Path]:
    """All files of a run, in order; read-only ones are made writable."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    for path in found:
        path.chmod(0o640)
    return found


def flip(path: Path, bit: int) -> None:
    """Change one bit of a file, counted from its beginning; a second time changes it back."""
    data = bytearray(path.read_bytes())
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)


def flips(folder: Path, count: int, seed: int) -> Iterator[tuple[Path, int]]:
    """File and bit of random changes: every file at least once, the others by chance."""
    rng = np.random.default_rng(seed)
    found = [path for path in files(folder) if path.stat().st_size]
    chosen = [*range(len(found)), *rng.integers(len(found), size=max(count - len(found), 0))]
    for number in chosen[:count]:
        yield found[number], int(rng.integers(found[number].stat().st_size * 8))


def sealed(folder: Path) -> None:
    """Write the digest that the manifest now has, as a forger would."""
    data = (folder / MANIFEST).read_bytes()
    (folder / DIGEST).write_text(f"{sha256(data).hexdigest()}  {MANIFEST}\n")


def forged(folder: Path, change: Callable[[Told], object]) -> None:
    """Change what the manifest says, and its digest with it."""
    path = folder / MANIFEST
    told = json.loads(path.read_bytes())
    change(told)
    path.write_text(json.dumps(told, indent=1))
    sealed(folder)


def relisted(folder: Path) -> None:
    """Let the manifest list the files as they are now, and seal it: a forgery without a flaw."""

    def relist(told: Told) -> None:
        for name in told["files"]:
            data = (folder / name).read_bytes()
            told["files"][name] = {"sha256": sha256(data).hexdigest(), "size_bytes": len(data)}

    forged(folder, relist)


def _cut(name: str, left: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        path = folder / name
        path.chmod(0o640)
        path.write_bytes(left(path.read_bytes()))

    return spoil


def _doubled(name: str) -> Callable[[Path], None]:
    """A second member of one name: some readers take the first, some the last."""

    def spoil(folder: Path) -> None:
        with zipfile.ZipFile(folder / name, "a") as packed:
            member = packed.namelist()[0]
            data = packed.read(member)
            packed.fp.seek(0, os.SEEK_END)  # type: ignore[union-attr]
            packed.NameToInfo.clear()  # so that it does not warn
            packed.writestr(member, data)

    return spoil


def _swapped(one: str, two: str) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        aside = folder / "aside"
        (folder / one).rename(aside)
        (folder / two).rename(folder / one)
        aside.rename(folder / two)

    return spoil


def _linked(name: str) -> Callable[[Path], None]:
    """An identical copy elsewhere, and a link to it in place of the file."""

    def spoil(folder: Path) -> None:
        elsewhere = folder.with_name(f"{folder.name}-elsewhere")
        (folder / name).rename(elsewhere)
        (folder / name).symlink_to(elsewhere)

    return spoil


def _socket(folder: Path) -> None:
    (folder / "log.jsonl").unlink()
    here = Path.cwd()
    os.chdir(folder)  # the path of a socket is short
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind("log.jsonl")
    finally:
        os.chdir(here)


def _replaced(name: str, make: Callable[[Path], object]) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        (folder / name).unlink()
        make(folder / name)

    return spoil


def _written(data: bytes) -> Callable[[Path], object]:
    """Any bytes for a manifest, with the digest that fits them."""

    def spoil(folder: Path) -> None:
        (folder / MANIFEST).write_bytes(data)
        sealed(folder)

    return spoil


def _text(change: Callable[[str], str]) -> Callable[[Path], object]:
    def spoil(folder: Path) -> None:
        _written(change((folder / MANIFEST).read_text()).encode("utf-8", "surrogatepass"))(folder)

    return spoil


def _says(change: Callable[[Told], object]) -> Callable[[Path], object]:
    return lambda folder: forged(folder, change)


def _unsealed(change: Callable[[Told], object]) -> Callable[[Path], object]:
    """The same by one who forgets the digest."""

    def spoil(folder: Path) -> None:
        kept = (folder / DIGEST).read_bytes()
        forged(folder, change)
        (folder / DIGEST).write_bytes(kept)

    return spoil


def _renames(new: str) -> Callable[[Told], object]:
    def change(told: Told) -> None:
        told["files"][new] = told["files"].pop("log.jsonl")

    return change


def _huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**30)


def _of(table: str, **values: Any) -> Callable[[Told], object]:
    """Sets fields of the run, or of its first shot."""

    def change(told: Told) -> None:
        run = told["run"]
        (run if table == "run" else run["shots"][0]).update(values)

    return change


def _literal(field: str, number: str) -> Callable[[Path], object]:
    """A field of the first shot as JSON has it, whatever Python makes of it."""

    def spoil(folder: Path) -> None:
        forged(folder, _of("shot", **{field: "here"}))
        _text(lambda text: text.replace('"here"', number))(folder)

    return spoil


_LAST = "linear/indirect.tif"

TAMPERINGS = tuple(
    Tampering(name, spoil)
    for name, spoil in {
        "a RAW file cut short": _cut("raw/coded.dng", lambda data: data[:-1]),
        "an empty RAW file": _cut("raw/coded.dng", lambda data: b""),
        "an empty manifest": _cut(MANIFEST, lambda data: b""),
        "a manifest cut short": _cut(MANIFEST, lambda data: data[:-2]),
        "a digest cut short": _cut(DIGEST, lambda data: data[:-1]),
        "an empty digest": _cut(DIGEST, lambda data: b""),
        "bytes behind a picture": _cut(_LAST, lambda data: data + b"\0"),
        "a space behind the manifest": _cut(MANIFEST, lambda data: data + b" "),
        "a line break in the manifest": _cut(MANIFEST, lambda data: data.replace(b"\n", b"\r\n")),
        "bytes behind the digest": _cut(DIGEST, lambda data: data + data),
        "a digest in capitals": _cut(DIGEST, bytes.upper),
        "a line more in log.jsonl": _cut("log.jsonl", lambda data: data + b'{"event": "done"}\n'),
        "a refresh less in frames.csv": _cut(
            "frames.csv", lambda data: data[: data.rindex(b"\n", 0, -1)]
        ),
        "a doubled member of probe.npz": _doubled("probe.npz"),
        "a doubled member of codes.npz": _doubled("codes.npz"),
        "two RAW files swapped": _swapped("raw/coded.dng", "raw/white.dng"),
        "two pictures swapped": _swapped("preview/direct.png", "preview/indirect.png"),
        "manifest and digest swapped": _swapped(MANIFEST, DIGEST),
        "a link to a copy of a RAW file": _linked("raw/coded.dng"),
        "a link to a copy of the manifest": _linked(MANIFEST),
        "a link to a copy of the digest": _linked(DIGEST),
        "a link to a copy of a folder": _linked("raw"),
        "a pipe for a RAW file": _replaced("raw/coded.dng", os.mkfifo),
        "a pipe for the manifest": _replaced(MANIFEST, os.mkfifo),
        "a pipe for the digest": _replaced(DIGEST, os.mkfifo),
        "a folder for a picture": _replaced(_LAST, Path.mkdir),
        "a folder for the manifest": _replaced(MANIFEST, Path.mkdir),
        "a socket for the log": _socket,
        "a link to nothing": _replaced("log.jsonl", lambda path: path.symlink_to("nowhere")),
        "a link to a device": _replaced("probe.npz", lambda path: path.symlink_to("/dev/zero")),
        "a link in a circle": _replaced("probe.npz", lambda path: path.symlink_to("probe.npz")),
        "a lost RAW file": lambda folder: (folder / "raw/coded.dng").unlink(),
        "a lost test exposure": lambda folder: (folder / "raw/meter-white-1.dng").unlink(),
        "a lost manifest": lambda folder: (folder / MANIFEST).unlink(),
        "a lost digest": lambda folder: (folder / DIGEST).unlink(),
        "a lost folder": lambda folder: shutil.rmtree(folder / "preview"),
        "a file too many": lambda folder: (folder / "raw/other.dng").write_bytes(b"x"),
        "an empty file too many": lambda folder: (folder / "notes").touch(),
        "a hidden file too many": lambda folder: (folder / ".hidden").touch(),
        "a folder too many": lambda folder: (folder / "more").mkdir(),
        "a pipe too many": lambda folder: os.mkfifo(folder / "pipe"),
        "a file of another case": lambda folder: (folder / "raw/coded.dng").rename(
            folder / "raw/Coded.dng"
        ),
        "a name that is no text": lambda folder: (folder / os.fsdecode(b"\xff\n")).touch(),
        "a name for unfinished runs": lambda folder: (folder / "job.partial").mkdir(),
        "a huge manifest": _replaced(MANIFEST, _huge),
        "a huge RAW file": _replaced("raw/coded.dng", _huge),
        "a forged owner": _unsealed(lambda told: told["owner"].update(uid=0, user="root")),
        "schema 99": _unsealed(lambda told: told.update(schema=99)),
        "schema 2 to leave out the digest": _unsealed(lambda told: told.update(schema=2)),
    }.items()
)  # fmt: skip

FORGERIES = tuple(
    Tampering(name, spoil)
    for name, spoil in {
        "schema 99": _says(lambda told: told.update(schema=99)),
        "schema 0": _says(lambda told: told.update(schema=0)),
        "schema true": _says(lambda told: told.update(schema=True)),
        "no schema": _says(lambda told: told.pop("schema")),
        "schema 2": _says(lambda told: told.update(schema=2)),
        "no verdict": _says(lambda told: told["summary"].pop("quality")),
        "a path that leads out": _says(_renames("../x")),
        "a path that leads out and in": _says(_renames("raw/../log.jsonl")),
        "an absolute path": _says(_renames("/etc/passwd")),
        "an empty path": _says(_renames("")),
        "a path with empty parts": _says(_renames("raw//log.jsonl")),
        "a path with a dot": _says(_renames("./log.jsonl")),
        "a path that ends in a slash": _says(_renames("log.jsonl/")),
        "NUL in a path": _says(_renames("log\0.jsonl")),
        "a line break in a path": _says(_renames("log\n.jsonl")),
        "a path that is no text": _says(_renames("log\udc80.jsonl")),
        "a path too long": _says(_renames("x" * 300)),
        "a path too deep": _says(_renames("x/" * 100 + "x")),
        "a manifest that lists itself": _says(_renames(MANIFEST)),
        "a manifest that lists its digest": _says(_renames(DIGEST)),
        "names that differ in case only": _says(
            lambda told: told["files"].update({"LOG.jsonl": told["files"]["log.jsonl"]})
        ),
        "endless words": _says(lambda told: told.update(schema="x" * 10**6, state="x" * 10**6)),
        "no files": _says(lambda told: told.update(files={})),
        "files in a list": _says(lambda told: told.update(files=[])),
        "no codes listed": _says(lambda told: told["files"].pop("codes.npz")),
        "a digest that is none": _says(
            lambda told: told["files"]["log.jsonl"].update(sha256="0" * 63 + "g")
        ),
        "a negative size": _says(lambda told: told["files"]["log.jsonl"].update(size_bytes=-1)),
        "a RAW file that is not listed": _says(_of("shot", raw="raw/other.dng")),
        "a RAW file of another digest": _says(_of("shot", sha256="0" * 64)),
        "a RAW file elsewhere": _says(_of("shot", raw="../coded.dng")),
        "negative refreshes": _says(_of("shot", refreshes=-1)),
        "refreshes true": _says(_of("shot", refreshes=True)),
        "refreshes of 5000 digits": _literal("refreshes", "9" * 5000),
        "a time of 30 digits": _literal("open_ns", "-" + "9" * 30),
        "an f-number of 0": _says(_of("shot", f_number=0)),
        "an f-number that is no number": _says(_of("shot", f_number=float("nan"))),
        "an endless f-number": _literal("f_number", "1e999"),
        "a level below 0": _says(_of("shot", level=-1.0)),
        "closed before it opened": _says(_of("shot", open_ns=2, close_ns=1)),
        "a window that is none": _says(_of("shot", window="none")),
        "two shots of one name": _says(
            lambda told: told["run"]["shots"].append(told["run"]["shots"][0])
        ),
        "no cells": _says(_of("run", grid=[0, 4])),
        "too many cells": _says(_of("run", grid=[2**20, 2**20])),
        "another grid than that of the cells": _says(_of("run", grid=[4, 3])),
        "three sides": _says(_of("run", grid=[3, 4, 5])),
        "a dark camera": _says(_of("run", responsivity_e=[0.0, 1.0, 1.0])),
        "a goal that is none": _says(_of("run", goal={"name": "sideways"})),
        "a profile that is none": _says(lambda told: told["run"]["profile"].update(bits=99)),
        "no run": _says(lambda told: told.pop("run")),
        "a run that failed": _says(lambda told: told.update(state="failed")),
        "an owner in a list": _says(lambda told: told.update(owner=[1])),
        "a key twice": _text(lambda text: text.replace("{", '{"schema": 1,', 1)),
        "a key twice further in": _text(lambda text: text.replace('"uid"', '"uid": 1, "uid"', 1)),
        "a byte order mark": _text(lambda text: "\ufeff" + text),
        "text behind the end": _text(lambda text: text + "{}"),
        "a comment": _text(lambda text: text.replace("{", "{// \n", 1)),
        "half a surrogate": _text(lambda text: text.replace('"note": "', '"note": "\\ud800', 1)),
        "no UTF-8": _written(b'{"schema": "\xff\xfe"}'),
        "UTF-16": _text(lambda text: text.encode("utf-16-le").decode("latin-1")),
        "a list": _written(b"[]"),
        "null": _written(b"null"),
        "nothing": _written(b""),
        "zeros": _written(bytes(1000)),
        "a million lists in each other": _written(b"[" * 10**6),
        "a million tables in each other": _written(b'{"a":' * 10**6 + b"1" + b"}" * 10**6),
        "a million lists in a table": _written(b'{"schema":' + b"[" * 10**6 + b"]" * 10**6 + b"}"),
    }.items()
)  # fmt: skip

HIDDEN = tuple(
    Tampering(name, spoil)
    for name, spoil in {
        "another owner": _says(lambda told: told["owner"].update(uid=0, user="root")),
        "another time": _says(lambda told: told.update(finished_utc="2000-01-01T00:00:00+00:00")),
        "another layout": _text(lambda text: text.replace("\n ", "\n  ")),
    }.items()
)
