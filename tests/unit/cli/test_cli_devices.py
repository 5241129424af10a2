"""What commands ask of panels, cameras and shutters, and how they say what came of it."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.devices import Finding
from pdcd.bench.tables import Config
from pdcd.cli import panels as panels_cli
from pdcd.cli.main import main
from pdcd.protocol.line_talk import UnreachableError
from tests.unit.cli.cli_stubs import JOB


def noting(asked: list[Any], answer: Any) -> Callable[..., Any]:
    """What answers always the same; what it was asked is noted, a single thing by itself."""

    def call(*words: Any) -> Any:
        asked.append(words[0] if len(words) == 1 else words)
        return answer

    return call


# --- doctor ---------------------------------------------------------------------------------------

GOOD = Finding("renderer", "good", "a card")
WARNING = Finding("real time", "warning", "not permitted", "LimitRTPRIO=20")
UNKNOWN = Finding("outputs", "unknown", "there is no X server")
FAULT = Finding("desktop", "fault", "blanks", "xset s off")


@pytest.mark.parametrize(
    ("findings", "code", "last"),
    [
        ([GOOD], 0, "nothing to mend"), ([GOOD, WARNING], 0, "nothing to mend"), ([FAULT], 5,
        "1 to mend"), ([FAULT, UNKNOWN, FAULT], 5, "2 to mend"),
        ([UNKNOWN, GOOD, UNKNOWN], 0, "nothing to mend so far; not tried: outputs, outputs"),
    ],
)  # fmt: skip
def test_a_doctor_ends_with_what_there_is_to_mend(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    findings: list[Finding],
    code: int,
    last: str,
) -> None:
    asked: list[Any] = []
    monkeypatch.setattr("pdcd.presenter.examine.examine_display", noting(asked, findings))
    assert main(["doctor", "display", "--display", ":7"]) == code
    lines = capsys.readouterr().out.splitlines()
    hints = [f"{found.what}: {found.hint}" for found in findings if found.hint]
    assert lines[len(findings) :] == [*hints, last]
    assert [line.split()[0] for line in lines[: len(findings)]] == [f.state for f in findings]
    assert lines[0].split() == [findings[0].state, *findings[0].what.split(),
                                *findings[0].found.split()]  # fmt: skip
    assert main(["doctor", "display", "--json"]) == code
    told = json.loads(capsys.readouterr().out)
    assert told == {"fit": code == 0, "findings": msgspec.to_builtins(findings)}
    assert asked == [(Config(), ":7"), (Config(), None)]


@pytest.mark.parametrize(
    ("driver", "doctor"),
    [
        ("dlpc900", "drivers.dlpc900.doctor.examine_dlpc900"),
        ("dlpc-video", "drivers.dlpc_video.examine_dlpc_video"),
    ],
)
def test_dmds_have_doctors_of_their_own(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    driver: str,
    doctor: str,
) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(doctor, noting(asked, [GOOD]))
    (tmp_path / "dmd.toml").write_text(f'[display]\ndriver = "{driver}"\n')
    assert main(["doctor", "display", "--config", str(tmp_path / "dmd.toml")]) == 0
    assert capsys.readouterr().out.endswith("nothing to mend\n")
    assert [one.config.display.driver for one in asked] == [driver]


@pytest.mark.parametrize(("seconds", "fits"), [("0", True), ("5", True), ("5.1", False),
                                               ("-0.1", False)])  # fmt: skip
def test_a_shutter_is_open_no_longer_than_any_exposure(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    seconds: str,
    fits: bool,
) -> None:
    asked: list[Any] = []

    def examine(config: Config, **how: Any) -> list[Finding]:
        asked.append((how, signal.getsignal(signal.SIGTERM)))
        return [GOOD]

    monkeypatch.setattr("pdcd.bench.click.examine_shutter", examine)
    (tmp_path / "rig.toml").write_text("[limits]\nmax_exposure_s = 5.0\n")
    line = ["doctor", "trigger", "--config", str(tmp_path / "rig.toml"), "--click"]
    assert main([*line, f"--seconds={seconds}"]) == (0 if fits else 2)
    if fits:
        how = {"click": True, "seconds": float(seconds)}
        assert asked == [(how, signal.default_int_handler)]  # a signal closes it again
        assert capsys.readouterr().out.endswith("nothing to mend\n")
    else:
        assert asked == []
        assert f"--seconds {seconds} is not between 0 and" in capsys.readouterr().err


# --- the panels -----------------------------------------------------------------------------------


class Shower:
    """A daemon's panels: takes note; `end` is raised where it is waited for."""

    def __init__(self, path: Path) -> None:
        self.done: list[Any] = []
        self.end: BaseException | None = None
        self.hello = SimpleNamespace(drivers={"display": "x11"})

    def __enter__(self) -> Shower:
        return self

    def __exit__(self, *unused: object) -> None:
        self.done.append("closed")

    def show(self, pattern: str, index: int, *, detach: bool) -> Any:
        self.done.append(("show", pattern, index, detach))
        return Shown(JOB, pattern, index)

    def wait(self, job: str) -> None:
        self.call("wait", {"job": job})

    def call(self, name: str, words: dict[str, Any], timeout_s: float | None = None) -> None:
        self.done.append((name, words, timeout_s))
        if self.end is not None:
            raise self.end

    def cancel(self, job: str) -> None:
        self.done.append(("cancel", job))


class Shown(msgspec.Struct):
    """What a daemon answers."""

    job: str
    pattern: str
    index: int


@pytest.fixture
def shower(monkeypatch: pytest.MonkeyPatch) -> Shower:
    made = Shower(Path())
    monkeypatch.setattr("pdcd.cli.daemon.Client", lambda path: made)
    return made


WAIT, FOR = ("wait", {"job": JOB}, None), ("capture.wait", {"job": JOB}, 2.5)


@pytest.mark.parametrize(
    ("seconds", "end", "done", "code", "said"),
    [
        (None, None, [WAIT], 0, ["Ctrl-C ends", "ended by another command"]),
        (None, KeyboardInterrupt(), [WAIT, ("cancel", JOB)], 0, ["Ctrl-C ends"]),
        (None, UnreachableError("gone"), [WAIT], 3, ["Ctrl-C ends", "pdcd: gone"]),
        (2.5, None, [FOR], 0, ["for 2.5 s", "ended by another command"]),
        (2.5, KeyboardInterrupt(), [FOR, ("cancel", JOB)], 0, ["for 2.5 s"]),
        (2.5, UnreachableError("late"), [FOR, ("cancel", JOB)], 0, ["for 2.5 s"]),
    ],
)
def test_a_daemons_panels_show_a_picture_as_long_as_the_command_lives(
    shower: Shower,
    capsys: pytest.CaptureFixture[str],
    seconds: float | None,
    end: BaseException | None,
    done: list[Any],
    code: int,
    said: list[str],
) -> None:
    shower.end = end
    words = [] if seconds is None else ["--seconds", str(seconds)]
    assert main(["show", "code", "--index", "3", *words]) == code
    assert shower.done == [("show", "code", 3, False), *done, "closed"]
    printed = capsys.readouterr()
    assert printed.out == f"code 3 on the projector, its complement on the mask: job {JOB}\n"
    assert printed.err.splitlines() == said


@pytest.mark.parametrize("words", [["--detach"], ["--socket", "/nobody.sock"]])
def test_a_daemon_that_must_be_there_and_is_not_is_no_reason_to_show_it_here(
    monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    def nobody(path: Path) -> Any:
        raise UnreachableError("nobody")

    monkeypatch.setattr("pdcd.cli.daemon.Client", nobody)
    monkeypatch.setattr(panels_cli, "_show_here", lambda args: 77)
    assert main(["show", "grid", *words]) == 3
    assert main(["show", "grid"]) == 77


@pytest.mark.parametrize("missed", [0, 3])
def test_timing_prints_the_times_and_fails_for_what_was_missed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], missed: int
) -> None:
    ready = SimpleNamespace(refresh_hz=59.94, source="swap", identity={"renderer": "a card"})
    found = SimpleNamespace(
        missed=np.array([0, missed, 0]), ready=ready, table=lambda: [("drawing", 1.0, 2.5, 3.25)]
    )
    asked: list[Any] = []
    monkeypatch.setattr("pdcd.presenter.timing.measure_refreshes", noting(asked, found))
    monkeypatch.setattr("pdcd.presenter.timing.draw_histogram", noting(asked, None))
    code = 5 if missed else 0
    assert main(["timing", "--frames", "90"]) == code
    assert [line.split() for line in capsys.readouterr().out.splitlines()] == [
        ["ms", "median", "99", "%", "longest"], ["drawing", "1.000", "2.500", "3.250"],
        ["renderer:", "a", "card"],
        ["90", "refreshes", "at", "59.9400", "Hz,", str(missed), "missed"],
    ]  # fmt: skip
    assert main(["timing", "--json", "--out", "a.png"]) == code
    assert json.loads(capsys.readouterr().out) == {
        "refreshes": 3000, "missed": missed, "refresh_hz": 59.94, "source": "swap",
        "times": {"drawing": {"p50_ms": 1.0, "p99_ms": 2.5, "max_ms": 3.25}},
        "identity": {"renderer": "a card"},
    }  # fmt: skip
    assert asked == [(Config(), 90), (Config(), 3000), (found, Path("a.png"))]
