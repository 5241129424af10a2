"""pdcd in the machine: its service, and the far end of the line that its shutter hangs on."""

from __future__ import annotations

import json
import select
import subprocess
from contextlib import suppress
from pathlib import Path

from pdcd.client import Client
from pdcd.protocol.events import Progress
from tests.real_daemon import connect
from tests.running_systemd.machine import PDCD, SLOW_S, Machine, wait_until

STATE = "/var/lib/pdcd"
DROP_IN = "/run/systemd/system/pdcd.service.d/test.conf"

CAPTURE_TOML = """
[rig]
clock = "real"
settle_s = 0.03
[camera]
noise = "none"
f_number = 8.0
[scene]
grid = [12, 16]
"""
LONG = {
    "goal": "indirect", "codes": 512, "white": False, "window": "whole", "pilot": 0, "parts": 1,
}  # fmt: skip
"""A capture whose first exposure is its long one."""

_FAR_END = """
import signal; signal.signal(signal.SIGPIPE, signal.SIG_DFL)
import fcntl, os, sys, termios, time, tty
near, far = os.openpty()
tty.setraw(far)
os.fchmod(far, 0o666)
print(os.ttyname(far), flush=True)
while True:
    data = os.read(near, 64)
    fcntl.ioctl(far, termios.TIOCNXCL)  # this end is open, too: let the port be opened anew
    for byte in data:
        print(time.monotonic(), chr(byte), flush=True)
"""


class Line:
    """A box on a terminal: "1" opens the shutter, "0" closes it. It writes down when."""

    def __init__(self, machine: Machine) -> None:
        self._process = subprocess.Popen(
            machine.command("/opt/pdcd/.venv/bin/python", "-c", _FAR_END),
            stdout=subprocess.PIPE,
            bufsize=0,  # so that `select` knows all that has come
        )
        self.port = self._read()

    @property
    def toml(self) -> str:
        """The shutter that hangs on it."""
        return (
            '[trigger]\ndriver = "serial"\nlag_s = 0.001\njitter_s = 0.0\n[trigger.options]\n'
            f'port = "{self.port}"\nrelease = "command"\nopen_hex = "31"\nclose_hex = "30"\n'
        )

    def hears(self, words: str) -> float:
        """Wait for the next bytes, which must be these; returns when the last came (s, of the
        monotonic clock, which machine and tests share)."""
        at_s = 0.0
        for word in words:
            at, heard = self._read().split()
            at_s = float(at)
            assert heard == word
        return at_s

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()

    def _read(self) -> str:
        assert self._process.stdout is not None
        assert select.select([self._process.stdout], [], [], SLOW_S)[0], "the line is silent"
        return self._process.stdout.readline().decode().strip()


class Service:
    """The units, the configuration, and a way in."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine

    def configure(self, toml: str) -> None:
        """Put the configuration in its place."""
        self.machine.write("/etc/pdcd/pdcd.toml", toml)

    def drop_in(self, *lines: str) -> None:
        """Add directives to [Service]; call it before the service starts."""
        path = self.machine.inside(DROP_IN)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(["[Service]", *lines, ""]), encoding="utf-8")
        self.machine.systemctl("daemon-reload")

    def reset(self) -> None:
        """Stop all, and leave nothing of it but the journal."""
        run = self.machine.run
        run("systemctl", "stop", "pdcd.socket", "pdcd.service", "pdcd-x.service", check=False)
        run("systemctl", "reset-failed", check=False)
        run("umount", STATE, check=False)
        run("rm", "-rf", STATE, "/var/cache/pdcd", "/run/systemd/system/pdcd.service.d")
        run("systemctl", "daemon-reload")

    def connect(self) -> Client:
        """A client of root's, from out here; starts the service if it does not run."""
        socket = self.machine.inside("/run/pdcd.sock")
        return connect(socket, say_why=lambda: self.machine.journal("-n", "20"), timeout_s=60.0)

    def in_exposure(self, client: Client) -> str:
        """Start a long capture; returns its job once codes are on the panels."""
        # Subscribed first: a display may tell of its first code once, and never again.
        client.call("events.subscribe", {"jobs": "all"})
        job = str(client.call("capture.start", LONG)["job"])
        for event in client.events():
            if isinstance(event, Progress) and event.frame > 0:
                return job
        raise AssertionError(f"no code was shown:\n{self.machine.journal('-n', '30')}")

    def captures(self) -> list[Path]:
        """The run folders, finished or not, as paths out here."""
        return sorted(self.machine.inside(f"{STATE}/captures").iterdir())

    def last_event(self, job: str) -> dict[str, object]:
        """What the log of a job that was given up says in the end."""
        log = self.machine.inside(f"{STATE}/captures/{job}.partial/log.jsonl")
        last: dict[str, object] = json.loads(log.read_text().splitlines()[-1])
        return last

    def cli(self, user: str, *words: str) -> subprocess.CompletedProcess[str]:
        """The command line of a user of the machine."""
        return self.run_as(user, PDCD, *words)

    def run_as(self, user: str, *words: str) -> subprocess.CompletedProcess[str]:
        """A command of a user of the machine, who has the groups of one who has logged in."""
        become = ("setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups", "--")
        return self.machine.run(*become, *words, check=False)

    def said_at_s(self, text: str) -> float:
        """When systemd last said that of the service (s, monotonic clock). It says it soon."""

        def entries() -> list[dict[str, str]]:
            out = self.machine.journal_json("_PID=1", "UNIT=pdcd.service")
            return [entry for entry in out if text in entry["MESSAGE"]]

        wait_until(lambda: bool(entries()), text)
        return int(entries()[-1]["__MONOTONIC_TIMESTAMP"]) * 1e-6

    def guardians(self) -> list[int]:
        """Guardians of the service, by the process numbers that they have in there."""
        out = self.machine.run("pgrep", "-f", "serial_shutter/guardian.py", check=False).stdout
        return [int(line) for line in out.split()]


def forget(client: Client) -> None:
    """Close a client whose daemon may be gone."""
    with suppress(OSError):
        client.close()
