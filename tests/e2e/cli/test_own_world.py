"""The suite beside a daemon at every place where one is looked for, and calibrations of a bench.

Whoever runs the tests on the machine of a bench has these: they must neither be asked nor read.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from pdcd.bench.choosing import CALIBRATIONS_FOLDER
from pdcd.bench.config import find_config_file
from pdcd.bench.folders import find_socket_path, find_state_dir
from pdcd.bench.measured import apply_calibration
from pdcd.bench.tables import Config
from pdcd.client import Client
from tests import world
from tests.places import ROOT
from tests.real_daemon import connect
from tests.unit.bench._calibrations import entry, record, written

TESTS = (
    "tests/presenter/test_panels_cli.py::test_show_ends_by_itself_and_black[words1]",
    "tests/e2e/planning/test_prior_capture.py::test_command_line",
)
"""One asks the daemon for its panels, one takes a photo; both go by the defaults."""


@dataclass(frozen=True)
class Machine:
    """Somebody's machine with a bench: what tests find there that have no world of their own."""

    folder: Path

    @property
    def users(self) -> dict[str, str]:
        """The environment of a user who has no folders but a home."""
        return {"HOME": str(self.folder / "home"), "TMPDIR": str(self.folder / "tmp")}

    @property
    def desktop(self) -> dict[str, str]:
        """Of one with a session."""
        named = {"CONFIG_HOME": "config", "STATE_HOME": "state", "RUNTIME_DIR": "user"}
        return self.users | {f"XDG_{k}": str(self.folder / v) for k, v in named.items()}

    @property
    def service(self) -> dict[str, str]:
        """Of the service, as systemd sets it."""
        named = {"CONFIGURATION": "etc", "STATE": "lib", "RUNTIME": "run/pdcd"}
        return self.desktop | {f"{k}_DIRECTORY": str(self.folder / v) for k, v in named.items()}

    @property
    def log(self) -> Path:
        """What the daemon tells of who connects."""
        return self.folder / "log"

    def connections(self) -> int:
        """How many the daemon has had."""
        return self.log.read_text().count("accepted connection=")

    def files(self) -> set[Path]:
        """All but those in the folder for temporary ones."""
        tops = (p for p in self.folder.iterdir() if p.name not in ("tmp", "log"))
        return {path for top in tops for path in (top, *top.rglob("*"))}


@contextmanager
def living(variables: dict[str, str]) -> Iterator[None]:
    """This process as one of that machine."""
    with pytest.MonkeyPatch.context() as patch:
        for name in (*world.FOLDERS, *world.ABSENT):
            patch.delenv(name, raising=False)
        for name, value in variables.items():
            patch.setenv(name, value)
        patch.setattr(tempfile, "tempdir", None)
        yield


@pytest.fixture
def machine() -> Iterator[Machine]:
    # Short paths: sockets have names of 107 bytes at most.
    with tempfile.TemporaryDirectory() as made:
        found = Machine(Path(made))
        for name in ("home/.config/pdcd", "tmp", "config/pdcd", "etc", "user", "run/pdcd"):
            (found.folder / name).mkdir(parents=True)
        for name in ("home/.config/pdcd", "config/pdcd", "etc"):
            (found.folder / name / "pdcd.toml").write_text('[rig]\nnme = "refused"\n')
        # A mask beside the light: no photo comes out right by it.
        moved = record(measured={"mask.offset_px": entry((700.0, 500.0))})
        sockets = []
        for variables in (found.users, found.desktop, found.service):
            with living(variables):
                written(find_state_dir(Config()) / CALIBRATIONS_FOLDER / "moved", moved)
                sockets.append(find_socket_path(Config()))
        for link in sockets[:-1]:
            link.symlink_to(sockets[-1])
        with serving(found, sockets[-1]):
            yield found


@contextmanager
def serving(machine: Machine, socket: Path) -> Iterator[None]:
    """The machine's own daemon."""
    words = ["serve", "--config", str(ROOT / "config" / "mock.toml"), "--socket", str(socket)]
    words += ["--state-dir", str(machine.folder / "daemon")]
    command = [sys.executable, "-m", "pdcd", *words]
    with machine.log.open("wb") as log, subprocess.Popen(command, stderr=log) as process:
        try:
            connect(socket, lambda: process.poll() is None).close()
            yield
        finally:
            process.terminate()


def done(machine: Machine, *words: str) -> str:
    """What a Python program says that the owner of the machine starts."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTEST_", "PDCD_"))}
    for name in (*world.FOLDERS, *world.ABSENT):
        kept.pop(name, None)
    run = subprocess.run(
        [sys.executable, *words], cwd=ROOT, env=kept | machine.service, capture_output=True,
        text=True, timeout=170, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


@pytest.mark.long
def test_the_machine_of_the_tests_is_left_alone(machine: Machine) -> None:
    for variables in (machine.users, machine.desktop, machine.service):
        with living(variables):  # it is there to be found
            before = machine.connections()
            Client(find_socket_path(Config())).close()
            assert machine.connections() == before + 1
            assert str(find_config_file()).startswith(str(machine.folder))
            assert apply_calibration(Config()).mask.offset_px == (700.0, 500.0)
    asked, files = machine.connections(), machine.files()
    pytest_words = ("-m", "pytest", "-q", "-n", "1", "-p", "no:cacheprovider")
    told = done(machine, *pytest_words, "--basetemp", str(machine.folder / "tmp" / "t"), *TESTS)
    assert "2 passed" in told
    done(machine, "-m", "pdcd", "demo", "--codes", "8", "--out", str(machine.folder / "tmp" / "d"))
    assert machine.connections() == asked and machine.files() == files
