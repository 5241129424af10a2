"""Attackers that come all at once, each a process of its own, while an honest client goes about its
work: how long it waits, and what the daemon keeps.

Where this runs as root, attackers are another user, who may look and shoot.
"""

from __future__ import annotations

import base64
import contextlib
import itertools
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from pdcd.bench.config import format_config, load_config
from pdcd.bench.tables import RoleConfig
from pdcd.client import Client
from pdcd.errors import PdcdError
from pdcd.protocol.request import CaptureRequest
from tests.hostile.files import kinds, raw_npy
from tests.hostile.requests import attacks
from tests.processes import read_rss_mib
from tests.run_folders import finished, job
from tests.soak.benches import Bench
from tests.soak.daemons import Daemon
from tests.soak.wanted import GRID

EVE = 65534
RUNS = 300
"""In the state folder: a list of them is work."""
STATUS_S, CANCEL_S, RSS_MIB, BEAT_S, END_S = 0.25, 1.0, 400.0, 2.0, 10.0
"""What must hold: the 99th percentile of `rig.status`, every cancel, the daemon's memory, its heart
beat, and its end with all panels black and the shutter closed."""
ENDED_S = 15.0
"""From a cancel to the end of the job: devices may draw out being made safe."""
SPOILS = frozenset({"device_lost", "exposure", "decode"})
"""Kinds of errors that a camera or a folder which means harm may end a photo by."""
KEPT_MIB, GIVEN_BACK_S = 40.0, 7.0
"""How much more the daemon may keep than it had at first, and how long afterwards."""


@dataclass
class Outcome:
    """What the honest client saw; times in seconds, memory in MiB."""

    status_s: list[float] = field(default_factory=list)
    cancel_s: list[float] = field(default_factory=list)
    ended_s: list[float] = field(default_factory=list)
    """From a cancel to the end of the job."""
    capture_s: list[float] = field(default_factory=list)
    page_s: list[float] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    spoilt: Counter[str] = field(default_factory=Counter)
    """Captures that a camera or a folder spoilt which means harm, by the kind of error."""
    rss_mib: list[float] = field(default_factory=list)
    beat_s: float = 0.0
    """Longest silence of the heart beat."""
    end_s: float = 0.0
    """From SIGTERM, amid an exposure, to the end of the daemon."""
    lit: tuple[bool, ...] = ()
    """Whether panels were lit and the shutter open once it had ended, where that can be seen."""

    def broken(self) -> list[str]:
        """Promises that were not kept."""
        kept = {
            "rig.status": _percentile(self.status_s, 0.99) < STATUS_S,
            "cancel": max(self.cancel_s) < CANCEL_S,
            "end of a job that was cancelled": max(self.ended_s) < ENDED_S,
            "memory": max(self.rss_mib) < RSS_MIB,
            "memory given back": self.rss_mib[-1] < self.rss_mib[0] + KEPT_MIB,
            "heart beat": self.beat_s < BEAT_S,
            "SIGTERM": self.end_s < END_S,
            "panels black and shutter closed": not any(self.lit),
            "nothing fails": not self.failed,
        }
        return [name for name, is_kept in kept.items() if not is_kept] + self.failed[:5]

    def told(self) -> str:
        """The figures in words."""
        half_s, most_s = (_percentile(self.status_s, share) for share in (0.5, 0.99))
        return (
            f"{len(self.status_s)} times rig.status: half in {half_s:.3f} s, "
            f"99 % in {most_s:.3f} s, all in {max(self.status_s):.3f} s\n"
            f"{len(self.cancel_s)} cancels: all in {max(self.cancel_s):.3f} s, their jobs ended in "
            f"{max(self.ended_s):.3f} s; "
            f"{len(self.page_s)} pages: all in {max(self.page_s):.3f} s; "
            f"{len(self.capture_s)} captures: all in {max(self.capture_s):.3f} s, spoilt by their "
            f"device: {dict(self.spoilt)}\n"
            f"memory: {self.rss_mib[0]:.0f} MiB at first, {max(self.rss_mib):.0f} at most, "
            f"{self.rss_mib[-1]:.0f} afterwards; longest silence of the heart {self.beat_s:.2f} s; "
            f"ended in {self.end_s:.2f} s"
        )


_WAITS = itertools.cycle((0.0, 0.1, 0.4, 1.0))


def _percentile(values: list[float], share: float) -> float:
    return sorted(values)[int(share * (len(values) - 1))]


def _line(method: str, params: bytes = b"{}") -> bytes:
    return b'{"jsonrpc":"2.0","id":1,"method":"%s","params":%s}\n' % (method.encode(), params)


def _wide() -> bytes:
    return b"{" + b",".join(b'"m%d":%d' % (n, n) for n in range(70_000)) + b"}"


def _slow_header() -> bytes:
    """Of an .npy file: a header that is long, and almost one."""
    text = "{'descr': '<f8', 'fortran_order': False, 'shape': (4, 6)"
    content = base64.b64encode(raw_npy(text + ")" + " " * 1980 + "x", b""))
    return b'{"goal":"illuminated","illumination":{"npy":"%s"}}' % content


FLOODS: dict[str, Callable[[], bytes]] = {
    "lists of runs": lambda: _line("capture.list", b'{"find":{"newest":1000}}'),
    "wide members": lambda: _line("capture.start", _wide()),
    "many numbers": lambda: _line(
        "capture.plan", b'{"goal":"white","kernel":[[' + b"1," * 400_000 + b"1]]}"
    ),
    "slow headers": lambda: _line("capture.plan", _slow_header()),
    "wrong parameters": lambda: _line("capture.start", b'{"goal":"white","kernel":[["x"]]}'),
    "what is no JSON": lambda: b"[" * 2000 + b"\n",
}
"""By name, what is sent again and again."""


def _become_eve() -> None:
    if os.getuid() == 0:
        os.setgroups([])
        os.setgid(EVE)
        os.setuid(EVE)


def _flood(path: str, name: str, reads: bool) -> None:
    """Send one thing without end on two connections, which come again when they are cut."""
    _become_eve()
    line = FLOODS[name]()
    data = line * max(1, 65536 // len(line))
    while True:
        with contextlib.suppress(OSError), contextlib.ExitStack() as held:
            socks = [held.enter_context(socket.socket(socket.AF_UNIX)) for _ in range(2)]
            for sock in socks:
                sock.settimeout(5.0)
                sock.connect(path)
            while True:
                for sock in socks:
                    sock.sendall(data)
                    while reads and len(sock.recv(2**20)) == 2**20:
                        pass


def _attack(path: str, arrays: str, seed: int) -> None:
    """Make requests that mean harm, each on a connection that is left at once or after a while."""
    _become_eve()
    for attack in attacks(seed, 10**9, Path(arrays), GRID):
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as sock:
            sock.settimeout(1.0)
            sock.connect(path)
            socket.send_fds(sock, [attack.line + b"\n"], attack.fds)
            sock.recv(2**20)
        attack.close()


def _keep_places(port: int, count: int) -> None:
    """Hold connections to the page, and come again as soon as one is cut."""
    _become_eve()
    held: list[socket.socket] = []
    while True:
        while len(held) < count:
            with contextlib.suppress(OSError):
                sock = socket.socket()
                sock.connect(("127.0.0.1", port))
                sock.setblocking(False)
                held.append(sock)
        for sock in list(held):
            with contextlib.suppress(BlockingIOError, ConnectionError):
                if sock.recv(100):
                    continue
            if _is_cut(sock):
                held.remove(sock)
                sock.close()
        time.sleep(0.001)


def _is_cut(sock: socket.socket) -> bool:
    try:
        return sock.recv(1, socket.MSG_PEEK) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


def trial(bench: Bench, seconds: float) -> Outcome:
    """Let all of them come for so long, to a daemon that takes photos on a bench."""
    bench.folder.chmod(0o755)
    for number in range(RUNS):
        finished(bench.state / "captures", job(number % 60, 1 + number // 60))
    kinds(bench.folder / "arrays")
    config = load_config(bench.config)
    server = msgspec.structs.replace(config.server, shoot=RoleConfig(uids=(EVE,)))
    bench.config.write_text(format_config(msgspec.structs.replace(config, server=server)))
    path = bench.folder / "s"
    with _page(path, bench.state) as (port, head), Daemon(bench) as daemon:
        outcome = _watched(daemon, path, port, head, seconds)
    outcome.beat_s = daemon.gap_s
    traces = (bench.folder / "log").read_text().split("Traceback (most recent call last)")[1:]
    outcome.failed += [f"a fault of the program in its log: ...{trace[:1000]}" for trace in traces]
    outcome.lit = tuple(look() if look else False for look in (bench.lit, bench.is_open))
    return outcome


@contextlib.contextmanager
def _page(path: Path, state: Path) -> Any:
    """`pdcd web` before the daemon: its port, and the head of a request that may be made."""
    command = [sys.executable, "-m", "pdcd", "web", "--port", "0", "--socket", str(path)]
    with subprocess.Popen(
        [*command, "--state-dir", str(state)], stdout=subprocess.PIPE, text=True
    ) as page:
        assert page.stdout is not None
        address = next(line for line in page.stdout if "http://" in line)
        host, _, token = address.strip().rpartition("http://")[2].partition("/#")
        head = f"GET /runs HTTP/1.1\r\nhost: {host}\r\nauthorization: Bearer {token}\r\n\r\n"
        try:
            yield int(host.rpartition(":")[2]), head.encode()
        finally:
            page.kill()


def _watched(daemon: Daemon, path: Path, port: int, head: bytes, seconds: float) -> Outcome:
    outcome = Outcome()
    make = multiprocessing.get_context("fork").Process
    attackers = [
        make(target=_flood, args=(str(path), name, reads), daemon=True)
        for name in FLOODS
        for reads in (True, False)
    ]
    attackers.append(make(target=_keep_places, args=(port, 200), daemon=True))
    arrays = str(daemon.bench.folder / "arrays")
    attackers += [make(target=_attack, args=(str(path), arrays, n), daemon=True) for n in range(3)]
    with Client(path, timeout_s=60.0) as client:
        client.capture(CaptureRequest(goal="white", codes=8))  # all is loaded now
        outcome.rss_mib.append(read_rss_mib(daemon.pid))
        for attacker in attackers:
            attacker.start()
        if daemon.bench.provoke is not None:
            daemon.bench.provoke(True)
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            _go_about(client, port, head, outcome, daemon.bench.provoke is not None)
            outcome.rss_mib.append(read_rss_mib(daemon.pid))
        for attacker in attackers[:-1]:
            attacker.kill()
        time.sleep(GIVEN_BACK_S)
        outcome.rss_mib.append(read_rss_mib(daemon.pid))
        _end_amid_light(daemon, client, outcome)
        attackers[-1].kill()
    return outcome


def _end_amid_light(daemon: Daemon, client: Client, outcome: Outcome) -> None:
    """SIGTERM while a photo is exposed, where there is somebody to see it."""
    client.capture(CaptureRequest(goal="white"), detach=True, queue=True)
    until_s = time.monotonic() + 20.0
    is_open, is_lit = (look or (lambda: False) for look in (daemon.bench.is_open, daemon.bench.lit))
    while daemon.bench.is_open and not is_open() and time.monotonic() < until_s:
        time.sleep(0.01)
    begun_s = time.monotonic()
    daemon.process.send_signal(signal.SIGTERM)
    daemon.process.wait(30.0)
    while (is_open() or is_lit()) and time.monotonic() < begun_s + END_S:
        time.sleep(0.01)  # a guardian is at it
    outcome.end_s = time.monotonic() - begun_s


def _go_about(client: Client, port: int, head: bytes, outcome: Outcome, spoils: bool) -> None:
    """What an honest client does, each a few times; `spoils`: photos may fail by their device."""

    def timed(times: list[float], ask: Callable[[], object]) -> None:
        begun_s = time.monotonic()
        try:
            ask()
        except (PdcdError, OSError) as err:
            outcome.failed.append(f"{type(err).__name__}: {err}")
        times.append(time.monotonic() - begun_s)

    def take(request: CaptureRequest) -> None:
        error = client.capture(request, queue=True).error
        if error is not None:
            kind = str(error["kind"])
            outcome.spoilt[kind] += 1
            if not (spoils and kind in SPOILS):
                outcome.failed.append(f"{kind}: {error['message']}")

    for _ in range(20):
        timed(outcome.status_s, client.status)
        time.sleep(0.01)
    request = CaptureRequest(goal="indirect", codes=32)
    started = client.capture(request, detach=True, queue=True)
    time.sleep(next(_WAITS))
    begun_s = time.monotonic()
    timed(outcome.cancel_s, lambda: client.cancel(started.job))
    client.wait(started.job)
    outcome.ended_s.append(time.monotonic() - begun_s)
    timed(outcome.capture_s, lambda: take(CaptureRequest(goal="white", codes=8)))
    timed(outcome.page_s, lambda: _ask_page(port, head))


def _ask_page(port: int, head: bytes) -> None:
    with socket.create_connection(("127.0.0.1", port), 20.0) as sock:
        sock.sendall(head)
        answer = sock.recv(64)
        while sock.recv(2**20):
            pass
    if not answer.startswith(b"HTTP/1.1 200"):
        raise OSError(f"the page answered {answer!r}")
