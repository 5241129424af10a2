"""Drivers of another package, which import from `pdcd.driver` alone, take a capture."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pdcd
from pdcd.bench import registry
from pdcd.runs.manifest import MANIFEST
from tests.places import ROOT

PACKAGE = ROOT / "tests" / "data" / "stranger_driver"

CONFIG = """
[projector]
size_px = [32, 24]

[mask]
size_px = [32, 24]

[display]
driver = "stranger"

[trigger]
driver = "stranger"

[camera]
driver = "stranger"
profile = "{profile}"
f_number = {f_number}

[schedule]
grid = [6, 8]
codes = 64

[server]
state_dir = "{state}"

[limits]
min_free_bytes = 0
"""


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A configuration of that bench, the package being where Python looks for packages."""
    monkeypatch.syspath_prepend(str(PACKAGE))
    file = tmp_path / "stranger.toml"
    profile = PACKAGE / "stranger_bench" / "sensor.toml"
    file.write_text(CONFIG.format(profile=profile, f_number=16.0, state=tmp_path / "state"))
    return file


def test_the_package_imports_from_the_one_module_only() -> None:
    for source in PACKAGE.rglob("*.py"):
        named = re.findall(r"^\s*(?:from|import) (pdcd[.\w]*)", source.read_text(), re.MULTILINE)
        assert set(named) == {"pdcd.driver"}


def test_its_drivers_are_found(config: Path) -> None:
    rows = {(row["role"], row["name"]): row for row in registry.describe_drivers()}
    for role in ("display", "shutter", "readout"):
        assert rows[role, "stranger"]["origin"] == "stranger-bench"
        assert rows[role, "stranger"]["available"], rows[role, "stranger"]["reason"]


def test_a_capture_with_all_three(config: Path, tmp_path: Path) -> None:
    with pdcd.local(config) as bench:
        white = bench.capture("white", out=tmp_path / "white")
        direct = bench.capture("direct", out=tmp_path / "direct")
    steps = np.repeat([0.2, 0.4, 0.6, 0.8], 2)[None, :, None]
    for run in (white, direct):
        assert np.abs(run.image / steps - 1.0).max() < 0.02
        assert "Stranger One" in (run.folder / MANIFEST).read_text()


def test_a_capture_from_the_command_line(config: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pdcd", "capture", "white", "--local", "--json",
         "--config", str(config), "--out", str(tmp_path / "runs")],
        env={**os.environ, "PYTHONPATH": str(PACKAGE)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["state"] == "done"
