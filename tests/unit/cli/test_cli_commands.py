"""The command line: captures in this process, and all commands but capture."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.bench.tables import Config
from pdcd.child import Child
from pdcd.cli.main import main
from pdcd.cli.request import option_of
from pdcd.errors import DeviceLost
from pdcd.protocol.fields import list_request_fields
from pdcd.protocol.line_talk import UnreachableError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.version import __version__
from tests.unit.cli.cli_stubs import (
    JOB,
    STATUS,
    WIRE,
    StubClient,
    StubEngine,
    ended,
    last_object,
)

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
    assert capture[3].uid == os.getuid()
    assert capture[3].pid == os.getpid()
    assert isinstance(capture[3].user, str)
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

    daemon.error = UnreachableError("it went away, or takes too long: its bench is another one")
    assert main("plan indirect --codes 8".split()) == 3
    assert engine.calls == []
    assert "another one" in capsys.readouterr().err

    daemon.absent = True
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
    assert f"running      {JOB} capture indirect by ada" in capsys.readouterr().out
    assert main(["status", "--json"]) == 0
    assert last_object(capsys.readouterr().out) == msgspec.to_builtins(STATUS)


def test_watch_prints_events(daemon: type[StubClient], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch"]) == 0
    assert capsys.readouterr().out.splitlines()[1] == (
        f"{JOB} progress shot=coded frame=12 frames=24 missed=0"
    )
    assert main(["watch", "--json"]) == 0
    assert [json.loads(line) for line in capsys.readouterr().out.splitlines()] == WIRE
    assert main(["watch", JOB, "--json"]) == 0
    *events, end = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert events == WIRE
    assert end["state"] == "done"


def test_cancel_ends_the_named_or_the_running_job(
    daemon: type[StubClient], capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.result = ended("cancelled", "cancelled")
    assert main(["cancel", "mine"]) == 0
    assert ("cancel", "mine") in daemon.asked
    assert main(["cancel"]) == 0
    assert ("cancel", JOB) in daemon.asked
    daemon.status_answer = msgspec.structs.replace(STATUS, running=None)
    assert main(["cancel"]) == 2
    assert "nothing is running" in capsys.readouterr().err


def test_cancel_waits_for_devices_that_take_long_and_says_so(
    daemon: type[StubClient], capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.result, daemon.drawn_out = ended("cancelled", "cancelled"), True
    assert main(["cancel", JOB]) == 0
    assert daemon.asked[-3:] == [("cancel", JOB), (JOB,), "closed"]
    told = capsys.readouterr()
    assert "a device takes long" in told.err and "cancelled" in told.out


def test_drivers(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [
        {"role": "display", "name": "a", "origin": "pdcd", "target": "m:C", "maturity": "beta",
         "available": True, "reason": None},
        {"role": "shutter", "name": "b", "origin": "acme", "target": "m:D", "maturity": None,
         "available": False, "reason": "no libusb"},
    ]  # fmt: skip
    monkeypatch.setattr("pdcd.bench.registry.describe_drivers", lambda: rows)
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
    assert capsys.readouterr().out.startswith('[rig]\nname = "mine"  # typed\n')
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


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("[trigger]\nlag_s = inf\n", "trigger.lag_s: "),
        ("[projector]\nsize_px = [99999, 768]\n", "projector.place: "),
        ("[bench]\ntruth = 'none.toml'\n", "bench.truth: "),
    ],
)
def test_one_wrong_value_is_one_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, key: str
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    assert main(["config", "check", "--config", str(path)]) == 2
    first, *lines = capsys.readouterr().err.splitlines()
    assert first == f"pdcd: 1 fault in {path}:"
    assert len(lines) == 1 and lines[0].strip().startswith(key)


def test_serve_hands_over_configuration_and_socket(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, engine: type[StubEngine]
) -> None:
    served: list[Any] = []
    children: list[Child[Any]] = []

    def run(config: Config, *, socket: Path | None, engine_factory: Any, verbose: bool) -> int:
        children.append(engine_factory.keywords["child"])
        assert children[-1].running
        served.extend([config.server.state_dir, socket, engine_factory.func, verbose])
        return 5

    monkeypatch.setattr("pdcd.server.daemon.run_daemon", run)
    monkeypatch.chdir(tmp_path)
    assert main(["serve", "--socket", "/a.sock", "--state-dir", "runs"]) == 5
    assert served == [str(tmp_path / "runs"), Path("/a.sock"), engine.with_child, False]
    assert main(["serve", "-v"]) == 5
    assert served[4:] == [None, None, engine.with_child, True]
    # What was started before anything was read is not left behind.
    assert [child.process.returncode for child in children] == [-9, -9]
    assert [child.line.fileno() for child in children] == [-1, -1]


@pytest.mark.parametrize("line", ["capture white --local", "serve", "timing"])
def test_an_unknown_driver_exits_2(
    line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[trigger]\ndriver = 'sreial'\n[display]\ndriver = 'sreial'\n")
    assert main([*line.split(), "--config", str(path)]) == 2
    said = capsys.readouterr().err + caplog.text
    assert ("has 'sreial'" if line == "timing" else "no driver is called 'sreial'") in said


HOSTILE = ("--", "", "nan", "9" * 5000, "\udcff")


@pytest.mark.parametrize("value", HOSTILE, ids=lambda text: repr(text[:4]))
def test_whatever_is_typed_for_a_field_is_taken_or_refused(
    daemon: type[StubClient], value: str
) -> None:
    for field in list_request_fields().values():
        option, count = option_of(field), field.count or 1
        told = [option, *[value] * count] if count > 1 else [f"{option}={value}"]
        try:
            code = main(["capture", "indirect", "--detach", *told])
        except SystemExit as end:  # by argparse
            code = int(str(end.code))
        assert code in (0, 2), (option, code)


@pytest.mark.parametrize(("words", "code"), [(["version"], 0), (["web", "--host=x"], 2)])
def test_python_m_pdcd_is_pdcd(
    words: list[str], code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["__main__.py", *words])
    with pytest.raises(SystemExit) as caught:
        import pdcd.__main__  # noqa: F401 - it is what this does
    assert caught.value.code == code
    said = capsys.readouterr()
    assert (said.out == f"pdcd {__version__}\n") == (code == 0) and bool(said.err) == (code == 2)
