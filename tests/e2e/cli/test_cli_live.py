"""`pdcd preview` beside a daemon, and on a bench of its own."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import pytest

from pdcd.cli.main import main
from pdcd.client import Client
from tests.e2e.server._server_harness import threaded_daemon


def test_figures_of_a_daemons_camera_and_its_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with threaded_daemon(tmp_path) as running:
        socket = ["--socket", str(running.path)]
        assert main(["preview", "grid", "--seconds", "0.05", "--json", *socket]) == 0
        lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert [line["number"] for line in lines] == sorted({line["number"] for line in lines})
        assert lines[0]["focus"] == 0.5 and "jpeg" not in lines[0]
        assert "live grid 0" in running.engine.calls and running.engine.lit is None
        assert main(["preview", "--seconds", "0.05", *socket]) == 0
        out, err = capsys.readouterr()
        assert out.startswith("focus 0.500 (best 0.500), mean light 25.0%") and "for 0.05 s" in err
        for words, told in (
            (["--seconds", "-1"], "--seconds -1 is not between"),
            (["--web", "--out", "x.png"], "--web goes without --out"),
            (["star", "--web"], "choose it on the page"),
        ):
            assert main(["preview", *words, *socket]) == 2
            assert told in capsys.readouterr().err


def test_an_interrupt_ends_it_and_another_job_too(tmp_path: Path) -> None:
    with threaded_daemon(tmp_path) as running:
        command = [sys.executable, "-m", "pdcd", "preview", "--json", "--socket", str(running.path)]
        for end in ("interrupt", "cancel"):
            with subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            ) as process:
                assert process.stdout is not None and process.stdout.readline()
                assert running.engine.lit == "white"
                if end == "interrupt":
                    process.send_signal(signal.SIGINT)
                else:
                    with Client(running.path) as client:
                        job = client.status().running
                        assert job is not None and client.cancel(job.job).state == "cancelled"
                process.communicate(timeout=60)
                assert process.returncode == 0
            with Client(running.path) as client:
                while client.status().state != "idle":
                    time.sleep(0.005)
            assert running.engine.lit is None


@pytest.mark.long
def test_without_a_daemon_the_last_picture_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["preview", "--seconds", "0.1", "--out", "last.png"]) == 0
    assert capsys.readouterr().out.endswith("last.png\n")
    picture = cv2.imread("last.png")
    assert picture is not None and picture.shape == (48, 64, 3) and picture.max() > 100
