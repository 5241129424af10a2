"""The tutorial runs, cell by cell, and all examples do, as a user would start them."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import tutorial
from tests.places import ROOT

TOLD = {
    "error_bars": r"4 parts: sigma .*measured\n8 parts: .*\n16 parts: ",
    "error_over_codes": r"(?s)bernoulli     8 codes: .*hadamard    128 codes: ",
    "first_photo": r"error \d\.\d%, sigma ",
    "own_pattern": r"dark: 0\.0[1-9]\d+ in all light\nand -?0\.000\d in direct light",
    "worse_rig": r"guards full: error .*\nguards none: error ",
}


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")  # of the notebook's machinery, not ours
def test_the_tutorial_runs(tmp_path: Path) -> None:
    cells = [c for c in tutorial.executed(tmp_path).cells if c.cell_type == "code"]
    printed = "".join(o.text for c in cells for o in c.outputs if o.output_type == "stream")
    assert ("Traceback" not in printed and "error 0." in printed) or "error 1." in printed
    assert (tmp_path / "sweep.csv").is_file()
    assert len([*(tmp_path / "runs").glob("*/capture.json")]) == 4


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(TOLD))
def test_an_example_runs_as_a_script(name: str, tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, str(ROOT / "examples" / f"{name}.py")],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
        timeout=170.0,
    )
    assert re.search(TOLD[name], run.stdout), run.stdout
    assert not [line for line in run.stderr.splitlines() if "Error" in line]
