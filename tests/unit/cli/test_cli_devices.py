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
    ready = SimpleNamespace(refresh_hz=59.94, identity={"renderer": "a card"})
    found = SimpleNamespace(
        missed=np.array([0, missed, 0]), ready=ready, table=lambda: [("drawing", 1.0, 2.5, 3.25)]
    )
    monkeypatch.setattr("pdcd.presenter.timing.measure_refreshes", lambda *asked: found)
    assert main(["timing", "--frames", "90"]) == (5 if missed else 0)
    assert [line.split() for line in capsys.readouterr().out.splitlines()] == [
        ["ms", "median", "99", "%", "longest"], ["drawing", "1.000", "2.500", "3.250"],
        ["renderer:", "a", "card"],
        ["90", "refreshes", "at", "59.9400", "Hz,", str(missed), "missed"],
    ]  # fmt: skip
