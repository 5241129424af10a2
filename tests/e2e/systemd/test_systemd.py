"""The units: accepted by systemd, tight, and in agreement with the program."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.guarding import TRY_S
from tests.places import ROOT
from tests.tools import needs, program

UNITS = ROOT / "systemd"
PROGRAM = "/opt/pdcd/.venv/bin/pdcd"
X_SERVER = "/usr/lib/xorg/Xorg"

analyze = needs("systemd-analyze")


def unit(name: str) -> dict[str, dict[str, list[str]]]:
    """Section -> key -> all values of a unit file."""
    found: dict[str, dict[str, list[str]]] = {}
    section = ""
    for line in (UNITS / name).read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            section = line.strip("[]")
        elif line and not line.startswith("#"):
            key, _, value = line.partition("=")
            found.setdefault(section, {}).setdefault(key, []).append(value)
    return found


@pytest.fixture
def copies(tmp_path: Path) -> Path:
    """The units with a program that exists on this machine."""
    for name in ("pdcd.service", "pdcd.socket", "pdcd-x.service"):
        text = (UNITS / name).read_text(encoding="utf-8")
        for absent in (PROGRAM, X_SERVER):
            text = text.replace(absent, sys.executable)
        (tmp_path / name).write_text(text, encoding="utf-8")
    shutil.copytree(UNITS / "pdcd.service.d", tmp_path / "pdcd.service.d")
    return tmp_path


def systemd_analyze(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [program("systemd-analyze"), "--no-pager", *words],
        capture_output=True,
        text=True,
        timeout=30,
    )


@analyze
def test_the_units_are_accepted(copies: Path) -> None:
    names = ("pdcd.service", "pdcd.socket", "pdcd-x.service")
    done = systemd_analyze("verify", *(str(copies / name) for name in names))
    assert done.returncode == 0, done.stderr
    assert "pdcd" not in done.stderr
    service = copies / "pdcd.service"  # a misspelt directive would be noticed
    service.write_text(service.read_text().replace("WatchdogSec", "WatchdogSecs"))
    assert "WatchdogSecs" in systemd_analyze("verify", str(service)).stderr


@analyze
def test_the_daemon_with_panels_is_accepted(copies: Path) -> None:
    """With the drop-in, a misspelt directive of which is noticed too."""
    words = ("verify", str(copies / "pdcd.service"))
    drop_in = copies / "pdcd.service.d" / "x.conf"
    assert systemd_analyze(*words).stderr == ""
    drop_in.write_text(drop_in.read_text().replace("LimitMEMLOCK", "LimitMEMLOCKS"))
    assert "LimitMEMLOCKS" in systemd_analyze(*words).stderr


@analyze
def test_the_service_stays_as_tight_as_it_is(copies: Path) -> None:
    words = ("security", "--offline=true", str(copies / "pdcd.service"))
    done = systemd_analyze(*words, "--threshold=14")
    assert done.returncode == 0, done.stdout
    assert systemd_analyze(*words, "--threshold=1").returncode != 0


@needs("systemd-sysusers")
def test_the_user_can_be_made() -> None:
    done = subprocess.run(
        [program("systemd-sysusers"), "--dry-run", str(UNITS / "pdcd.sysusers.conf")],
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert done.returncode == 0, done.stderr
    assert "pdcd" in done.stdout + done.stderr


def test_the_program_is_the_console_script_of_the_package() -> None:
    (command,) = unit("pdcd.service")["Service"]["ExecStart"]
    program, verb = command.split()
    assert (program, verb) == (PROGRAM, "serve")
    scripts = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert re.search(r'^pdcd = "pdcd\.cli\.main:main"$', scripts, re.MULTILINE)


def test_what_the_daemon_counts_on_is_set() -> None:
    service = unit("pdcd.service")["Service"]
    assert service["Type"] == ["notify"]
    assert service["KillMode"] == ["control-group"]  # with time for the guardians
    # Guardians are deaf to it, and to nothing that ends a daemon more surely.
    assert service["FinalKillSignal"] == ["SIGABRT"] and "WatchdogSignal" not in service
    # A camera is tried for so long.
    assert int(service["TimeoutStopSec"][0]) > TRY_S
    for key in ("RuntimeDirectory", "StateDirectory", "ConfigurationDirectory", "User", "Group"):
        assert service[key] == ["pdcd"], key
    assert service["RestartPreventExitStatus"] == ["2"]
    assert "AF_NETLINK" in service["RestrictAddressFamilies"][0].split()
    assert "MemoryDenyWriteExecute" not in service
    socket = unit("pdcd.socket")["Socket"]
    # Where `pdcd.bench.folders.find_socket_path` looks: beside the runtime folder.
    assert socket["ListenStream"] == ["%t/pdcd.sock"]
    assert (socket["SocketMode"], socket["SocketGroup"]) == (["0660"], ["pdcd"])
    assert socket["Accept"] == ["no"]


def test_every_drop_in_of_the_readme_is_well_formed() -> None:
    text = (UNITS / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```ini\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 4
    for block in blocks:
        parser = configparser.ConfigParser(strict=False)
        parser.read_string(block)
        assert set(parser.sections()) <= {"Unit", "Service", "Socket"}


def test_what_the_service_may_take_is_bounded() -> None:
    service = unit("pdcd.service")["Service"]
    assert service["MemoryMax"] == ["6G"] and service["TasksMax"] == ["512"]
    assert service["OOMPolicy"] == ["continue"]  # the daemon closes the shutter of a lost job
    assert int(service["OOMScoreAdjust"][0]) < 0
    assert service["LimitCORE"] == ["0"]


def test_serial_ports_of_every_kind_are_allowed() -> None:
    allowed = unit("pdcd.service")["Service"]["DeviceAllow"]
    for kind in ("ttyUSB", "ttyACM", "ttyS"):
        assert f"char-{kind} rw" in allowed
