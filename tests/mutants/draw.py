"""Which files belong to a room, which of their functions must fail closed, and a fair draw."""

from __future__ import annotations

import random
from collections.abc import Collection
from pathlib import Path

from tests.mutants.operators import Mutant, mutants

FAIL_CLOSED = (
    "drivers/guard.py",
    "drivers/ptp/bulb.py",
    "drivers/ptp/guardian.py",
    "drivers/ptp/shutter.py",
    "drivers/serial_shutter/",
    "drivers/x11.py::X11Display.black",
    "drivers/x11.py::X11Display.disconnect",
    "pdcd/capture/engine.py",
    "pdcd/capture/rig.py",
    "pdcd/capture/shots.py::ShotTaker._sound",
    "pdcd/pictures/darkroom.py::Darkroom._develop",
    "pdcd/presenter/clocks.py",
    "pdcd/presenter/loop.py",
    "pdcd/presenter/process.py",
    "pdcd/presenter/realtime.py",
    "pdcd/runs/folder.py",
    "pdcd/sensor/raw.py::_read_checked",
    "pdcd/sensor/raw.py::read_raw",
    "pdcd/server/notify.py",
    "pdcd/server/runner.py",
    "pdcd/server/worker.py",
)
"""Where a fault may leave light on, a shutter open, or half a folder that looks whole: a file, a
folder (with its slash), or a function (after the colons)."""

EQUIVALENT = Path(__file__).with_name("equivalent.txt")
"""A reason, on lines that begin with '#', and below it the keys of mutants that change nothing."""


def must_fail_closed(mutant: Mutant) -> bool:
    """Whether a mutant lies in one of those paths."""
    for path in FAIL_CLOSED:
        file, _, function = path.partition("::")
        inside = mutant.path.startswith(file) if file.endswith("/") else mutant.path == file
        if inside and (f"{mutant.function}.").startswith(f"{function}." if function else ""):
            return True
    return False


def equivalents(text: str) -> set[str]:
    """The keys in such a file."""
    lines = (line.strip() for line in text.splitlines())
    return {line for line in lines if line and not line.startswith("#")}


def files_of(room: str, root: Path) -> list[Path]:
    """Files of a room, of `drivers` or a folder of it, or of all rooms; ValueError for none."""
    folders = {
        "": [root / "pdcd", root / "drivers"],
        "all": [root / "pdcd", root / "drivers"],
    }.get(room, [root / "pdcd" / room, root / room, root / "drivers" / room])
    found = [file for folder in folders for file in sorted(folder.rglob("*.py"))]
    if not found or ".." in room or room.startswith("tests"):
        rooms = sorted(path.name for path in (root / "pdcd").iterdir() if path.is_dir())
        raise ValueError(f"there is no room {room!r}; there are {', '.join(rooms)}, drivers")
    return found


def _room(path: str) -> str:
    return path.rsplit("/", 1)[0] if path.startswith("drivers/") else path.split("/")[1]


def drawn(
    files: list[Path],
    root: Path,
    count: int,
    seed: int,
    known: Collection[str] = (),
    *,
    closed: bool = False,
) -> list[Mutant]:
    """Mutants without those that are known to change nothing; the same for the same seed.

    With `closed` only such as lie in paths that must fail closed.

    Every room comes as often as any other, and in it a file by its number of possible changes; of
    these the kind first, then the place, so that constants, which are many, do not crowd out the
    rest.
    """
    rng = random.Random(seed)
    rooms: dict[str, list[list[Mutant]]] = {}
    for file in files:
        path = file.relative_to(root).as_posix()
        found = [
            one
            for one in mutants(path, file.read_bytes())
            if one.key not in known and (must_fail_closed(one) or not closed)
        ]
        if found:
            rooms.setdefault(_room(path), []).append(found)
    taken: list[Mutant] = []
    while rooms and len(taken) < count:
        room = rng.choice(sorted(rooms))
        (of_file,) = rng.choices(rooms[room], weights=[len(found) for found in rooms[room]])
        kind = rng.choice(sorted({one.operator for one in of_file}))
        one = rng.choice([one for one in of_file if one.operator == kind])
        of_file.remove(one)
        rooms[room] = [found for found in rooms[room] if found]
        rooms = {name: left for name, left in rooms.items() if left}
        taken.append(one)
    return taken
