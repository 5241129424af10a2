"""The wheel without extras, where only the packages are that it needs: it reads runs."""

from __future__ import annotations

import json
import shutil
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from pdcd.extras import BENCH
from pdcd.version import __version__
from tests.light import (
    GIVEN,
    MOST_BYTES,
    list_files,
    list_own_files,
    list_packages,
    weigh_bytes,
)
from tests.places import ROOT
from tests.wheels import find_base_python, install_wheel, make_distribution, run

pytestmark = pytest.mark.whole

READ = """
import sys
import pdcd
run = pdcd.open(sys.argv[1])
print(run.verdict, *run.image.shape, run.image.mean(), *sorted(run.pictures))
"""


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of an environment that has the wheel and what it asks for."""
    folder = tmp_path_factory.mktemp("light")
    if find_base_python() is None:
        pytest.skip("no pip to install a wheel with")
    wheel = make_distribution("wheel", folder)
    packages = install_wheel(wheel, folder)
    for file in list_files(list_packages()):
        # What lies at the top is all that is needed of a package, as a link.
        top = next(p for p in (file, *file.parents) if p.parent.name == "site-packages")
        if not (packages / top.name).exists():
            (packages / top.name).symlink_to(top)
    return folder / "env" / "bin"


def test_it_opens_verifies_reports_and_exports_a_run(light: Path, tmp_path: Path) -> None:
    pdcd, python = light / "pdcd", light / "python"
    shutil.copytree(ROOT / "examples" / "reference-run", tmp_path / "reference")
    expected = json.loads((tmp_path / "reference" / "expected.json").read_text())
    folder = str(tmp_path / "reference" / "run")
    told = run(python, "-c", READ, folder, folder=tmp_path).split()
    assert told[-3:] == ["direct", "indirect", "white"] and told[1:4] == ["12", "16", "1"]
    assert float(told[4]) == pytest.approx(expected["pictures"]["indirect"]["mean"], rel=1e-5)
    assert run(pdcd, "verify", folder, folder=tmp_path).startswith("whole")
    run(pdcd, "report", folder, "--out", "page.html", folder=tmp_path)
    assert "<html" in (tmp_path / "page.html").read_text()
    for form, start in {"exr": b"v/1\x01", "tiff16": b"II*\0"}.items():
        run(pdcd, "export", folder, "--format", form, "--out", form, folder=tmp_path)
        files = sorted((tmp_path / form).iterdir())
        assert len(files) == 3 and all(f.read_bytes().startswith(start) for f in files)
    assert "indirect" in run(pdcd, "decode", folder, folder=tmp_path)


@pytest.mark.parametrize(
    ("words", "package"),
    [
        (("init", "--yes"), "python-xlib"),
        (("doctor", "display"), "python-xlib"),
        (("capture", "white", "--local", "--config", "ptp.toml"), "pyusb"),
    ],
)
def test_what_needs_a_bench_says_which_extra(
    light: Path, tmp_path: Path, words: tuple[str, ...], package: str
) -> None:
    for module in BENCH:
        assert run(light / "python", "-c", f"import {module}", folder=tmp_path, ends=1) == ""
    (tmp_path / "ptp.toml").write_text('[camera]\ndriver = "ptp"\n[trigger]\ndriver = "ptp"\n')
    said = run(light / "pdcd", *words, folder=tmp_path, ends=2)
    assert "Traceback" not in said
    assert "pip" in said and "install 'primal-dual-coding[bench]'" in said
    assert package in said


def test_it_weighs_little_beyond_what_does_the_arithmetic() -> None:
    names = list_packages()
    assert names.isdisjoint(BENCH.values()) and set(BENCH.values()) <= list_packages("bench")
    more = weigh_bytes(list_files(names - set(GIVEN))) + weigh_bytes(list_own_files())
    assert 10_000_000 < more < MOST_BYTES


def test_an_archive_of_the_sources_makes_the_same_wheel_and_runs_its_tests(tmp_path: Path) -> None:
    archive = make_distribution("sdist", tmp_path)
    with tarfile.open(archive) as packed:
        packed.extractall(tmp_path, filter="data")
    tree = tmp_path / f"primal_dual_coding-{__version__}"
    members = []
    for root in (ROOT, tree):
        out = tmp_path / f"of {root.name}"
        with zipfile.ZipFile(make_distribution("wheel", out, root)) as wheel:
            members.append({one.filename: one.CRC for one in wheel.infolist()})
    assert members[0] == members[1] and len(members[0]) > 500
    for name in (".ci/setup", "Makefile", "constraints.txt", "docs/install.md"):
        assert (tree / name).read_bytes() == (ROOT / name).read_bytes()
    # The quick tests of two rooms; `make test` there runs all of them.
    rooms = ("tests/unit/files", "tests/unit/test_extras.py")
    run(sys.executable, "-m", "pytest", "-q", "-n", "0", "-m", "not long and not whole", *rooms,
        folder=tree)  # fmt: skip
