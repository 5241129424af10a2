"""Runs are read where Linux is not, and just as critically; what needs Linux says so."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import pdcd
from pdcd.cli.main import main
from pdcd.runs.verify import verify_run
from tests.places import ROOT
from tests.tampered import TAMPERINGS

pytestmark = pytest.mark.whole

OPENED = """
import sys
from tests.elsewhere import leave_linux
leave_linux()
import numpy as np
import pdcd
run = pdcd.open(sys.argv[1])
np.savez(sys.argv[2], image=run.image, sigma=run.sigma, codes=run.codes["coded"].projector,
         row=run.row(2, 3).realised, **run.pictures)
for get in (pdcd.local, pdcd.connect):
    try:
        get()
    except pdcd.errors.ConfigError as err:
        assert "Linux" in err.message and err.hint, err
    else:
        raise AssertionError("that is not to be had here")
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> pdcd.Run:
    small = {"scene": {"kind": "wax-disk", "grid": [6, 8]}}
    with pdcd.local(small, folder=tmp_path_factory.mktemp("runs")) as bench:
        return bench.capture("indirect", codes=8)


def there(*words: str | Path, inside: Sequence[str] = ("-m", "tests.elsewhere")) -> tuple[int, str]:
    """Exit code and output of a command, or of a program, on the other system."""
    done = subprocess.run(
        [sys.executable, *inside, *map(str, words)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done.returncode, done.stdout + done.stderr


def test_a_run_is_opened_with_the_same_numbers(run: pdcd.Run, tmp_path: Path) -> None:
    code, said = there(run.folder, tmp_path / "read.npz", inside=("-c", OPENED))
    assert code == 0, said
    with np.load(tmp_path / "read.npz") as found:
        np.testing.assert_array_equal(found["image"], run.image)
        np.testing.assert_array_equal(found["sigma"], run.sigma)
        np.testing.assert_array_equal(found["codes"], run.codes["coded"].projector)
        np.testing.assert_array_equal(found["row"], run.row(2, 3).realised)
        for name, picture in run.pictures.items():
            np.testing.assert_array_equal(found[name], picture)


@pytest.mark.parametrize("form", ["exr", "tiff16"])
def test_what_is_exported_is_the_same(run: pdcd.Run, tmp_path: Path, form: str) -> None:
    words = ("export", str(run.folder), "--format", form, "--out")
    assert main([*words, str(tmp_path / "here")]) == 0
    code, said = there(*words, tmp_path / "there")
    assert code == 0, said
    here = sorted((tmp_path / "here").iterdir())
    assert here and [file.name for file in here] == sorted(
        file.name for file in (tmp_path / "there").iterdir()
    )
    for file in here:
        assert file.read_bytes() == (tmp_path / "there" / file.name).read_bytes()
    code, said = there(*words, tmp_path / "there")
    assert code == 2 and "is there already" in said


def test_it_is_verified_reported_and_decoded_and_listed(run: pdcd.Run, tmp_path: Path) -> None:
    code, said = there("verify", run.folder)
    assert code == 0 and said.startswith("whole")
    code, said = there("report", run.folder, "--out", tmp_path / "page.html")
    assert code == 0 and (tmp_path / "page.html").stat().st_size > 10_000
    code, said = there("decode", run.folder)
    assert code == 0 and "identical" in said and "differs" not in said
    code, said = there("runs", "--state-dir", run.folder.parent, "--json")
    assert code == 0 and json.loads(said.splitlines()[0])["job"] == run.job


def test_what_was_tampered_with_is_found_as_on_linux(run: pdcd.Run, tmp_path: Path) -> None:
    spoilt = []
    for tampering in TAMPERINGS:
        spoilt.append(tmp_path / str(tampering).replace(" ", "-") / run.job)
        shutil.copytree(run.folder, spoilt[-1])
        tampering.spoil(spoilt[-1])
    # By its own folder a link leads out of a run, and is to be followed as little as in Linux.
    spoilt.append(tmp_path / "linked" / run.job)
    shutil.copytree(run.folder, spoilt[-1])
    shutil.move(spoilt[-1] / "raw", tmp_path / "raw")
    (spoilt[-1] / "raw").symlink_to(tmp_path / "raw")
    code, said = there("verify", "--json", *spoilt)
    found = [json.loads(line) for line in said.splitlines()]
    assert code == 5 and len(found) == len(spoilt)
    for folder, report in zip(spoilt, found, strict=True):
        here = verify_run(folder)
        assert not report["whole"], folder
        assert [each["path"] for each in report["findings"]] == [f.path for f in here.findings]


@pytest.mark.parametrize(
    "words",
    [
        ("capture", "indirect", "--local"),
        ("status",),
        ("decode", "nowhere", "--partial"),
        ("runs", "prune", "--failed"),
    ],
)
def test_what_needs_linux_says_so_and_what_to_do(words: tuple[str, ...]) -> None:
    code, said = there(*words)
    assert code == 2 and "needs Linux" in said and "bench's computer" in said
