"""Attackers that come all at once, each a process of its own, while an honest client goes about its
work: how long it waits, and what the daemon keeps.

Where this runs as root, attackers are another user, who may look and shoot.
"""

from __future__ import annotations

import base64
import contextlib
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdcd.client import Client
from pdcd.errors import PdcdError
from pdcd.protocol.request import CaptureRequest
from tests.hostile.files import raw_npy
from tests.run_folders import finished, job

EVE = 65534
RUNS = 300
"""In the state folder: a list of them is work."""
STATUS_S, CANCEL_S, RSS_MIB = 0.25, 1.0, 400.0
"""What must hold: the 99th percentile of `rig.status`, every cancel, the daemon's memory."""


@dataclass
class Outcome:
    """What the honest client saw; times in seconds, memory in MiB."""

    status_s: list[float] = field(default_factory=list)
    cancel_s: list[float] = field(default_factory=list)
    page_s: list[float] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    rss_mib: list[float] = field(default_factory=list)
    end_s: float = 0.0
    """From SIGTERM to the end of the daemon."""

    def broken(self) -> list[str]:
        """Promises that were not kept."""
        kept = {
            "rig.status": _percentile(self.status_s, 0.99) < STATUS_S,
            "cancel": max(self.cancel_s) < CANCEL_S,
            "memory": max(self.rss_mib) < RSS_MIB,
            "SIGTERM": self.end_s < 10.0,
            "nothing fails": not self.failed,
        }
        return [name for name, is_kept in kept.items() if not is_kept] + self.failed[:5]

    def told(self) -> str:
        """The figures in words."""
        half_s, most_s = (_percentile(self.status_s, share) for share in (0.5, 0.99))
        return (
            f"{len(self.status_s)} times rig.status: half in {half_s:.3f} s, "
            f"99 % in {most_s:.3f} s, all in {max(self.status_s):.3f} s\n"
            f"{len(self.cancel_s)} cancels: all in {max(self.cancel_s):.3f} s; "
            f"{len(self.page_s)} pages: all in {max(self.page_s):.3f} s\n"
            f"memory: {self.rss_mib[0]:.0f} MiB at first, {max(self.rss_mib):.0f} at most, "
            f"{self.rss_mib[-1]:.0f} afterwards; ended in {self.end_s:.2f} s"
        )


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


def trial(folder: Path, seconds: float) -> Outcome:
    """Let all of them come for so long, with a daemon whose engine does nothing."""
    folder.chmod(0o755)
    path, state = folder / "s", folder / "state"
    for number in range(RUNS):
        finished(state / "captures", job(number % 60, 1 + number // 60))
    words = [
        "-m",
        "tests.e2e.server._fake_engine",
        "--socket",
        str(path),
        "--state-dir",
        str(state),
    ]
    log, pipe = (folder / "log").open("wb"), subprocess.PIPE
    with log, subprocess.Popen(
        [sys.executable, *words, "--shoot", str(EVE)], stdout=pipe, stderr=log
    ) as daemon, _page(path, state) as (port, head):  # fmt: skip
        try:
            return _watched(daemon, path, port, head, seconds)
        finally:
            daemon.kill()


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


def _watched(
    daemon: subprocess.Popen[bytes], path: Path, port: int, head: bytes, seconds: float
) -> Outcome:
    outcome = Outcome()
    while not path.exists():
        time.sleep(0.05)
    make = multiprocessing.get_context("fork").Process
    attackers = [
        make(target=_flood, args=(str(path), name, reads), daemon=True)
        for name in FLOODS
        for reads in (True, False)
    ]
    attackers.append(make(target=_keep_places, args=(port, 200), daemon=True))
    outcome.rss_mib.append(_rss_mib(daemon.pid))
    with Client(path, timeout_s=30.0) as client:
        for attacker in attackers:
            attacker.start()
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            _go_about(client, port, head, outcome)
            outcome.rss_mib.append(_rss_mib(daemon.pid))
        for attacker in attackers:
            attacker.kill()
            attacker.join()
        time.sleep(1.0)
        outcome.rss_mib.append(_rss_mib(daemon.pid))
    begun_s = time.monotonic()
    daemon.send_signal(signal.SIGTERM)
    daemon.wait(30.0)
    outcome.end_s = time.monotonic() - begun_s
    return outcome


def _go_about(client: Client, port: int, head: bytes, outcome: Outcome) -> None:
    """What an honest client does, each a few times."""

    def timed(times: list[float], ask: Callable[[], object]) -> None:
        begun_s = time.monotonic()
        try:
            ask()
        except (PdcdError, OSError) as err:
            outcome.failed.append(f"{type(err).__name__}: {err}")
        times.append(time.monotonic() - begun_s)

    for _ in range(20):
        timed(outcome.status_s, client.status)
        time.sleep(0.01)
    request = CaptureRequest(goal="white", note="slow")
    started = client.capture(request, detach=True, queue=True)
    timed(outcome.cancel_s, lambda: client.cancel(started.job))
    timed(outcome.page_s, lambda: _ask_page(port, head))


def _ask_page(port: int, head: bytes) -> None:
    with socket.create_connection(("127.0.0.1", port), 20.0) as sock:
        sock.sendall(head)
        answer = sock.recv(64)
        while sock.recv(2**20):
            pass
    if not answer.startswith(b"HTTP/1.1 200"):
        raise OSError(f"the page answered {answer!r}")


def _rss_mib(pid: int) -> float:
    with Path(f"/proc/{pid}/status").open() as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmRSS"))
