"""A watched folder that others write into: an honest program, and what means harm beside it."""

from __future__ import annotations

import os
import shutil
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random

from tests.watched_bench import dng

SPARSE_B = 60 * 2**30
LATE_S = 2.0
KEPT = 40
"""Things of harm that lie there at a time; older ones go."""
ODD_NAMES = (
    b"IMG_\xff\xfe.DNG", b"a\nb.dng", b"\x1b[2J\x1b]0;x\x07.dng", b"x" * 251 + b".dng",
    b"._IMG_1.DNG", b"~tmp12.dng", b"IMG_1 (1).DNG", b".DS_Store", b"IMG_1.DNG.part", b"-rf.dng",
    "\u202egnd.IMG.dng".encode(),
)  # fmt: skip


def _make_socket(path: Path, private: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made, suppress(OSError):
        made.bind(str(path))


def _make_sparse(path: Path, private: Path) -> None:
    with path.open("wb") as file:
        file.write(private.read_bytes())
        file.truncate(SPARSE_B)


def _make_late(path: Path, private: Path) -> None:
    """Of full length at once; its data come later, or never."""
    data = private.read_bytes()
    path.write_bytes(data[:4096] + bytes(len(data) - 4096))
    if hash(path.name) % 2:
        threading.Timer(LATE_S, lambda: path.exists() and path.write_bytes(data)).start()


def _make_cut(path: Path, private: Path) -> None:
    """Cut; the rest comes later, or never."""
    data = private.read_bytes()
    path.write_bytes(data[: len(data) // 3])
    if hash(path.name) % 2:
        threading.Timer(LATE_S, lambda: path.exists() and path.write_bytes(data)).start()


def _make_deep(path: Path, private: Path) -> None:
    deep = path
    for _ in range(60):
        deep /= "d"
    deep.mkdir(parents=True)
    (deep / "IMG_1.DNG").write_bytes(private.read_bytes())


HARM: dict[str, Callable[[Path, Path], object]] = {
    "FIFO": lambda path, _: os.mkfifo(path),
    "link to /dev/zero": lambda path, _: path.symlink_to("/dev/zero"),
    "somebody's link": lambda path, private: path.symlink_to(private),
    "somebody's file": lambda path, private: path.hardlink_to(private),
    "loop": lambda path, _: path.symlink_to(path.name),
    "folder": lambda path, _: path.mkdir(),
    "socket": _make_socket,
    "deep": _make_deep,
}
"""Kinds of things by the name of a photo that are none, made at a path beside a private photo."""
PHOTOS = {"sparse": _make_sparse, "late": _make_late, "cut": _make_cut}
"""The same that might become one."""


class Card:
    """The folder. `photograph` has the honest program save one photo after a moment."""

    def __init__(self, folder: Path, private: Path, photo: bytes) -> None:
        self.folder, self._private, self._photo = folder, private, photo
        folder.mkdir()
        private.write_bytes(dng(seed=99, side=512))
        private.chmod(0o600)
        self._number = 0
        self._quiet, self._rng = threading.Event(), Random(1)

    def photograph(self) -> None:
        """Save it as such programs should: under another name, and renamed once it is whole."""
        threading.Timer(0.2, self._save).start()

    def _save(self) -> None:
        self._number += 1
        part = self.folder / f".saving-{self._number}"
        with suppress(OSError):  # the bench is gone
            part.write_bytes(self._photo)
            part.rename(self.folder / f"IMG_{self._number:04d}.DNG")

    def provoke(self, on: bool) -> None:
        """Have things of harm appear from now on, or no longer and no more."""
        self._quiet.set()
        if on:
            self._quiet = threading.Event()
            threading.Thread(target=self._go_on, args=(self._quiet,), daemon=True).start()
        else:
            time.sleep(LATE_S + 0.5)  # data that are late have come
            for entry in self.folder.iterdir():
                if not entry.name.startswith(("IMG_0", ".saving")):
                    _remove(entry)

    def _go_on(self, quiet: threading.Event) -> None:
        made: list[Path] = []
        while not quiet.wait(self._rng.uniform(0.02, 0.3)):
            with suppress(OSError):
                made.append(self._harm(self._rng))
            if len(made) > KEPT:
                _remove(made.pop(0))

    def _harm(self, rng: Random) -> Path:
        """One thing more; what could pass for a photo is rare, or no photo would ever be taken."""
        name = f"HARM_{rng.randrange(10**6)}.DNG"
        dice = rng.random()
        if dice < 0.02:
            place = self.folder / os.fsdecode(rng.choice(ODD_NAMES))
            place.write_bytes(self._photo if rng.random() < 0.05 else b"II*\0")
        elif dice < 0.03:
            place = self.folder / name
            PHOTOS[rng.choice(sorted(PHOTOS))](place, self._private)
        else:
            place = self.folder / name
            HARM[rng.choice(sorted(HARM))](place, self._private)
        return place


def _remove(path: Path) -> None:
    with suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()
