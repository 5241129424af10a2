"""One life of a daemon on a bench, with an ear for its heart beat."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from contextlib import suppress
from types import TracebackType
from typing import Any

from pdcd.client import Client
from pdcd.protocol.line_talk import UnreachableError
from tests.places import ROOT
from tests.soak import processes
from tests.soak.benches import Bench
from tests.soak.lapse import Lapse

START_S = 60.0
BEAT_S = 0.5
"""How often the heart is to beat; the watchdog would wait for three times as long."""


class Daemon:
    """A process that serves, from ready to its end; a context manager that kills what is left."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.socket = bench.folder / "s"
        self.gap_s = 0.0
        """Longest silence of the heart beat so far, of the time that the machine had."""
        self.excused = False
        """True while a device may hang: the thread that waits for it cannot beat."""
        self.excuse_ends = False
        """True once it cannot any more; the beat after that is the first that counts again."""
        self.kinds: Counter[str] = Counter()
        """Answers to hostile requests, by kind."""
        self.faults: list[str] = []
        """Those of them that were faults of the program."""
        self._silence: Lapse | None = None
        self._ear = self._listen()
        bench.freed()
        (bench.folder / "fault.json").unlink(missing_ok=True)
        self.log = (bench.folder / "log").open("ab")
        command = [sys.executable, "-m", "tests.soak.daemon"]
        self.process = subprocess.Popen(
            [*command, str(bench.config), str(self.socket), str(bench.folder)],
            stderr=self.log,
            stdin=subprocess.DEVNULL,
            cwd=ROOT,
            env=os.environ | {
                "NOTIFY_SOCKET": str(bench.folder / "notify"),
                "WATCHDOG_USEC": str(round(3e6 * BEAT_S)),
            },
            start_new_session=True,
        )  # fmt: skip
        self.pid = self.process.pid
        self._wait_until_ready()
        self.started: set[int] = set()
        self.look()

    def __enter__(self) -> Daemon:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.look()
        self.process.kill()
        self.process.wait()
        self._ear.close()
        self.log.close()

    def answered(self, message: dict[str, Any]) -> None:
        """Take note of an answer: none may be a fault of the program."""
        if "error" in message:
            self.kinds[message["error"]["data"]["kind"]] += 1
            if message["error"]["data"]["kind"] == "internal":
                self.faults.append(str(message["error"]))
        elif "result" in message:
            self.kinds["done"] += 1

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self.process.poll() is None

    def client(self) -> Client:
        """A new connection, tried for as long as a busy daemon may need."""
        give_up_s = time.monotonic() + START_S
        while True:
            try:
                return Client(self.socket, timeout_s=20.0)
            except (UnreachableError, OSError):
                if time.monotonic() > give_up_s or not self.alive:
                    raise
                time.sleep(0.02)

    def look(self) -> None:
        """Take note of the processes that there are, to see later that they are gone."""
        self.started |= processes.family(self.pid).keys()

    def _wait_until_ready(self) -> None:
        try:
            with self.client() as client:
                client.status()
        except UnreachableError as err:
            raise RuntimeError(f"the daemon did not start: see {self.log.name}") from err

    def _listen(self) -> socket.socket:
        path = self.bench.folder / "notify"
        path.unlink(missing_ok=True)
        ear = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        ear.bind(str(path))
        threading.Thread(target=self._hear, args=(ear,), daemon=True).start()
        return ear

    def _hear(self, ear: socket.socket) -> None:
        with suppress(OSError):  # it was closed
            while data := ear.recv(4096):
                if b"WATCHDOG=1" not in data:
                    continue
                if self._silence is not None and not self.excused:
                    self.gap_s = max(self.gap_s, self._silence.own_s)
                self._silence = Lapse()
                if self.excuse_ends:
                    self.excused = self.excuse_ends = False
