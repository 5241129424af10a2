"""One machine for all tests here; each begins with a service that was never started."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest

from tests.running_systemd.machine import UNITS, Machine, booted
from tests.running_systemd.service import CAPTURE_TOML, Line, Service
from tests.tools import missing, say_why_no_container


def why_not() -> str:
    """Why no machine can be had here; "" where one can."""
    if why := say_why_no_container():
        return f"{why}, nothing is tested under a running systemd"
    if gone := missing("systemd-nspawn", "nsenter", "setpriv"):
        return f"nothing is tested under a running systemd: {gone}"
    return ""


@pytest.fixture(scope="session")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """Booted once; installed as the README says, under the users that it says."""
    if why := why_not():
        pytest.skip(why)
    with booted(tmp_path_factory.mktemp("machine")) as found:
        _install(found)
        yield found


def _install(machine: Machine) -> None:
    units = machine.root / "etc/systemd/system"
    units.mkdir(parents=True, exist_ok=True)
    for name in ("pdcd.service", "pdcd.socket", "pdcd-x.service"):
        shutil.copy(UNITS / name, units)
    sysusers = machine.root / "etc/sysusers.d"
    sysusers.mkdir(exist_ok=True)
    shutil.copy(UNITS / "pdcd.sysusers.conf", sysusers / "pdcd.conf")
    machine.run("systemd-sysusers")
    for user, groups in (("inside", "pdcd"), ("outside", "users")):
        machine.run("useradd", "--create-home", "--user-group", "--groups", groups, user)


@pytest.fixture
def service(machine: Machine) -> Iterator[Service]:
    """The socket listens, the service is not started, no results, the mock bench in real time."""
    fresh = Service(machine)
    fresh.reset()
    fresh.configure(CAPTURE_TOML)
    machine.systemctl("start", "pdcd.socket")
    yield fresh
    fresh.reset()


@pytest.fixture
def line(machine: Machine) -> Iterator[Line]:
    """The far end of a serial line in the machine."""
    found = Line(machine)
    yield found
    found.close()
