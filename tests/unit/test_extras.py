"""What is said where a package is missing: a line that works, wherever pdcd runs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from pdcd import extras
from pdcd.errors import DriverUnavailable
from pdcd.extras import BENCH, OPTIONAL, TARGETS, WITH_BENCH, require_bench, suggest_install
from tests.places import ROOT
from tests.wheels import find_base_python

OTHERS = re.compile(r"pip install ['\"]?pdcd|['\"`]pdcd\[|pdcd\[(?:dev|web|plots|cluster|gphoto2)")
"""Who follows that installs somebody else's program."""

TOLD = ("pdcd", "drivers", "docs", "examples", "systemd", "config", ".ci", "README.md", "Makefile",
        "pyproject.toml", "CITATION.cff")  # fmt: skip
NO_TEXT = (".png", ".jpg", ".pyc", ".npz", ".tif", ".dng")


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An environment that is none of a checkout's, with a pip of its own."""
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "an env"))
    monkeypatch.setattr(sys, "base_prefix", "/usr")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "an env/bin/python"))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    return tmp_path / "an env"


def without_pip(monkeypatch: pytest.MonkeyPatch, python3: str | None) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr(extras, "which", lambda name: python3)


def test_beside_a_checkout_make_does_it(
    elsewhere: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(extras, "SOURCE_ROOT", tmp_path)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / ".venv"))
    monkeypatch.chdir(tmp_path)
    assert "pip" in suggest_install("aiohttp"), "there is no Makefile"
    (tmp_path / "Makefile").write_text("# web: not yet\nnotebook:\n\ttrue\n")
    assert "pip" in suggest_install("aiohttp") and suggest_install("jupyterlab") == "make notebook"
    monkeypatch.chdir("/")
    assert suggest_install("jupyterlab") == f"make -C {tmp_path} notebook"
    monkeypatch.setattr(sys, "prefix", str(elsewhere))
    assert "pip" in suggest_install("jupyterlab"), "make would fill another environment"


def test_the_makefile_has_what_is_named() -> None:
    rules = (ROOT / "Makefile").read_text()
    for target in TARGETS.values():
        assert f"\n{target}:\n\t@.ci/setup {target}\n" in rules


def test_with_a_pip_of_its_own(elsewhere: Path) -> None:
    assert suggest_install("aiohttp") == f"'{elsewhere}/bin/python' -m pip install aiohttp"


def test_without_one_that_outside_does_it(elsewhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_pip(monkeypatch, "/usr/bin/python3")
    ends = f"-m pip --python '{elsewhere}/bin/python' install aiohttp"
    assert suggest_install("aiohttp") == f"python3 {ends}"
    # Active, it is python3 itself; nothing called so may be found, too.
    monkeypatch.setattr(sys, "_base_executable", "/opt/python")
    for found in (str(elsewhere / "bin/python3"), None):
        without_pip(monkeypatch, found)
        assert suggest_install("aiohttp") == f"/opt/python {ends}"


def test_every_package_that_may_be_missing_is_in_an_extra() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = project["optional-dependencies"]
    for ours in ("dev", "oracles"):  # the tests alone want these
        wanted.pop(ours)
    of_bench = {re.split(r"[><=]", line)[0] for line in wanted.pop("bench")}
    assert of_bench == set(BENCH.values()) and WITH_BENCH == f"{project['name']}[bench]"
    named = {re.split(r"[><=]", line)[0] for lines in wanted.values() for line in lines}
    assert named == set(OPTIONAL) and set(TARGETS) <= named


def test_who_lacks_what_a_bench_needs_is_told_which_and_how_to_get_it(elsewhere: Path) -> None:
    require_bench("json")  # which is no matter of extras
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("importlib.util.find_spec", lambda name: None if name == "usb" else object())
        with pytest.raises(DriverUnavailable, match="pyusb") as caught:
            require_bench("serial", "usb")
    assert caught.value.hint == (
        f"'{elsewhere}/bin/python' -m pip install 'primal-dual-coding[bench]'"
    )


@pytest.mark.long
@pytest.mark.parametrize("own_pip", [False, True])
def test_the_line_works_as_it_is_printed(tmp_path: Path, own_pip: bool) -> None:
    base = find_base_python()
    if base is None:
        pytest.skip("the Python outside of this environment has no pip")
    environment = tmp_path / "an env"
    words = [base, "-m", "venv", *([] if own_pip else ["--without-pip"]), str(environment)]
    subprocess.run(words, check=True)
    python = str(environment / "bin" / "python")
    wheel = tmp_path / "smallest-1-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("smallest.py", "")
        info = "smallest-1.dist-info"
        archive.writestr(f"{info}/METADATA", "Metadata-Version: 2.1\nName: smallest\nVersion: 1\n")
        archive.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n")
        archive.writestr(f"{info}/RECORD", "")
    environ = {**os.environ, "PYTHONPATH": str(ROOT), "PATH": f"{environment}/bin:/usr/bin:/bin"}
    say = f"from pdcd.extras import suggest_install; print(suggest_install({str(wheel)!r}))"
    told = subprocess.run([python, "-c", say], env=environ, capture_output=True, text=True)
    assert ("--python" in told.stdout) != own_pip, told.stderr
    environ.pop("PYTHONPATH")
    line = f"{told.stdout.strip()} --no-index --quiet"
    subprocess.run(line, shell=True, env=environ, check=True)
    subprocess.run([python, "-c", "import smallest"], env=environ, check=True)


def test_nothing_says_to_install_another_program() -> None:
    found = []
    for top in TOLD:
        files = [ROOT / top] if (ROOT / top).is_file() else sorted((ROOT / top).rglob("*"))
        for file in files:
            if file.suffix in NO_TEXT or not file.is_file():
                continue
            for line in file.read_text(encoding="utf-8").splitlines():
                if OTHERS.search(line):
                    found.append(f"{file.relative_to(ROOT)}: {line.strip()}")
    assert not found
