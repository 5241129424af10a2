"""Commands that start or stand in for programs: the demo, the page, completion; decoding again."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from pdcd.cli import demo as demo_cli
from pdcd.cli import starting
from pdcd.cli.main import main
from pdcd.extras import suggest_install
from pdcd.protocol.line_talk import UnreachableError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from tests.unit.cli.cli_stubs import JOB

# --- demo -----------------------------------------------------------------------------------------


class Daemon:
    """Stands in for the process of a daemon."""

    pid = 7

    def __init__(self) -> None:
        self.started: list[Any] = []
        self.ended: int | None = None
        self.done: list[str] = []

    def __call__(self, words: list[str], stderr: Any) -> Daemon:
        self.started.append(words)
        stderr.write(b"it begins\nit fails")
        stderr.flush()
        return self

    def __enter__(self) -> Daemon:
        return self

    def __exit__(self, *unused: object) -> None:
        self.done.append("left")

    def poll(self) -> int | None:
        return self.ended

    def terminate(self) -> None:
        self.done.append("terminated")


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch) -> Daemon:
    made = Daemon()
    monkeypatch.setattr(subprocess, "Popen", made)
    return made


def client_of(result: CaptureResult, asked: list[Any]) -> Any:
    """A client whose captures end like that."""

    class Client:
        daemon_pid = Daemon.pid

        def __init__(self, socket: Path) -> None:
            asked.append(socket.name)

        def __enter__(self) -> Client:
            return self

        def __exit__(self, *unused: object) -> None:
            asked.append("closed")

        def capture(self, request: CaptureRequest, on_event: Any) -> CaptureResult:
            asked.append(request)
            return result

    return Client


@pytest.mark.parametrize("has_page", [True, False])
def test_a_demo_takes_one_photo_with_a_daemon_of_its_own(
    daemon: Daemon,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    has_page: bool,
) -> None:
    monkeypatch.chdir(tmp_path)
    asked: list[Any] = []
    files = ("preview/white.png", *["report.html"] * has_page)
    result = CaptureResult(job=JOB, state="done", folder="/r", files=files)
    monkeypatch.setattr(starting, "Client", client_of(result, asked))
    monkeypatch.setattr(demo_cli, "write_report", lambda folder: f"a page of {folder}")
    assert main(["demo", "--out", "there", "--codes", "16", "--seed", "3"]) == 0
    (words,) = daemon.started
    assert words[:5] == [sys.executable, "-P", "-m", "pdcd", "serve"]
    options = dict(zip(words[5::2], words[6::2], strict=True))
    assert Path(options["--config"]).name == "demo.toml"
    assert options["--state-dir"] == str(tmp_path / "there")
    assert Path(options["--socket"]).parent == Path(options["--config"]).parent
    assert not Path(options["--socket"]).parent.exists()  # nothing is left behind
    assert asked == ["pdcd.sock", CaptureRequest(goal="indirect", codes=16, seed=3), "closed"]
    assert daemon.done == ["terminated", "left"]
    said = capsys.readouterr()
    page = "/r/report.html" if has_page else "a page of /r"
    assert said.out.splitlines()[-(2 + len(files)) :] == [
        *(f"  {name}" for name in files),
        "look at preview/white.png, preview/direct.png, preview/indirect.png",
        f"all of it on one page: {page}",
    ]
    assert said.err.splitlines()[1] == "capture.start: indirect light, 16 codes"
    assert said.err.startswith(f"pdcd serve --config {options['--config']} --socket ")


# --- completion -----------------------------------------------------------------------------------


def test_a_library_that_is_missing_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["completion", "bash"]) == 2
    assert f"shtab is not installed ({suggest_install('shtab')})" in capsys.readouterr().err


# --- decoding, and the configuration as it is used ------------------------------------------------


@pytest.mark.parametrize(("state", "code"), [("done", 0), ("partial", 5)])
def test_what_an_unfinished_run_has_is_made_into_pictures(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], state: str, code: int
) -> None:
    asked: list[Any] = []

    class Salvaged(dict[str, Any]):
        __getattr__ = dict.__getitem__

    found = Salvaged(state=state, taken="1 of 2", folder="/f", lost=["white", "black"])

    def salvage(folder: Path, out: Path | None, watch: Any) -> Any:
        asked.append((folder, out))
        watch.step(1.0, 2.0)
        return found

    monkeypatch.setattr("pdcd.capture.salvage.decode_partial", salvage)
    assert main(["decode", "run", "--partial", "--out", "there"]) == code
    said = capsys.readouterr()
    assert [line.split(maxsplit=1) for line in said.out.splitlines()] == [
        ["state", state], ["taken", "1 of 2"], ["folder", "/f"], ["left", "out: white"],
        ["left", "out: black"],
    ]  # fmt: skip
    assert "50 %" in said.err
    assert main(["decode", "run", "--partial", "--json"]) == code
    assert json.loads(capsys.readouterr().out) == found
    assert asked == [(Path("run"), Path("there")), (Path("run"), None)]
    assert main(["decode", "run", "--out", "there"]) == 2
    assert "--out goes with --partial" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("ended", "tries"), [(None, 1), (None, 3), (1, 1)], ids=["at once", "later", "it has ended"]
)
def test_a_daemon_is_waited_for_until_it_answers_or_has_ended(
    daemon: Daemon,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    ended: int | None,
    tries: int,
) -> None:
    slept: list[float] = []
    count = 0

    class Client:
        """The second that answers is another daemon's."""

        def __init__(self, socket: Path) -> None:
            nonlocal count
            count += 1
            if (count < tries and count != 2) or ended is not None:
                raise UnreachableError("nobody")
            self.daemon_pid = daemon.pid if count >= tries else 8

        def close(self) -> None:
            assert self.daemon_pid == 8

    log = tmp_path / "log"
    log.write_text("it begins\nit fails")
    daemon.ended = ended
    monkeypatch.setattr(starting, "Client", Client)
    monkeypatch.setattr(time, "sleep", slept.append)
    if ended is None:
        found = starting.connect_started(Path("s"), daemon, log, 1e9)  # type: ignore[arg-type]
        assert found.daemon_pid == daemon.pid
        assert slept == [0.02] * (tries - 1) and capsys.readouterr().err == ""
    else:
        with pytest.raises(UnreachableError):
            starting.connect_started(Path("s"), daemon, log, 1e9)  # type: ignore[arg-type]
        assert capsys.readouterr().err == "it begins\nit fails\n" and count == 1
