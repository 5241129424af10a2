"""`pdcd show` beside a daemon, which has the panels."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pdcd.cli.main import main
from pdcd.client import Client
from tests.e2e.server._server_harness import Daemon, threaded_daemon
from tests.sampled import sampled


def told(capsys: pytest.CaptureFixture[str]) -> tuple[str, str]:
    found = capsys.readouterr()
    return found.out, found.err


@contextmanager
def showing(running: Daemon, *words: str) -> Iterator[subprocess.Popen[str]]:
    """The command in a process of its own, until it has put its picture on the panels."""
    command = [sys.executable, "-m", "pdcd", "show", *words, "--socket", str(running.path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            assert process.stderr is not None
            for line in process.stderr:
                if "Ctrl-C ends" in line:
                    break
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("number", sampled([signal.SIGINT, signal.SIGTERM], 2))
def test_a_picture_stays_as_long_as_its_command(tmp_path: Path, number: signal.Signals) -> None:
    with threaded_daemon(tmp_path) as running, showing(running, "checker") as process:
        assert running.engine.lit == "checker"
        process.send_signal(number)
        assert process.wait(20) == 0
        assert running.engine.lit is None
        assert process.stdout is not None
        assert "checker on the projector, its complement on the mask" in process.stdout.read()


def test_a_killed_command_leaves_nothing_lit(tmp_path: Path) -> None:
    with threaded_daemon(tmp_path) as running, showing(running, "white") as process:
        assert running.engine.lit == "white"
        process.kill()
        process.wait(20)
        with Client(running.path) as client:
            while client.status().state != "idle":
                time.sleep(0.005)
        assert running.engine.lit is None


def test_detached_pictures_stay_until_black(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with threaded_daemon(tmp_path) as running:
        socket = ["--socket", str(running.path)]
        assert main(["show", "grid", "--detach", "--json", *socket]) == 0
        answer = json.loads(told(capsys)[0])
        assert (answer["pattern"], answer["index"]) == ("grid", 0)
        assert running.engine.lit == "grid"
        assert main(["show", "black", *socket]) == 0
        assert running.engine.lit is None
        assert main(["show", "white", "--seconds", "0.05", *socket]) == 0
        assert running.engine.lit is None
        assert "show white 0" in running.engine.calls


def test_a_command_is_told_when_its_picture_was_ended(tmp_path: Path) -> None:
    with threaded_daemon(tmp_path) as running, showing(running, "grid") as process:
        with Client(running.path) as client:
            job = client.status().running
            assert job is not None and job.kind == "show"
            client.cancel(job.job)
        assert process.wait(20) == 0
        assert process.stderr is not None
        assert "ended by another command" in process.stderr.read()


def test_the_loop_is_not_for_a_daemon(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with threaded_daemon(tmp_path) as running:
        for words in (["--loop"], ["flash"]):
            assert main(["show", *words, "--socket", str(running.path)]) == 4
            assert "show one that stays" in told(capsys)[1]
        assert running.engine.lit is None
