"""The wheel, installed where nothing else is: it works, and takes no name that others may have."""

from __future__ import annotations

import json
import re
import sysconfig
import zipfile
from pathlib import Path

import pytest

from pdcd.bench.registry import DRIVERS
from pdcd.version import __version__
from tests.places import ROOT
from tests.tools import find
from tests.wheels import find_base_python, install_wheel, make_distribution, run

pytestmark = pytest.mark.long

BENCH = """
[camera]
driver = "ptp"
f_number = 8.0
[camera.options]
usb = "virtual"
[trigger]
driver = "ptp"
[scene]
grid = [6, 8]
"""
"""A virtual camera at the end of the USB: its shutter has a guardian, which is started by name."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_distribution("wheel", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def pdcd(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The command of an environment that has the wheel, what it needs, and somebody's `drivers`."""
    folder = tmp_path_factory.mktemp("bare")
    if find_base_python() is None:
        pytest.skip("no pip to install a wheel with")
    packages = install_wheel(wheel, folder)
    assert not (packages / "drivers").exists()
    (packages / "drivers").mkdir()
    (packages / "drivers" / "__init__.py").write_text("raise RuntimeError('of somebody else')")
    # What pdcd needs; a checkout that is installed there by a .pth of its own is not found so.
    (packages / "needs.pth").write_text(sysconfig.get_path("purelib"))
    return folder / "env" / "bin" / "pdcd"


def test_it_holds_one_package_and_all_that_belongs_to_it(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.partition("/")[0] for name in names}
    assert tops == {"pdcd", f"primal_dual_coding-{__version__}.dist-info"}
    # In an archive of the sources there is no list of them; a clone has one.
    git = find("git").path
    if git and (ROOT / ".git").exists():
        kept = run(git, "ls-files", "pdcd", "drivers", "config", folder=ROOT).split()
        moved = {re.sub(r"^(drivers|config)/", r"pdcd/_\1/", name) for name in kept}
        assert moved <= set(names)
    assert not [name for name in names if name.endswith(".pyc")]


def test_it_works_beside_what_others_call_by_the_same_names(pdcd: Path, tmp_path: Path) -> None:
    for name in ("pdcd", "drivers"):  # where the user happens to be
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('of the user')")
    assert run(pdcd, "--version", folder=tmp_path) == f"pdcd {__version__}\n"
    found = json.loads(run(pdcd, "drivers", "--json", folder=tmp_path))
    own = [driver for driver in found if driver["origin"] == "pdcd"]
    assert {(driver["role"], driver["name"]) for driver in own} == set(DRIVERS)
    for driver in own:
        assert driver["target"].startswith("pdcd._drivers.")
        assert driver["available"] or driver["name"] == "gphoto2", driver
    run(pdcd, "demo", "--codes", "8", folder=tmp_path)
    (tmp_path / "ptp.toml").write_text(BENCH)
    words = ("--config", "ptp.toml", "--codes", "8", "--no-white", "--json")
    told = run(pdcd, "capture", "indirect", "--local", *words, folder=tmp_path)
    taken = json.loads(told.splitlines()[-1])
    assert taken["state"] == "done"
    listed = run(pdcd, "runs", "--json", folder=tmp_path)
    assert json.loads(listed)["job"] == taken["job"]
    run(pdcd, "runs", "verify", taken["job"], folder=tmp_path)
    run(pdcd, "config", "check", folder=tmp_path)
