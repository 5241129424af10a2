"""Hostile requests put to the page of `pdcd web`, with a daemon behind it: what came back, and what
the daemon was made to do."""

from __future__ import annotations

import asyncio
import os
import re
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdcd.web.door import BrowserAuth
from pdcd.web.serve import bind_loopback, serve_page
from pdcd.web.shelf import MOST_PICTURE_BYTES
from tests.e2e.server._server_harness import daemon
from tests.hostile.web_requests import JOB, Attack, Inside, attacks

AT_A_TIME = 8
PATIENCE_S = 30.0
QUIET_S = 0.2
SECRET = b"nobody is to read this"


@dataclass
class Outcome:
    """What came back: how many answers of each status ("cut" where there was none), by kind."""

    statuses: Counter[str] = field(default_factory=Counter)
    broken: list[str] = field(default_factory=list)
    seconds: float = 0.0


def hostile_state(folder: Path) -> None:
    """A run that leads away: a link in the place of its report, and worse in that of pictures."""
    run = folder / "captures" / JOB
    (run / "preview").mkdir(parents=True)
    (folder / "secret.txt").write_bytes(SECRET)
    (run / "report.html").symlink_to(folder / "secret.txt")
    (run / "preview" / "secret.png").symlink_to(folder / "secret.txt")
    os.mkfifo(run / "preview" / "pipe.png")
    (run / "preview" / "folder.png").mkdir()
    with (run / "preview" / "large.png").open("wb") as file:
        file.truncate(MOST_PICTURE_BYTES + 1)


def inside_of(door: BrowserAuth) -> Inside:
    """What whoever opened the printed address has."""
    return Inside(door.host, door.address.partition("#")[2])


async def sent(host: str, port: int, data: bytes, quiet_s: float | None = QUIET_S) -> bytes:
    """All that comes back on one connection; b"" where it was cut. It may be cut while we write.

    quiet_s : silence after which we say that nothing more comes; None waits for the other side.
    """
    reader, writer = await asyncio.open_connection(host, port)
    found = b""
    try:
        async with asyncio.timeout(PATIENCE_S):
            try:
                writer.write(data)
                while piece := await _read(reader, writer, quiet_s):
                    found += piece
            except ConnectionError:
                pass
    finally:
        await parted(writer)
    return found


async def parted(writer: asyncio.StreamWriter) -> None:
    """Close a connection, whoever was first."""
    writer.close()
    try:
        await writer.wait_closed()
    except ConnectionError:
        pass


async def _read(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, quiet_s: float | None
) -> bytes:
    """What comes next; after a while of silence the other side is told that nothing more comes."""
    reading = asyncio.ensure_future(reader.read(65536))
    done, _ = await asyncio.wait([reading], timeout=quiet_s)
    if not done and writer.can_write_eof():
        writer.write_eof()
    return await reading


def told(attack: Attack, answer: bytes, outcome: Outcome) -> None:
    """Note an answer; any but a refusal breaks the promise."""
    status = answer[9:12].decode(errors="replace") if answer.startswith(b"HTTP/") else "cut"
    outcome.statuses[status] += 1
    if answer and not re.fullmatch("4[0-9][0-9]", status):
        outcome.broken.append(f"{attack.name}: {status} to {attack.data[:200]!r}")
    if len(re.findall(rb"HTTP/[0-9]\.[0-9] [0-9]", answer)) > 1:
        outcome.broken.append(f"{attack.name}: answered twice: {attack.data[:200]!r}")
    if SECRET in answer:
        outcome.broken.append(f"{attack.name}: gave a secret away: {attack.data[:200]!r}")


async def trial(folder: Path, seed: int, count: int) -> Outcome:
    """Put so many attacks to a server, some at a time; then see whether all is as it was."""
    outcome = Outcome()
    state = folder / "state"
    state.mkdir()
    hostile_state(state)
    async with daemon(folder) as running:
        sock = bind_loopback("127.0.0.1", 0)
        host, port = sock.getsockname()
        async with serve_page(sock, running.path, state) as door:
            inside = inside_of(door)
            await honest(host, port, inside)
            calls = len(running.engine.calls)
            begun_s = time.monotonic()
            waiting = attacks(inside, seed, count)

            async def one_by_one() -> None:
                for attack in waiting:
                    told(attack, await sent(host, port, attack.data), outcome)

            async with asyncio.TaskGroup() as group:
                for _ in range(AT_A_TIME):
                    group.create_task(one_by_one())
            outcome.seconds = time.monotonic() - begun_s
            if made := running.engine.calls[calls:]:
                outcome.broken.append(f"the engine was made to do {made[:5]}")
            await honest(host, port, inside)
        async with running.wire() as wire:
            status: dict[str, Any] = await wire.result("rig.status")
            jobs = (await wire.result("capture.list"))["jobs"]
            if status["state"] != "idle" or jobs or status["connections"] != 1:
                outcome.broken.append(f"the daemon is not as it was: {status}, {jobs}")
    return outcome


async def honest(host: str, port: int, inside: Inside) -> None:
    """What the page itself asks is answered."""
    who = f"host: {inside.host}\r\nauthorization: {inside.shown}"
    head = f"GET /runs HTTP/1.1\r\n{who}\r\n\r\n"
    answer = await sent(host, port, head.encode())
    assert answer.startswith(b"HTTP/1.1 200 OK") and JOB.encode() in answer, answer
