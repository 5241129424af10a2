"""A daemon in a process of its own, and a client that writes down every line of both sides."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PATIENCE_S = 120.0
ENDS = ("done", "failed", "cancelled")
THINNED = ("planning", "progress", "decoded")
"""Events of which some may be left out, by how busy the machine is."""

TIMES = {
    "t_mono_ns": "time of the daemon's clock",
    "mono_ns": "time of the daemon's clock",
    "utc": "time",
    "uptime_s": "how long the daemon has run",
    "seq": "thinned events count, and are not always sent",
}
"""Fields of a transcript that are covered beside the usual ones, each with the reason."""


class Talk:
    """One connection. said : what was asked and answered, in the order of the questions. events :
    by job, in the order of their first event."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(PATIENCE_S)
        self._socket.connect(str(path))
        self._rest = b""
        self._number = 0
        self._answers: dict[Any, Any] = {}
        self.events: dict[str, list[Any]] = {}
        self.said: list[Any] = [{"out": self._line()}]

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """Ask one thing and wait for the answer."""
        return self.wait(self.send(method, **params))

    def send(self, method: str, **params: Any) -> int:
        """Ask one thing; `wait` takes the number that is returned."""
        self._number += 1
        request = {"jsonrpc": "2.0", "id": self._number, "method": method, "params": params}
        self.said.append({"in": request, "number": self._number})
        self._socket.sendall(json.dumps(request).encode() + b"\n")
        return self._number

    def wait(self, number: int | None) -> dict[str, Any]:
        """The answer to a question; None: one without a number, as to what cannot be read."""
        while number not in self._answers:
            self._take(self._line())
        answer: dict[str, Any] = self._answers.pop(number)
        if number is None:
            self.said.append({"out": answer})
            return answer
        place = next(k for k, one in enumerate(self.said) if one.get("number") == number)
        self.said[place] = {"in": self.said[place]["in"], "out": answer}
        return answer

    def write(self, line: bytes) -> dict[str, Any]:
        """Send a line as it is, and wait for an answer without a number."""
        self.said.append({"in": line.decode(errors="replace")})
        self._socket.sendall(line + b"\n")
        return self.wait(None)

    def wait_for(self, job: str, *types: str) -> Any:
        """The next event of a job of one of these types, after those that were waited for."""
        for event in self.events.get(job, []):
            if event["type"] in types and not event.get("met"):
                event["met"] = True
                return event
        while True:
            event = self._take(self._line())
            if event is not None and event["job"] == job and event["type"] in types:
                event["met"] = True
                return event

    def close(self) -> None:
        """Part from the daemon."""
        self._socket.close()

    def told(self) -> dict[str, Any]:
        """The transcript: jobs by the order in which they came."""
        events = [
            [{k: v for k, v in event.items() if k != "met"} for event in some]
            for some in self.events.values()
        ]
        return {"said": self.said, "events": events}

    def _take(self, message: Any) -> Any:
        """Sort in one line; the event that it is, or None."""
        if message is None:
            raise ConnectionError("the daemon has parted from us")
        if message.get("method") != "event":
            self._answers[message.get("id")] = message
            return None
        event = message["params"]
        if event["type"] in THINNED:
            return None
        self.events.setdefault(event["job"], []).append(event)
        return event

    def _line(self) -> Any:
        while b"\n" not in self._rest:
            data = self._socket.recv(1 << 16)
            if not data:
                return None
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return json.loads(line)


@contextmanager
def daemon(folder: Path, config: str) -> Iterator[tuple[Path, list[int]]]:
    """A daemon of a configuration in a folder: its socket, and its exit code once it has ended."""
    path = folder / "s"
    command = [sys.executable, "-m", "pdcd", "serve", "--config", config, "--socket", str(path)]
    codes: list[int] = []
    with (folder / "daemon.log").open("wb") as log:
        with subprocess.Popen(command, cwd=folder, stdout=log, stderr=log) as process:
            try:
                _wait_until_ready(path, process)
                yield path, codes
            finally:
                process.send_signal(signal.SIGTERM)
                codes.append(process.wait(PATIENCE_S))


def _wait_until_ready(path: Path, process: subprocess.Popen[bytes]) -> None:
    give_up_s = time.monotonic() + PATIENCE_S
    while process.poll() is None and time.monotonic() < give_up_s:
        try:
            Talk(path).close()
            return
        except OSError:
            time.sleep(0.02)
    raise RuntimeError(f"the daemon did not start: {(path.parent / 'daemon.log').read_text()}")
