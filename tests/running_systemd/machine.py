"""A machine of its own whose first process is systemd, by systemd-nspawn, with pdcd installed as
systemd/README.md says.

Its root is a bare folder. `/usr` is this machine's, read-only, and so are the source tree and the
packages of the virtual environment that runs the tests: `/opt/pdcd/.venv` is made of them. What has
no mount in it (users, units, configuration, results) is its own and goes with it.
"""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from tests.places import ROOT
from tests.tools import program

BOOT_S = 60.0
SLOW_S = 120.0
"""Bound of whatever is waited for on a loaded machine."""

PDCD = "/opt/pdcd/.venv/bin/pdcd"
TREE = "/opt/pdcd/tree"
"""The source tree, as the machine sees it."""
UNITS = ROOT / "systemd"
_PATH = "/opt/pdcd/.venv/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin"
_CONTROLLERS = ("memory", "pids", "devices")

_SCRIPT = """#!/opt/pdcd/.venv/bin/python
import sys
from pdcd.cli.main import main
sys.exit(main())
"""


@dataclass(frozen=True)
class Machine:
    """A running one. `leader` is its first process, by the number that it has out here."""

    leader: int
    root: Path

    def inside(self, path: str) -> Path:
        """A path of the machine, its mounts included, as a path of this one."""
        return Path(f"/proc/{self.leader}/root") / path.lstrip("/")

    def command(self, *words: str) -> list[str]:
        """The command line that runs these words in there as root."""
        enter = ["nsenter", "--all", "--target", str(self.leader)]
        return [*enter, "/usr/bin/env", "-i", f"PATH={_PATH}", "LANG=C.UTF-8", *words]

    def run(self, *words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        """Run a command in there to its end."""
        done = subprocess.run(
            self.command(*words), capture_output=True, text=True, timeout=SLOW_S, check=False
        )
        if check and done.returncode:
            raise AssertionError(f"{shlex.join(words)}: {done.returncode}\n{done.stderr}")
        return done

    def systemctl(self, *words: str) -> str:
        """What systemctl prints."""
        return self.run("systemctl", *words).stdout.strip()

    def shows(self, what: str, unit: str = "pdcd.service") -> str:
        """A property of a unit."""
        return self.systemctl("show", "--value", "--property", what, unit)

    def write(self, path: str, text: str) -> None:
        """Make a file in there."""
        file = self.root / path.lstrip("/")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")

    def journal(self, *words: str) -> str:
        """The messages of the daemon's unit, one on a line, without names and times."""
        return self.run("journalctl", "-u", "pdcd", "-o", "cat", "--no-pager", *words).stdout

    def journal_json(self, *words: str) -> list[dict[str, str]]:
        """The entries of the journal that match, oldest first."""
        out = self.run("journalctl", "-o", "json", "--no-pager", *words).stdout
        return [json.loads(line) for line in out.splitlines()]

    def main_pid(self) -> str:
        """Process of the daemon, by the number it has in there."""
        return self.shows("MainPID")


def wait_until(true: Callable[[], bool], what: str, bound_s: float = SLOW_S) -> None:
    """Return when it is true; fail when it does not become so."""
    give_up_s = time.monotonic() + bound_s
    while not true():
        assert time.monotonic() < give_up_s, f"not within {bound_s:g} s: {what}"
        time.sleep(0.02)


@contextmanager
def booted(folder: Path) -> Iterator[Machine]:
    """A machine whose root is made in that folder; it is gone on leaving."""
    root = folder / "root"
    groups = _make_groups()
    binds = _make_root(root)
    words = [
        program("systemd-nspawn"),
        "-q",
        "-D",
        str(root),
        *binds,
        "-b",
        "--register=no",
        "--keep-unit",
    ]
    words += ["--link-journal=no", "--console=pipe", "systemd.unit=basic.target"]
    console = folder / "console"
    with console.open("wb") as out:
        process = subprocess.Popen(
            # It must not outlive a test run that was killed.
            [program("setpriv"), "--pdeathsig", "TERM", *_into(groups), *words],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=out,
        )
    try:
        wait_until(
            lambda: bool(_leader(process)) or process.poll() is not None, "first process", BOOT_S
        )
        assert process.poll() is None, console.read_text(errors="replace")
        machine = Machine(_leader(process), root)
        wait_until(lambda: _is_up(machine), f"boot, see {console}", BOOT_S)
        _take_over_controllers(machine)
        yield machine
    finally:
        process.send_signal(signal.SIGTERM)  # which nspawn passes on as an order to power off
        try:
            process.wait(BOOT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for group in groups:
            for name, _, _ in os.walk(group, topdown=False):
                with suppress(OSError):  # one that somebody has entered meanwhile
                    Path(name).rmdir()


def _make_root(root: Path) -> list[str]:
    """The root folder; returns what is to be mounted in it."""
    for name in ("etc", "var", "opt/pdcd/tree", "opt/pdcd/deps", "opt/pdcd/extra", "usr", "root"):
        (root / name).mkdir(parents=True, exist_ok=True)
    root.chmod(0o755)
    for name in ("bin", "sbin", "lib", "lib64"):
        (root / name).symlink_to(f"usr/{name}")
    for name in ("os-release", "passwd", "group", "ld.so.cache", "nsswitch.conf"):
        with suppress(FileNotFoundError):
            (root / "etc" / name).write_bytes((Path("/etc") / name).read_bytes())
    (root / "etc" / "machine-id").touch()
    _say_which_systemd(root)
    binds = ["--bind-ro=/usr", f"--bind-ro={ROOT}:{TREE}"]
    site = Path(sysconfig.get_path("purelib"))
    binds.append(f"--bind-ro={site}:/opt/pdcd/deps")
    base = Path(sys.base_prefix)
    if not base.is_relative_to("/usr"):  # which is there; and homes are hidden from the service
        (root / "opt/python").mkdir()
        (root / "etc/ld.so.conf").write_text("/opt/python/lib\n")
        binds.append(f"--bind-ro={base}:/opt/python")
        base = Path("/opt/python")
    _make_environment(root / "opt/pdcd/.venv", base)
    return binds


def _say_which_systemd(root: Path) -> None:
    """nspawn gives control groups of the second version, which alone tell systemd when a service is
    empty, only to a systemd new enough; it looks for it by name, before `/usr` is mounted."""
    for library in Path("/usr/lib").glob("**/systemd/libsystemd-shared-*.so"):
        name = root / "usr/lib/systemd" / library.name
        name.parent.mkdir(parents=True, exist_ok=True)
        name.touch()


def _make_environment(venv: Path, base: Path) -> None:
    """A virtual environment of the mounted folders, in place of `pip install`."""
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    (venv / "bin").mkdir(parents=True)
    (venv / "bin/python").symlink_to(base / "bin" / version)
    (venv / "pyvenv.cfg").write_text(f"home = {base}/bin\ninclude-system-site-packages = false\n")
    packages = venv / "lib" / version / "site-packages"
    packages.mkdir(parents=True)
    (packages / "pdcd.pth").write_text(f"{TREE}\n/opt/pdcd/extra\n/opt/pdcd/deps\n")
    script = venv / "bin/pdcd"
    script.write_text(_SCRIPT)
    script.chmod(0o755)


def _leader(nspawn: subprocess.Popen[bytes]) -> int:
    """The machine's first process; 0 while there is none."""
    for status in Path("/proc").glob("[0-9]*/status"):
        with suppress(OSError):  # it has ended meanwhile
            lines = dict(
                line.split(":\t", 1) for line in status.read_text().splitlines() if ":\t" in line
            )
            first = lines["NSpid"].split()[1:] == ["1"]
            if first and int(lines["PPid"]) == nspawn.pid and lines["Name"].strip() == "systemd":
                return int(status.parent.name)
    return 0


def _is_up(machine: Machine) -> bool:
    return machine.run("systemctl", "is-active", "basic.target", check=False).returncode == 0


def _take_over_controllers(machine: Machine) -> None:
    """Where this machine has the first version of control groups, nspawn mounts the controllers
    read-only, and limits would not hold; with the second version there is nothing to do."""
    machine.run("ldconfig")
    if not machine.inside("/sys/fs/cgroup/memory").is_dir():
        return
    for name in _CONTROLLERS:
        machine.run("mount", "-o", "remount,bind,rw", f"/sys/fs/cgroup/{name}", check=False)
    machine.run("systemctl", "daemon-reexec")
    wait_until(lambda: _is_up(machine), "systemd, executed anew", BOOT_S)


def _make_groups() -> list[Path]:
    """A control group of the machine's own in each hierarchy of the first version, so that nothing
    of it is left in ours. With the second version alone nspawn makes its own."""
    made = []
    for line in Path("/proc/self/cgroup").read_text().splitlines():
        _, controllers, path = line.split(":", 2)
        name = controllers.removeprefix("name=") or "unified"
        top = Path("/sys/fs/cgroup") / name
        if name in ("unified", "systemd", *_CONTROLLERS) and top.is_dir():
            group = top / path.lstrip("/") / f"pdcd-test-{os.getpid()}"
            group.mkdir()
            made.append(group)
    return made


def _into(groups: list[Path]) -> list[str]:
    """A prefix of a command line that enters these groups first."""
    files = [str(group / "cgroup.procs") for group in groups]
    return ["sh", "-c", 'while [ "$1" != -- ]; do echo $$ >"$1"; shift; done; shift; exec "$@"',
            "enter", *files, "--"]  # fmt: skip
