"""A page whose live picture is open all through a soak, with the requests that a browser makes.

The server of the page is a process of its own and outlives daemons; what happens on the bench is
followed all the while, as every page does. The picture is a stream's, which holds the rig: it is
closed before a photo, which tells whether it stopped, and opened again after it.
"""

from __future__ import annotations

import http.client
import json
import select
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from urllib.parse import urlsplit

from tests.soak import processes
from tests.soak.tally import Tally

REQUEST = {"goal": "indirect", "codes": 8, "window": "whole", "rate_hz": 30.0}
STOP_S = 2.0
"""How long the rig may be held after its stream was closed, on a machine that is this busy."""
_ANSWER_S, _START_S = 60.0, 60.0


class LivePage:
    """The server of a page, and its visitor; a context manager that ends both."""

    def __init__(self, socket: Path, state: Path, tally: Tally) -> None:
        """Raises RuntimeError where it does not start."""
        command = [sys.executable, "-m", "pdcd", "web", "--socket", str(socket)]
        self._server = subprocess.Popen(
            [*command, "--state-dir", str(state), "--port", "0"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self._server.stdout is not None
        if not select.select([self._server.stdout], [], [], _START_S)[0]:
            raise RuntimeError("the page did not start")
        address = urlsplit(self._server.stdout.readline().strip())
        self._host, self._token = address.netloc, address.fragment
        self._tally, self._over = tally, threading.Event()
        self._stream: http.client.HTTPResponse | None = None
        self._connection: http.client.HTTPConnection | None = None
        self._follower = threading.Thread(target=self._follow, daemon=True)
        self._follower.start()
        self._first_mib = 0.0
        self.trouble = ""
        """What the server or the stream said last of why there is no picture."""

    def __enter__(self) -> LivePage:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close_picture()
        self._over.set()
        self._tally.page_mib.append((self._first_mib, processes.rss_mib(self._server.pid)))
        self._server.terminate()
        self._server.wait(30.0)
        self._follower.join(30.0)

    def watch_picture(self, pictures: int) -> bool:
        """Open the live picture, and see so many pictures, unless somebody else has the rig; it
        stays open. Whether there was one."""
        self.close_picture()
        seen, self.trouble = 0, ""
        try:
            self._connection, self._stream = self._ask("POST", "/stream", json.dumps(REQUEST))
            while self._stream.status == 200 and seen < pictures:
                line = self._stream.readline()
                if not line:
                    break
                if line.startswith(b"data:"):
                    told = json.loads(line[5:])
                    self.trouble = str(told.get("error") or self.trouble)
                    self._tally.spoilt += bool(told.get("spoilt"))
                    seen += bool(told.get("jpeg"))
            if self._stream.status != 200:
                self.trouble = self._stream.read().decode()
        except (OSError, http.client.HTTPException) as err:
            self.trouble = f"{type(err).__name__}: {err}"
        self._tally.live_pictures += seen
        if not seen:
            self.close_picture()
        elif not self._first_mib:
            self._first_mib = processes.rss_mib(self._server.pid)
        return bool(seen)

    def close_picture(self) -> bool:
        """Close the live picture, as a page does that is left or whose Stop is pressed; whether it
        was open."""
        connection, self._connection, self._stream = self._connection, None, None
        if connection is not None:
            connection.close()
        return connection is not None

    def _ask(
        self, method: str, path: str, body: str | None = None
    ) -> tuple[http.client.HTTPConnection, http.client.HTTPResponse]:
        connection = http.client.HTTPConnection(self._host, timeout=_ANSWER_S)
        headers = {"Authorization": f"Bearer {self._token}"}
        if body is not None:
            headers["Content-Type"] = "application/json"
        connection.request(method, path, body, headers)
        return connection, connection.getresponse()

    def _follow(self) -> None:
        """Hear what happens on the bench, all the while."""
        while not self._over.is_set():
            with suppress(OSError, http.client.HTTPException):
                connection, events = self._ask("GET", "/events")
                while not self._over.is_set() and events.readline():
                    pass
                connection.close()
            self._over.wait(0.1)
