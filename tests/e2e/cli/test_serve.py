"""`pdcd serve --background` returns when the daemon listens; `pdcd demo` has one of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from pdcd.client import Client
from tests.processes import ended, soon

pytestmark = pytest.mark.whole

CONFIG = "[scene]\ngrid = [6, 8]\n[limits]\nmin_free_bytes = 0\n"


def run(folder: Path, *words: str, **more: str) -> subprocess.CompletedProcess[str]:
    """A command of that user, in a folder, with `more` in its environment."""
    home = {name: str(folder) for name in ("HOME", "XDG_RUNTIME_DIR", "XDG_STATE_HOME")}
    environ = {**os.environ, **home, **more}
    command = [sys.executable, "-m", "pdcd", *words]
    return subprocess.run(
        command, cwd=folder, env=environ, capture_output=True, text=True, check=False
    )


def test_a_daemon_in_the_background_is_there_when_the_command_returns(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text(CONFIG)
    (tmp_path / "wrong.toml").write_text("[scene]\ngrid = [6, 9]\n")
    begun = run(tmp_path, "serve", "--background", "--config", "bench.toml")
    assert begun.returncode == 0, begun.stderr
    with Client(tmp_path / "pdcd.sock") as client:
        pid = client.daemon_pid
    try:
        assert begun.stdout.startswith(f"listening on {tmp_path}/pdcd.sock, process {pid}, log ")
        assert "ready" in (tmp_path / "pdcd" / "daemon.log").read_text()
        other = run(tmp_path, "capture", "white", "--config", "wrong.toml", "--json")
        assert other.returncode == 2
        assert "scene.grid differs" in json.loads(other.stdout)["error"]["message"]
        second = run(tmp_path, "serve", "--background", "--config", "bench.toml")
        assert second.returncode == 2 and f"already: process {pid} (stop" in second.stderr
        assert run(tmp_path, "capture", "white", "--config", "bench.toml").returncode == 0
    finally:
        os.kill(pid, signal.SIGTERM)
    assert soon(lambda: ended(pid))


def test_a_demo_takes_a_photo_and_leaves_nothing_behind(tmp_path: Path) -> None:
    with TemporaryDirectory(dir="/tmp") as scratch:  # the path of a socket must be short
        made = run(tmp_path, "demo", "--codes", "8", "--out", "there", TMPDIR=scratch)
        assert made.returncode == 0, made.stderr
        assert list(Path(scratch).iterdir()) == []
    page = Path(made.stdout.splitlines()[-1].removeprefix("all of it on one page: "))
    assert page.is_file() and page.is_relative_to(tmp_path / "there")
