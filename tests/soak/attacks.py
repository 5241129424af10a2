"""What a soak does to a daemon while it takes a photo: each a function of the daemon and a dice."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from random import Random

from pdcd.client import Client
from pdcd.errors import PdcdError
from pdcd.protocol.line_talk import UnreachableError
from tests.hostile import crowd, files
from tests.hostile.requests import attacks
from tests.soak import daemon as orders
from tests.soak import disk, processes
from tests.soak.daemons import Daemon
from tests.soak.wanted import GRID

GONE_S = 10.0
"""How long a killed process may take to end."""
CALLS = {
    "display": ("load", "black", "play"),
    "shutter": ("open", "close"),
    "readout": ("arm", "fetch"),
}


@dataclass(frozen=True)
class Attack:
    """One kind. `do` returns how many processes it killed.

    ends : the daemon ends by it. spoils : the photo may fail by it. after : what puts it right.
    on : names of the benches it is for, all when empty.
    """

    name: str
    do: Callable[[Daemon, Random], int]
    ends: bool = False
    spoils: bool = True
    after: Callable[[Daemon], None] = lambda _: None
    on: tuple[str, ...] = ()


def _signal_daemon(number: int) -> Callable[[Daemon, Random], int]:
    def do(daemon: Daemon, rng: Random) -> int:
        daemon.look()
        daemon.process.send_signal(number)
        return 1

    return do


def _abort_all(daemon: Daemon, rng: Random) -> int:
    """As the service manager's watchdog does: to every process of the group at once."""
    daemon.look()
    for pid in sorted(processes.family(daemon.pid), reverse=True):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGABRT)
    return 1


def _signal_role(role: str, number: int) -> Callable[[Daemon, Random], int]:
    def do(daemon: Daemon, rng: Random) -> int:
        daemon.look()
        found = processes.of_role(daemon.pid, role)
        for pid in found:
            with suppress(ProcessLookupError):
                os.kill(pid, number)
        if number == signal.SIGKILL:
            # A busy machine may take a while: the next photo, left in peace, would meet the kill.
            processes.gone(set(found), GONE_S)
        return len(found)

    return do


def _kill_client(daemon: Daemon, rng: Random) -> int:
    """A second client waits in the queue with the command line, and is killed."""
    words = ["capture", "indirect", "--codes", "32", "--queue", "--socket", str(daemon.socket)]
    command = [sys.executable, "-m", "pdcd", *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as client:
        time.sleep(rng.uniform(0.2, 1.5))
        client.kill()
    return 1


def _fault(daemon: Daemon, rng: Random) -> int:
    """The next call of some kind, of some device, goes wrong somehow."""
    role = rng.choice(list(CALLS))
    how = rng.choice(orders.HOWS)
    daemon.excused, daemon.excuse_ends = how == "hang", False
    told = json.dumps({"role": role, "call": rng.choice(CALLS[role]), "how": how})
    path = daemon.bench.folder / orders.FAULT
    path.with_suffix(".new").write_text(told)
    path.with_suffix(".new").replace(path)
    return 0


def _no_fault(daemon: Daemon) -> None:
    daemon.excuse_ends = True
    (daemon.bench.folder / orders.FAULT).unlink(missing_ok=True)


def _step_clock(daemon: Daemon, rng: Random) -> int:
    (daemon.bench.folder / orders.CLOCK).write_text(str(rng.uniform(-1e6, 1e6)))
    return 0


def _fill_disk(daemon: Daemon, rng: Random) -> int:
    """All of it but a few kilobytes."""
    left = os.statvfs(daemon.bench.state)
    free = left.f_bavail * left.f_frsize - rng.randrange(200_000)
    with suppress(OSError), (daemon.bench.state / "filler").open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, max(free, 1))
    return 0


def _empty_disk(daemon: Daemon) -> None:
    (daemon.bench.state / "filler").unlink(missing_ok=True)


def _protect_disk(daemon: Daemon, rng: Random) -> int:
    disk.protect(daemon.bench.state)
    return 0


def _allow_disk(daemon: Daemon) -> None:
    disk.allow(daemon.bench.state)


def _hostile(daemon: Daemon, rng: Random) -> int:
    """Requests that mean harm, over all parameters and all kinds of files."""
    folder = daemon.bench.folder / "arrays"
    if not folder.exists():
        files.kinds(folder)
    with (
        suppress(UnreachableError, PdcdError, OSError),
        Client(daemon.socket, timeout_s=20.0) as client,
    ):
        for attack in attacks(rng.randrange(2**31), 20, folder, GRID):
            line = attack.line + b"\n"
            sent = socket.send_fds(client._sock, [line], attack.fds)
            client._sock.sendall(line[sent:])
            attack.close()
            daemon.answered(client._receive(20.0))
    return 0


def _provoke(daemon: Daemon, rng: Random) -> int:
    """What photos come from means harm for a while: a camera in bad moods, a folder full of links,
    pipes and half files."""
    assert daemon.bench.provoke is not None
    daemon.bench.provoke(True)
    time.sleep(rng.uniform(0.5, 6.0))
    daemon.bench.provoke(False)
    return 0


def _flood(daemon: Daemon, rng: Random) -> int:
    """One thing again and again: lists of runs, lines of many members or numbers, slow headers."""
    line = crowd.FLOODS[rng.choice(sorted(crowd.FLOODS))]()
    until_s = time.monotonic() + rng.uniform(0.2, 2.0)
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock:
        sock.settimeout(5.0)
        sock.connect(str(daemon.socket))
        while time.monotonic() < until_s:
            sock.sendall(line)
            with suppress(BlockingIOError):
                sock.recv(2**20, socket.MSG_DONTWAIT)
    return 0


def _idle(daemon: Daemon, rng: Random) -> int:
    """Connections that say nothing, not even goodbye in time."""
    held = []
    for _ in range(24):
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        sock.setblocking(False)
        with suppress(OSError):
            sock.connect(str(daemon.socket))
        held.append(sock)
    time.sleep(rng.uniform(0.0, 0.5))
    for sock in held:
        sock.close()
    return 0


def _garbage(daemon: Daemon, rng: Random) -> int:
    """Lines that are none, cut at random, and a client that leaves in the middle of one."""
    words = (b'{"jsonrpc":"2.0",', b'"id":1,', b'"method":"capture.start",', b'"params":{', b"}}")
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock:
        sock.settimeout(5.0)
        sock.connect(str(daemon.socket))
        for _ in range(200):
            line = b"".join(rng.choices(words, k=rng.randrange(1, 7))) + rng.randbytes(
                rng.randrange(9)
            )
            sock.sendall(line + b"\n" * rng.randrange(2))
    return 0


def _vanish(daemon: Daemon, rng: Random) -> int:
    """Clients that start something and leave at once."""
    calls: list[tuple[str, dict[str, object]]] = [
        ("capture.start", {"goal": "indirect", "codes": 64, "queue": True}),
        ("capture.plan", {"goal": "indirect", "codes": 4096}),
        ("display.show", {"pattern": "white"}),
        ("preview.grab", {}),
        ("rig.describe", {}),
    ]
    for _ in range(4):
        method, params = rng.choice(calls)
        with suppress(PdcdError, UnreachableError, OSError), Client(daemon.socket) as client:
            client._send(method, params)
            time.sleep(rng.uniform(0.0, 0.2))
    return 0


ATTACKS = (
    Attack("kill -9 the daemon", _signal_daemon(signal.SIGKILL), ends=True),
    Attack("SIGABRT to all its processes", _abort_all, ends=True),
    Attack("SIGTERM to the daemon", _signal_daemon(signal.SIGTERM), ends=True),
    Attack("kill -9 the presenter", _signal_role("presenter", signal.SIGKILL), on=("windows",)),
    Attack("SIGSTOP the presenter", _signal_role("presenter", signal.SIGSTOP), on=("windows",)),
    Attack(
        "kill -9 the guardian",
        _signal_role("guardian", signal.SIGKILL),
        on=("windows", "body", "card"),
    ),
    Attack("kill -9 the decoder", _signal_role("decoder", signal.SIGKILL)),
    Attack("kill -9 a waiting client", _kill_client, spoils=False),
    Attack("a device fails, hangs or is late", _fault, after=_no_fault),
    Attack("the wall clock steps", _step_clock, spoils=False),
    Attack("the disk is full", _fill_disk, after=_empty_disk, on=("mocks",)),
    Attack("the disk is read-only", _protect_disk, after=_allow_disk, on=("mocks",)),
    Attack("a camera or a folder means harm", _provoke, on=("body", "card")),
    Attack("hostile requests", _hostile, spoils=False),
    Attack("floods of one request", _flood, spoils=False),
    Attack("idle connections", _idle, spoils=False),
    Attack("garbage lines", _garbage, spoils=False),
    Attack("clients that vanish", _vanish, spoils=False),
)
