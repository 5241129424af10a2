"""The examples of README and tour run as they stand, in a shell and in Python, in a home that is
empty; a daemon that starts anew knows its runs."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pdcd.client import Client
from pdcd.protocol.entry import RunQuery
from pdcd.protocol.request import CaptureRequest
from tests.places import ROOT
from tests.processes import soon
from tests.real_daemon import connect
from tests.tools import program

PATIENCE_S = 60.0
PAGES = "".join((ROOT / page).read_text() for page in ("README.md", "docs/tour.md"))
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGES, re.DOTALL)
COMMANDS = re.findall(r"^    ((?:\.venv/bin/pdcd|printf|kill|make) .*)$", PAGES, re.MULTILINE)
LEFT_OUT = {
    "make demo": "sets up .venv; what it then runs is tried by tests/e2e/cli/test_wheel.py",
    "make test": "is what runs this",
    "make web": "serves until it is interrupted",
    "make notebook": "the same",
    "pdcd figures": "minutes; tests/unit/figures and test_figures_golden take them smaller",
    "pdcd init": "asks; tests/e2e/cli/test_init.py answers",
    "pdcd doctor display": "needs a server with two outputs",
    "pdcd show grid": "the same",
    "pdcd show --loop": "the same",
    "pdcd timing": "the same",
    "pdcd doctor camera": "ends with 5 where there is none",
    "pdcd preview": "looks until it is interrupted",
    "pdcd virtual-camera": "serves until it is interrupted",
}
"""Lines that are not run, by how they begin."""
SMALL = """
[projector]
size_px = [256, 192]
[mask]
size_px = [400, 300]
[scene]
grid = [26, 34]
"""
"""The bench of who has a small one; the tour names cell 24, 32."""
AFTER = (
    ".venv/bin/pdcd plan indirect --window quarter",
    ".venv/bin/pdcd capture indirect --local --out runs/again",
)
"""The first lines again, in a home that has a calibration of another bench by then."""
FULL = ".venv/bin/pdcd calibrate --local --config turned.toml"


@pytest.fixture
def environ(tmp_path: Path) -> dict[str, str]:
    """A user's, with empty folders."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("XDG_", "PDCD"))}
    places = {"HOME": str(tmp_path), "XDG_RUNTIME_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    return {**kept, **places}


@contextmanager
def daemon(environ: dict[str, str]) -> Iterator[Path]:
    """`pdcd serve` of that user; yields its socket, and its log must be empty of warnings."""
    socket = Path(environ["XDG_RUNTIME_DIR"]) / "pdcd.sock"
    command = [sys.executable, "-m", "pdcd", "serve"]
    with subprocess.Popen(command, env=environ, stderr=subprocess.DEVNULL) as process:
        try:
            connect(socket, lambda: process.poll() is None).close()
            yield socket
        finally:
            process.terminate()


def run(environ: dict[str, str], *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *command],
        env=environ,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


@pytest.mark.long
def test_the_examples_and_a_daemon_that_starts_anew(environ: dict[str, str]) -> None:
    photo, follow = EXAMPLES
    with daemon(environ) as socket:
        # As it stands, and as its comment says.
        for script in (photo, photo.replace("pdcd.local()", "pdcd.connect()")):
            done = run(environ, "-c", script)
            assert done.returncode == 0, done.stderr
            first, second, last = done.stdout.splitlines()
            assert first.endswith("s of exposures")
            verdict, folder = second.split()
            assert verdict == "good" and (Path(folder) / "capture.json").is_file()
            assert re.fullmatch(r"\(48, 64, 3\) 0\.0\d+", last)
        done = run(environ, str(ROOT / "examples" / "with_daemon.py"))
        assert done.returncode == 0 and folder.rpartition("/")[0] in done.stdout, done.stderr

        command = [sys.executable, "-c", follow]
        with subprocess.Popen(command, env=environ, stdout=subprocess.PIPE, text=True) as follower:
            with Client(socket) as client:
                assert soon(lambda: client.status().connections == 2)  # the follower's, too
                jobs = []
                while follower.poll() is None:  # it hears only what comes after it has subscribed
                    jobs.append(client.capture(CaptureRequest(goal="white", codes=4)).job)
            assert follower.stdout is not None
            told = follower.stdout.read().splitlines()
        name, end = told[-1].split()
        assert follower.returncode == 0 and name in jobs and end == "done"

    (Path(folder).parent / "20200101T000000Z-0001.partial").mkdir()
    with daemon(environ) as socket, Client(socket) as client:
        assert client.list() == []
        *_, here, _, cut = client.find(RunQuery(previews=True)).runs
        assert (cut.job, cut.state, cut.goal) == ("20200101T000000Z-0001", "unfinished", None)
        assert (here.state, here.goal, here.folder) == ("done", "indirect", folder)


def shell_of(lines: list[str]) -> str:
    """These lines as a script that ends at the first that fails, and says which it was."""
    told = ["set -em", "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT"]
    for line in lines:
        told += [f"echo {shlex.quote('$ ' + line)} >&2", line]
        if line.endswith("&"):  # who types waits for what it says
            told.append("until .venv/bin/pdcd status >/dev/null 2>&1; do sleep 0.1; done")
    return "\n".join(told)


def type_lines(environ: dict[str, str], folder: Path, lines: list[str]) -> None:
    """Type lines in a folder that looks like a checkout; each must end well."""
    (folder / ".venv" / "bin").mkdir(parents=True)
    pdcd = folder / ".venv" / "bin" / "pdcd"
    pdcd.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m pdcd "$@"\n')
    pdcd.chmod(0o755)
    (folder / "config").symlink_to(ROOT / "config")
    done = subprocess.run(
        [program("bash"), "-c", shell_of(lines)],
        cwd=folder, env=environ, stdin=subprocess.DEVNULL, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    assert "Traceback" not in done.stderr, done.stderr[-3000:]


def typed_lines() -> list[str]:
    """What README and tour have one type, but for what is left out."""
    gone = {head: [line for line in COMMANDS if head in line] for head in LEFT_OUT}
    assert all(gone.values()), gone
    return [line for line in COMMANDS if not any(line in lines for lines in gone.values())]


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_the_lines_in_order_on_a_small_bench(environ: dict[str, str], tmp_path: Path) -> None:
    config = tmp_path / ".config" / "pdcd" / "pdcd.toml"
    config.parent.mkdir(parents=True)
    config.write_text(SMALL)
    type_lines(environ, tmp_path / "first", [*typed_lines(), *AFTER])


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_the_lines_in_order_and_again_after_a_calibration(
    environ: dict[str, str], tmp_path: Path
) -> None:
    lines = typed_lines()
    type_lines(environ, tmp_path / "first", [*lines, FULL])
    type_lines(environ, tmp_path / "second", lines)
