"""The command line: what is typed, what is printed where, and the exit codes."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import pytest

from pdcd import __version__, request
from pdcd.cli import main, output, parser
from pdcd.client import Unreachable
from pdcd.config import Config
from pdcd.errors import BusyError, Cancelled, ConfigError, DeviceLost, PdcdError, SyncError
from pdcd.request import CaptureRequest, CaptureResult, PlanSummary, ShotSummary

JOB = "20260101T120301Z-7f3a"
SUMMARY: dict[str, float | int | str | None] = {
    "codes": 8,
    "refreshes": 480,
    "exposure_s": 8.2,
    "missed_refreshes": 2,
    "rms_error": 0.01234,
    "wall_s": 0.5,
}
DONE = CaptureResult(job=JOB, state="done", folder="/runs/x", summary=SUMMARY)
PLAN = PlanSummary(
    goal="indirect",
    family="hadamard",
    codes=8,
    p=0.5,
    grid=(48, 64),
    window="whole",
    guards=True,
    passes=2,
    shots=(ShotSummary(name="coded", codes=8, refreshes=24, exposure_s=0.5, light_share=0.25),),
    refreshes=24,
    seconds=0.5,
    light_share=0.25,
    raw_files=1,
)
EVENTS: list[dict[str, Any]] = [
    {"job": JOB, "seq": 0, "type": "armed", "t_mono_ns": 1, "shot": "coded"},
    {"job": JOB, "seq": 1, "type": "progress", "t_mono_ns": 2, "shot": "coded", "frame": 12,
     "frames": 24, "missed": 0},
    {"job": JOB, "seq": 2, "type": "progress", "t_mono_ns": 3, "shot": "coded", "frame": 24,
     "frames": 24, "missed": 3},
    {"job": JOB, "seq": 3, "type": "decoding", "t_mono_ns": 4},
]  # fmt: skip
STATUS: dict[str, Any] = {
    "version": "9.9",
    "state": "busy",
    "running": {"job": JOB, "goal": "indirect", "owner": {"uid": 5, "pid": 6, "user": "ada"}},
    "queued": [],
    "connections": 2,
    "uptime_s": 61.4,
    "new field": [1],
}


def ended(state: request.JobState, kind: str) -> CaptureResult:
    error = {"kind": kind, "message": "it broke", "device": "camera", "hint": "mend it"}
    return CaptureResult(job=JOB, state=state, error=error)


class StubClient:
    """Stands in for a daemon: answers from class attributes, records what was asked."""

    result: CaptureResult = DONE
    error: BaseException | None = None
    status_answer: dict[str, Any] = STATUS
    asked: list[Any]

    def __init__(self, path: Path) -> None:
        self.asked.append(path)

    def __enter__(self) -> StubClient:
        return self

    def __exit__(self, *unused: object) -> None:
        self.asked.append("closed")

    def _answer(self, *asked: Any) -> CaptureResult:
        self.asked.append(asked)
        if self.error is not None:
            raise self.error
        return self.result

    def capture(
        self, wanted: CaptureRequest, *, detach: bool, queue: bool, on_event: output.OnEvent
    ) -> CaptureResult:
        for event in EVENTS:
            on_event(event)
        return self._answer(wanted, detach, queue)

    def wait(self, job: str, on_event: output.OnEvent) -> CaptureResult:
        for event in EVENTS:
            on_event(event)
        return self._answer(job)

    def cancel(self, job: str) -> CaptureResult:
        return self._answer("cancel", job)

    def plan(self, wanted: CaptureRequest) -> PlanSummary:
        self._answer("plan", wanted)
        return PLAN

    def status(self) -> dict[str, Any]:
        return self.status_answer

    def list(self) -> list[dict[str, Any]]:
        return [{**STATUS["running"], "state": "running", "folder": None}]

    def events(self) -> Iterator[dict[str, Any]]:
        return iter(EVENTS)


class StubEngine:
    """Stands in for the rig: one capture, scripted by `run`."""

    run: Callable[[Callable[[], bool]], CaptureResult]
    start_error: PdcdError | None = None
    calls: list[Any]

    @classmethod
    def from_config(cls, config: Config) -> StubEngine:
        cls.calls.append(("from_config", config))
        return cls()

    def start(self) -> None:
        self.calls.append("start")
        if self.start_error is not None:
            raise self.start_error

    def stop(self) -> None:
        self.calls.append("stop")

    def plan(self, wanted: CaptureRequest) -> PlanSummary:
        self.calls.append(("plan", wanted))
        return PLAN

    def capture(
        self,
        wanted: CaptureRequest,
        *,
        job: str,
        owner: dict[str, Any],
        emit: Callable[[str, dict[str, Any]], None],
        cancelled: Callable[[], bool],
    ) -> CaptureResult:
        self.calls.append(("capture", wanted, job, owner))
        emit("armed", {"shot": "coded"})
        return type(self).run(cancelled)


@pytest.fixture(autouse=True)
def _no_configuration_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("CONFIGURATION_DIRECTORY", "RUNTIME_DIRECTORY", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch) -> type[StubClient]:
    class Fresh(StubClient):
        asked: list[Any] = []  # noqa: RUF012

    monkeypatch.setattr("pdcd.cli.capture.Client", Fresh)
    monkeypatch.setattr("pdcd.cli.jobs.Client", Fresh)
    return Fresh


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> type[StubEngine]:
    class Fresh(StubEngine):
        calls: list[Any] = []  # noqa: RUF012
        run = staticmethod(lambda cancelled: DONE)

    monkeypatch.setattr("pdcd.engine.Engine", Fresh)
    return Fresh


def last_object(text: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(text.splitlines()[-1])
    return found


# --- start-up -----------------------------------------------------------------------------------


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, pdcd.cli\n"
        "try: pdcd.cli.main(['--help'])\n"
        "except SystemExit as end: print(end.code, sorted(sys.modules), file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("usage: pdcd ")
    code_, _, modules = run.stderr.partition(" ")
    assert code_ == "0"
    for heavy in ("numpy", "scipy", "msgspec", "rich", "cv2", "rawpy", "asyncio", "pdcd.engine"):
        assert f"'{heavy}'" not in modules
    assert "'argparse'" in modules


def test_choices_are_those_of_a_request() -> None:
    assert get_args(request.GoalName) == parser.GOALS
    assert get_args(request.FamilyName) == parser.FAMILIES
    assert get_args(request.WindowName) == parser.WINDOWS
    assert get_args(request.BlackLevel) == parser.BLACK_LEVELS


@pytest.mark.parametrize(
    "line",
    ["", "fly", "capture", "capture sideways", "capture indirect --codes many", "wait", "decode",
     "capture indirect --family best", "capture indirect --loc", "config", "config mend"],
)  # fmt: skip
def test_wrong_usage_exits_2(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(line.split())
    assert caught.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "usage: pdcd" in printed.err


# --- capture over the socket --------------------------------------------------------------------


def test_capture_sends_what_was_typed(
    daemon: type[StubClient], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    line = (
        "capture fraction --socket /a/b.sock --codes 16 --family balanced --p 0.25 --seed 7"
        " --exposure 1.5 --window quarter --no-guards --black-level both --no-white --out runs"
        " --note hello --detach --queue"
    )
    assert main(line.split()) == 0
    wanted = CaptureRequest(
        goal="fraction",
        codes=16,
        family="balanced",
        p=0.25,
        seed=7,
        exposure_s=1.5,
        window="quarter",
        guards=False,
        black_level="both",
        white=False,
        out=str(tmp_path / "runs"),
        note="hello",
    )
    assert daemon.asked == [Path("/a/b.sock"), (wanted, True, True), "closed"]


def test_capture_leaves_defaults_to_the_rig(daemon: type[StubClient], tmp_path: Path) -> None:
    assert main(["capture", "indirect"]) == 0
    wanted = CaptureRequest(goal="indirect")
    assert daemon.asked == [tmp_path / "pdcd.sock", (wanted, False, False), "closed"]


def test_socket_comes_from_the_configuration(daemon: type[StubClient], tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text("[server]\nsocket = 'lab.sock'\n")
    assert main(["status", "--config", str(tmp_path / "rig.toml")]) == 0
    assert daemon.asked[0] == tmp_path / "lab.sock"


def test_capture_prints_a_table_and_progress_apart(
    daemon: type[StubClient], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["capture", "indirect"]) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [
        f"job               {JOB}",
        "state             done",
        "codes             8",
        "refreshes         480",
        "exposure          8.200 s",
        "missed refreshes  2",
        "RMS error         1.23 % against the scene's known truth",
        "wall time         0.50 s",
        "folder            /runs/x",
    ]
    # The second progress event comes within the second and is left out.
    assert printed.err.splitlines() == ["coded: armed", "coded: 12/24 refreshes", "decoding"]


def test_progress_lines_come_again_after_a_second(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 100.0
    monkeypatch.setattr("pdcd.cli.output.time.monotonic", lambda: now_s)
    with output.progress() as on_event:
        for now_s in (100.0, 100.9, 101.0, 101.5, 102.1):
            on_event({**EVENTS[2], "frame": round(now_s * 10)})
    assert capsys.readouterr().err.splitlines() == [
        f"coded: {frame}/24 refreshes, 3 missed" for frame in (1000, 1010, 1021)
    ]


def test_progress_is_a_bar_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    with output.progress() as on_event:
        on_event(EVENTS[0])
        on_event(EVENTS[2])
    assert "coded: 24/24 refreshes, 3 missed" in screen.getvalue()
    assert "100%" in screen.getvalue()


def test_capture_json_ends_with_the_result_unchanged(
    daemon: type[StubClient], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["capture", "indirect", "--json"]) == 0
    assert last_object(capsys.readouterr().out) == {
        "job": JOB,
        "state": "done",
        "folder": "/runs/x",
        "manifest_sha256": None,
        "error": None,
        "files": [],
        "summary": SUMMARY,
    }


@pytest.mark.parametrize(
    ("result", "code"),
    [
        (ended("failed", "device_lost"), 5),
        (ended("failed", "config"), 2),
        (ended("failed", "busy"), 4),
        (ended("failed", "something new"), 5),
        (CaptureResult(job=JOB, state="failed"), 5),
        (ended("cancelled", "cancelled"), 130),
        (CaptureResult(job=JOB, state="queued"), 0),
        (CaptureResult(job=JOB, state="running"), 0),
    ],
)
@pytest.mark.parametrize("line", ["capture indirect", f"wait {JOB}", f"watch {JOB}"])
def test_end_of_the_job_gives_the_exit_code(
    daemon: type[StubClient],
    capsys: pytest.CaptureFixture[str],
    line: str,
    result: CaptureResult,
    code: int,
) -> None:
    daemon.result = result
    assert main([*line.split(), "--json"]) == code
    printed = capsys.readouterr()
    assert last_object(printed.out)["state"] == result.state
    said = "pdcd: camera: it broke (mend it)" in printed.err.splitlines()
    assert said == (result.error is not None)


@pytest.mark.parametrize(
    ("error", "code", "kind", "line"),
    [
        (BusyError("the rig is taken", hint="by ada"), 4, "busy", "the rig is taken (by ada)"),
        (ConfigError("no such goal"), 2, "config", "no such goal"),
        (SyncError("3 late", device="mask"), 5, "sync", "mask: 3 late"),
        (DeviceLost("gone", device="camera"), 5, "device_lost", "camera: gone"),
        (Cancelled("ended"), 130, "cancelled", "ended"),
        (Unreachable("no daemon answers"), 3, "unreachable", "no daemon answers"),
        (KeyboardInterrupt(), 130, "cancelled", "interrupted"),
        (PermissionError(13, "Permission denied", "/x"), 5, "internal",
         "[Errno 13] Permission denied: '/x'"),
    ],
)  # fmt: skip
def test_refusal_is_one_line_and_one_object(
    daemon: type[StubClient],
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    kind: str,
    line: str,
) -> None:
    daemon.error = error
    assert main(["capture", "indirect", "--json"]) == code
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-1] == f"pdcd: {line}"
    told = last_object(printed.out)
    assert (told["job"], told["folder"]) == (None, None)
    assert told["state"] == ("cancelled" if code == 130 else "failed")
    assert told["error"]["kind"] == kind
    if isinstance(error, PdcdError):
        assert told["error"] == {
            "kind": kind,
            "message": error.message,
            "device": error.device,
            "hint": error.hint,
        }

    assert main(["capture", "indirect"]) == code
    assert capsys.readouterr().out == ""


def test_other_commands_report_errors_without_a_job(
    daemon: type[StubClient], capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.error = ConfigError("unknown job")
    assert main(["wait", "x", "--json"]) == 2
    assert last_object(capsys.readouterr().out) == {
        "error": {"kind": "config", "message": "unknown job", "device": None, "hint": None}
    }


def test_no_daemon_exits_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    socket = str(tmp_path / "nobody.sock")
    for line in (["status"], ["list"], ["watch"], ["cancel"], ["wait", "x"], ["capture", "white"],
                 ["plan", "white"]):  # fmt: skip
        assert main([*line, "--socket", socket]) == 3
        printed = capsys.readouterr()
        assert printed.out == ""
        assert socket in printed.err
        assert "Traceback" not in printed.err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("--codes 0", "codes: expected int >= 1"),
        ("--codes 70000", "codes: expected int <= 65536"),
        ("--p 1", "p: expected float < 1.0"),
        ("--p nan", "p: expected float"),
        ("--exposure 0", "exposure_s: expected float > 0.0"),
        ("--exposure inf", "exposure_s: expected float <= 3600.0"),
        ("--seed -1", "seed: expected int >= 0"),
        ("--local --detach", "--local goes without --detach"),
        ("--local --queue --socket x", "--local goes without --socket and --queue"),
        ("--local --config gone.toml", "cannot read the configuration gone.toml"),
    ],
)
def test_wrong_request_exits_2_before_anything_starts(
    daemon: type[StubClient],
    engine: type[StubEngine],
    capsys: pytest.CaptureFixture[str],
    options: str,
    says: str,
) -> None:
    assert main(["capture", "indirect", *options.split()]) == 2
    assert capsys.readouterr().err.startswith(f"pdcd: {says}")
    assert daemon.asked == engine.calls == []


def test_broken_pipe_ends_quietly() -> None:
    run = subprocess.run(
        f"{sys.executable} -c 'from pdcd.cli import main; raise SystemExit(main())' config schema"
        " | true; exit ${PIPESTATUS[0]}",
        shell=True,
        executable="/bin/bash",
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.stderr == ""
    assert run.returncode in (0, 5), "0 when the pipe's buffer took it all in time"


# --- capture in this process --------------------------------------------------------------------


def test_local_capture_starts_and_stops_the_rig(
    engine: type[StubEngine], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "rig.toml").write_text("[rig]\nname = 'mine'\n")
    line = ["capture", "indirect", "--local", "--json", "--config", str(tmp_path / "rig.toml")]
    assert main(line) == 0
    made, start, capture, stop = engine.calls
    assert (start, stop) == ("start", "stop")
    assert made[1].rig.name == "mine"
    assert capture[1] == CaptureRequest(goal="indirect")
    assert capture[3]["uid"] == os.getuid()
    assert capture[3]["pid"] == os.getpid()
    assert isinstance(capture[3]["user"], str)
    printed = capsys.readouterr()
    assert last_object(printed.out)["job"] == JOB
    assert printed.err.splitlines() == ["coded: armed"]


def test_rig_is_stopped_when_it_does_not_start(
    engine: type[StubEngine], capsys: pytest.CaptureFixture[str]
) -> None:
    engine.start_error = DeviceLost("nothing on USB", device="camera", hint="plug it in")
    assert main(["capture", "indirect", "--local"]) == 5
    assert engine.calls[-1] == "stop"
    assert capsys.readouterr().err == "pdcd: camera: nothing on USB (plug it in)\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_cancels_a_local_capture(engine: type[StubEngine], number: signal.Signals) -> None:
    asked: list[bool] = []

    def run(cancelled: Callable[[], bool]) -> CaptureResult:
        asked.append(cancelled())
        signal.raise_signal(number)
        asked.append(cancelled())
        return ended("cancelled", "cancelled")

    engine.run = staticmethod(run)
    before = signal.getsignal(number)
    assert main(["capture", "indirect", "--local"]) == 130
    assert asked == [False, True]
    assert engine.calls[-1] == "stop"
    assert signal.getsignal(number) is before


def test_second_signal_does_not_wait_for_the_engine(engine: type[StubEngine]) -> None:
    def run(cancelled: Callable[[], bool]) -> CaptureResult:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        raise AssertionError("the second signal must interrupt")

    engine.run = staticmethod(run)
    assert main(["capture", "indirect", "--local"]) == 130
    assert engine.calls[-1] == "stop", "panels black and shutter closed even so"


def test_sigterm_interrupts_a_capture_over_the_socket(
    daemon: type[StubClient], monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupted: list[bool] = []

    def capture(self: StubClient, *args: Any, **options: Any) -> CaptureResult:
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:  # the client cancels the job and waits for its end
            interrupted.append(True)
        return ended("cancelled", "cancelled")

    monkeypatch.setattr(daemon, "capture", capture)
    before = signal.getsignal(signal.SIGTERM)
    assert main(["capture", "indirect"]) == 130
    assert interrupted == [True]
    assert signal.getsignal(signal.SIGTERM) is before


def test_real_capture_and_decode_without_a_daemon(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text("[scene]\ngrid = [6, 8]\n")
    line = f"capture indirect --local --config {rig} --codes 8 --out {tmp_path} --json"
    assert main(line.split()) == 0
    result = last_object(capsys.readouterr().out)
    assert (result["state"], result["summary"]["codes"]) == ("done", 8)
    folder = Path(result["folder"])
    assert (folder / "capture.json").is_file()
    assert folder.parent == tmp_path

    assert main(["decode", str(folder), "--json"]) == 0
    assert last_object(capsys.readouterr().out)["identical"] is True
    assert main(["decode", str(tmp_path / "nowhere")]) == 5
    assert capsys.readouterr().err.startswith("pdcd: ")


# --- the other commands -------------------------------------------------------------------------


def test_plan_asks_the_daemon_and_falls_back_to_this_process(
    daemon: type[StubClient], engine: type[StubEngine], capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = CaptureRequest(goal="indirect", codes=8)
    assert main("plan indirect --codes 8 --json".split()) == 0
    assert daemon.asked[1] == ("plan", wanted)
    assert engine.calls == []
    assert last_object(capsys.readouterr().out)["passes"] == 2

    daemon.error = Unreachable("nobody")
    assert main("plan indirect --codes 8".split()) == 0
    assert engine.calls[-1] == ("plan", wanted)
    table = capsys.readouterr().out
    assert "light       25 % of a floodlit exposure" in table
    assert "shot coded  8 codes, 24 refreshes, 0.500 s" in table
    assert main("plan indirect --socket /named.sock".split()) == 3


def test_plan_with_a_configuration_asks_no_daemon(
    daemon: type[StubClient], engine: type[StubEngine], tmp_path: Path
) -> None:
    (tmp_path / "rig.toml").write_text("[rig]\nname = 'mine'\n")
    assert main(["plan", "indirect", "--config", str(tmp_path / "rig.toml")]) == 0
    assert engine.calls[0][1].rig.name == "mine"
    assert main(["plan", "indirect", "--local"]) == 0
    assert engine.calls[2][1] == Config()
    assert main(["plan", "indirect", "--local", "--socket", "x"]) == 2
    assert daemon.asked == []


def test_status(daemon: type[StubClient], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status"]) == 0
    assert f"running      {JOB} indirect by ada" in capsys.readouterr().out
    assert main(["status", "--json"]) == 0
    assert last_object(capsys.readouterr().out) == STATUS


def test_list(daemon: type[StubClient], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    assert capsys.readouterr().out.splitlines()[1].split() == [JOB, "running", "indirect", "ada"]
    assert main(["list", "--json"]) == 0
    assert last_object(capsys.readouterr().out)["jobs"][0]["job"] == JOB


def test_watch_prints_events(daemon: type[StubClient], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch"]) == 0
    assert capsys.readouterr().out.splitlines()[1] == (
        f"{JOB} progress shot=coded frame=12 frames=24 missed=0"
    )
    assert main(["watch", "--json"]) == 0
    assert [json.loads(line) for line in capsys.readouterr().out.splitlines()] == EVENTS
    assert main(["watch", JOB, "--json"]) == 0
    *events, end = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert events == EVENTS
    assert end["state"] == "done"


def test_cancel_ends_the_named_or_the_running_job(
    daemon: type[StubClient], capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.result = ended("cancelled", "cancelled")
    assert main(["cancel", "mine"]) == 0
    assert ("cancel", "mine") in daemon.asked
    assert main(["cancel"]) == 0
    assert ("cancel", JOB) in daemon.asked
    daemon.status_answer = {**STATUS, "running": None}
    assert main(["cancel"]) == 2
    assert "nothing is running" in capsys.readouterr().err


def test_drivers(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [
        {"role": "display", "name": "a", "origin": "pdcd", "target": "m:C", "maturity": "beta",
         "available": True, "reason": None},
        {"role": "shutter", "name": "b", "origin": "acme", "target": "m:D", "maturity": None,
         "available": False, "reason": "no libusb"},
    ]  # fmt: skip
    monkeypatch.setattr("pdcd.registry.describe_drivers", lambda: rows)
    assert main(["drivers"]) == 0
    assert [line.split() for line in capsys.readouterr().out.splitlines()[1:]] == [
        ["display", "a", "beta", "pdcd", "available"],
        ["shutter", "b", "?", "acme", "unavailable:", "no", "libusb"],
    ]
    assert main(["drivers", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == rows


def test_config_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[rig]\nname = 'mine'\n")
    assert main(["config", "check"]) == 0
    assert capsys.readouterr().out == "sound: no file, the mock bench\n"
    assert main(["config", "check", "--config", str(path)]) == 0
    assert capsys.readouterr().out == f"sound: {path}\n"
    assert main(["config", "show", "--config", str(path)]) == 0
    assert capsys.readouterr().out.startswith('[rig]\nname = "mine"\n')
    assert main(["config", "schema"]) == 0
    assert "Config" in json.loads(capsys.readouterr().out)["$defs"]
    path.write_text("[rig]\nname = 3\nnane = 4\n")
    for action in ("check", "show"):
        assert main(["config", action, "--config", str(path)]) == 2
        assert capsys.readouterr().err.splitlines() == [
            f"pdcd: 2 faults in {path}:",
            "  rig.name: expected str, got int",
            "  rig.nane: no such key; is name meant?",
        ]


def test_decode_fails_when_a_picture_differs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [{"name": "linear/white.tif", "identical": True},
             {"name": "linear/indirect.tif", "identical": False}]  # fmt: skip
    report = {"identical": False, "files": files}
    monkeypatch.setattr("pdcd.decode.decode_folder", lambda folder: report)
    assert main(["decode", "x"]) == 5
    assert capsys.readouterr().out.splitlines() == [
        "identical  linear/white.tif",
        "DIFFERS    linear/indirect.tif",
    ]
    assert main(["decode", "x", "--json"]) == 5
    assert last_object(capsys.readouterr().out) == report


def test_serve_hands_over_configuration_and_socket(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, engine: type[StubEngine]
) -> None:
    served: list[Any] = []

    def run(config: Config, *, socket: Path | None, engine_factory: Any) -> int:
        served.extend([config.server.state_dir, socket, engine_factory])
        return 5

    monkeypatch.setattr("pdcd.server.daemon.run", run)
    monkeypatch.chdir(tmp_path)
    assert main(["serve", "--socket", "/a.sock", "--state-dir", "runs"]) == 5
    assert served == [str(tmp_path / "runs"), Path("/a.sock"), engine.from_config]
    assert main(["serve"]) == 5
    assert served[3:5] == [None, None]


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["version"]) == 0
    assert capsys.readouterr().out == f"pdcd {__version__}\n"
