"""A daemon and the processes it started, as the kernel shows them."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

ROLES = {"presenter": "pdcd.presenter", "guardian": "guard", "decoder": "pdcd.capture.worker"}
"""Part of the command line of each."""


def family(pid: int) -> dict[int, str]:
    """Command lines of a process and of all that descend from it, by number."""
    parents: dict[int, int] = {}
    words: dict[int, str] = {}
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended meanwhile
            number = int(entry.name)
            # Strangers may have any bytes for a name.
            state, parent = (entry / "stat").read_bytes().rpartition(b")")[2].split()[:2]
            if state != b"Z":
                parents[number] = int(parent)
                line = (entry / "cmdline").read_bytes().replace(b"\0", b" ")
                words[number] = line.decode(errors="replace")
    found = {pid} & words.keys()
    while more := {n for n, parent in parents.items() if parent in found} - found:
        found |= more
    return {number: words[number] for number in found}


def of_role(pid: int, role: str) -> list[int]:
    """Numbers of the processes of a daemon that have a role of `ROLES`."""
    return [n for n, line in family(pid).items() if n != pid and ROLES[role] in line]


def gone(pids: set[int], within_s: float) -> set[int]:
    """Those of some processes that are still there after a while, or the empty set sooner."""
    until_s = time.monotonic() + within_s
    while True:
        left = {pid for pid in pids if _alive(pid)}
        if not left or time.monotonic() > until_s:
            return left
        time.sleep(0.01)


def _alive(pid: int) -> bool:
    folder = Path(f"/proc/{pid}")
    try:
        if (folder / "stat").read_bytes().rpartition(b")")[2].split()[0] != b"Z":
            return True
        # Its first thread may be gone before the others: its parent cannot know of its end yet.
        return len(list((folder / "task").iterdir())) > 1
    except OSError:
        return False


def resident(pid: int) -> dict[int, float]:
    """Resident memory of a daemon and of all it started, in MiB, by number."""
    found = {}
    for number in family(pid):
        with suppress(OSError, IndexError):
            pages = int(Path(f"/proc/{number}/statm").read_text().split()[1])
            found[number] = pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    return found


def rss_mib(pid: int) -> float:
    """Resident memory of a daemon and all it started, in MiB."""
    return sum(resident(pid).values())


def holdings(pid: int) -> dict[str, int]:
    """Open descriptors, threads and child processes of a daemon."""
    return {
        "descriptors": len(list(Path(f"/proc/{pid}/fd").iterdir())),
        "threads": len(list(Path(f"/proc/{pid}/task").iterdir())),
        "processes": len(family(pid)),
    }
