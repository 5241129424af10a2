"""Commands that start or stand in for programs: the demo, the page, completion; decoding again."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.bench.tables import Config
from pdcd.cli import demo as demo_cli
from pdcd.cli import shell
from pdcd.cli import tools as tools_cli
from pdcd.cli.main import main
from pdcd.cli.parser import build_parser, list_subparsers
from pdcd.cli.web import serve_web
from pdcd.client import UnreachableError
from pdcd.extras import suggest_install
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.server import log
from tests.unit.cli.cli_stubs import JOB, home_at


@pytest.fixture(autouse=True)
def _alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    home_at(monkeypatch, tmp_path)


# --- demo -----------------------------------------------------------------------------------------


class Daemon:
    """Stands in for the process of a daemon."""

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
    monkeypatch.setattr(demo_cli, "Client", client_of(result, asked))
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


def test_a_demo_that_fails_names_no_pictures(
    daemon: Daemon, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    result = CaptureResult(job=JOB, state="failed", error={"kind": "busy", "message": "taken"})
    monkeypatch.setattr(demo_cli, "Client", client_of(result, []))
    assert main(["demo"]) == 4
    assert "look at" not in capsys.readouterr().out and daemon.done == ["terminated", "left"]


def test_a_demo_that_is_ended_by_ctrl_c_says_no_more_than_that(
    daemon: Daemon, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    error: dict[str, str | None] = {"kind": "cancelled", "message": "the job was cancelled"}
    result = CaptureResult(
        job=JOB, state="cancelled", folder="/r.partial", error=error, files=("raw/white.dng",)
    )
    monkeypatch.setattr(demo_cli, "Client", client_of(result, []))
    assert main(["demo"]) == 130
    told = capsys.readouterr()
    assert "look at" not in told.out and "/r.partial" in told.out
    assert told.err.splitlines()[-1] == "pdcd: the job was cancelled"


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

    def client(socket: Path) -> Any:
        nonlocal count
        count += 1
        if count < tries or ended is not None:
            raise UnreachableError("nobody")
        return socket

    log = tmp_path / "log"
    log.write_text("it begins\nit fails")
    daemon.ended = ended
    monkeypatch.setattr(demo_cli, "Client", client)
    monkeypatch.setattr(time, "sleep", slept.append)
    if ended is None:
        assert demo_cli._connect(Path("s"), daemon, log) == Path("s")  # type: ignore[arg-type, comparison-overlap]
        assert slept == [0.02] * (tries - 1) and capsys.readouterr().err == ""
    else:
        with pytest.raises(UnreachableError):
            demo_cli._connect(Path("s"), daemon, log)  # type: ignore[arg-type]
        assert capsys.readouterr().err == "it begins\nit fails\n" and count == 1


# --- the page -------------------------------------------------------------------------------------


def test_a_page_is_served_of_what_was_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    served: list[Any] = []

    async def run(bound: Any, socket: Path, state: Path, opened: Any) -> None:
        served.append((bound, socket, state))
        opened("http://127.0.0.1:1/x")

    module = SimpleNamespace(bind_loopback=lambda *where: where, run_page_server=run)
    monkeypatch.setitem(sys.modules, "pdcd.web.serve", module)
    monkeypatch.setattr(log, "send_to_stderr", lambda: served.append("log"))
    monkeypatch.chdir(tmp_path)
    line = ["web", "--socket", "/s", "--state-dir", "runs", "--port", "1"]
    assert serve_web(build_parser().parse_args(line)) == 0
    said = capsys.readouterr()
    assert said.out == "http://127.0.0.1:1/x\n"
    assert "until Ctrl-C ends the page" in said.err
    assert main(["web", "--host", "::1"]) == 0
    assert served == [
        "log", (("127.0.0.1", 1), Path("/s"), tmp_path / "runs"), "log",
        (("::1", 8137), tmp_path / "pdcd.sock", tmp_path / ".local" / "state" / "pdcd"),
    ]  # fmt: skip


# --- completion -----------------------------------------------------------------------------------


def test_files_and_folders_are_completed_as_what_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found: dict[str, Any] = {}

    def complete(parser: argparse.ArgumentParser, shell: str) -> str:
        assert shell == "fish"
        for of in (parser, *list_subparsers(parser)):
            for action in of._actions:
                found[f"{of.prog} {action.option_strings or action.dest}"] = getattr(
                    action, "complete", None
                )
        return "the script\n\n\n"

    module = SimpleNamespace(complete=complete, DIRECTORY="a folder", FILE="a file")
    monkeypatch.setitem(sys.modules, "shtab", module)
    assert shell.make_completion_script("fish") == "the script\n"
    assert found["pdcd capture ['--out']"] == "a folder"
    assert found["pdcd capture ['--config']"] == found["pdcd decode folder"] == "a file"
    assert found["pdcd runs export ['--state-dir']"] == "a folder"
    assert found["pdcd capture ['--codes']"] is found["pdcd web ['--port']"] is None


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


def test_a_run_is_decoded_again_with_its_progress_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def decode(folder: Path, watch: Any) -> Any:
        watch.step(3.0, 4.0)
        return SimpleNamespace(files=[SimpleNamespace(name=str(folder), identical=True)])

    monkeypatch.setattr("pdcd.pictures.decode.decode_folder", decode)
    assert main(["decode", "run"]) == 0
    said = capsys.readouterr()
    assert said.out == "identical  run\n" and "75 %" in said.err


@pytest.mark.parametrize("age", [None, "calibrated 3 days ago"])
def test_each_value_of_a_configuration_says_where_it_comes_from(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], age: str | None
) -> None:
    shown: list[Any] = []

    def show(config: Config, notes: dict[tuple[str, ...], str]) -> str:
        shown.append((config, notes))
        return "first\n  second\n\n"

    origins = [SimpleNamespace(key="rig.name", words="typed")]
    monkeypatch.setattr(tools_cli, "format_config", show)
    monkeypatch.setattr(tools_cli, "trace_origins", lambda source, settings: origins)
    monkeypatch.setattr(tools_cli, "describe_calibration_age", lambda settings: age)
    monkeypatch.setattr(tools_cli, "apply_calibration", lambda settings: "calibrated")
    assert main(["config", "show"]) == 0
    assert capsys.readouterr().out == "first\n  second\n"
    notes: dict[tuple[str, ...], str] = {("rig", "name"): "typed"}
    if age:
        notes["calibration",] = age
        notes["calibration", "typed"] = "in whose place stand measured values"
    assert shown == [("calibrated", notes)]
