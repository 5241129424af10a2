"""A process that is stopped while its shutter is open, in real time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

STOPPED_S = 2.0
"""For which the shutter stays open beyond its time."""


def shoot(folder: Path, stops: int) -> tuple[dict[str, Any], list[str]]:
    """A photo whose process is stopped in the first so many exposures of it: its result, and all
    that was said."""
    config = folder / "pdcd.toml"
    config.write_text(
        '[rig]\nclock = "real"\n[scene]\ngrid = [6, 8]\n[camera]\nf_number = 8.0\n'
        f'[server]\nstate_dir = "{folder}"\n'
    )
    command = [
        sys.executable,
        "-m",
        "pdcd",
        "capture",
        "white",
        "--codes",
        "8",
        "--local",
        "--json",
    ]
    command += ["--config", str(config), "--out", str(folder / "out"), "--black-level", "none"]
    said = []
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder
    ) as process:
        assert process.stderr is not None and process.stdout is not None
        for line in process.stderr:
            said.append(line.strip())
            if line.startswith("white: shutter open") and stops:
                stops -= 1
                os.kill(process.pid, signal.SIGSTOP)
                time.sleep(STOPPED_S)
                os.kill(process.pid, signal.SIGCONT)
        result: dict[str, Any] = json.loads(process.stdout.read().splitlines()[-1])
    assert process.returncode == 0, said
    return result, said


@pytest.mark.whole
def test_a_shot_in_which_the_process_was_stopped_is_taken_again_and_then_doubted(
    tmp_path: Path,
) -> None:
    result, said = shoot(tmp_path, 2)
    assert said.count("white: discarded") == 1
    assert any("the shutter was open for" in text for text in result["warnings"]), result
    quality = result["summary"]["quality"]
    assert quality["verdict"] == "doubtful"
    assert any("the shutter was open for" in reason for reason in quality["reasons"]), quality
