"""`pdcd calibrate`: what it asks, whom, and how it says what came of it."""

from __future__ import annotations

import json
import select
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.bench.calibration import FigureRecord
from pdcd.cli import calibrate as calibrate_cli
from pdcd.cli.main import main
from pdcd.errors import Cancelled
from pdcd.protocol.events import StepEnded
from pdcd.protocol.request import CalibrateRequest
from pdcd.protocol.result import CaptureResult, Quality
from tests.unit.cli.cli_stubs import JOB, StubClient, StubEngine, stub_engine


def record(name: str, value: float | None, sigma: float | None = None, unit: str = "") -> Any:
    return FigureRecord(name=name, value=value, sigma=sigma, unit=unit, limit="< 9", verdict="good")


STEP = StepEnded(
    job=JOB, seq=0, t_mono_ns=1, step="lag", verdict="doubtful", photos=7, seconds=1.25,
    figures=(record("lag", 12.3456, 0.123, "ms"), record("gain", 2.0), record("noise", None, 0.5),
             record("slope", 3.0, 0.0, "e-")),
    advice=("measure again",),
)  # fmt: skip


class Calibrator(StubClient):
    """Calibrates by answering with one step."""

    def calibrate(self, request: Any, *, queue: bool, on_event: Any, answer: Any) -> CaptureResult:
        on_event(STEP)
        return self._answer(request, queue)


@pytest.fixture
def calibrator(monkeypatch: pytest.MonkeyPatch) -> type[Calibrator]:
    class Fresh(Calibrator):
        asked: list[Any] = []  # noqa: RUF012
        result = CaptureResult(
            job=JOB, state="done", folder="/c", summary={"verdict": "good", "photos": 7, "used": 1}
        )

    monkeypatch.setattr("pdcd.cli.daemon.Client", Fresh)
    return Fresh


def test_every_figure_of_a_calibration_is_printed_with_its_limit(
    calibrator: type[Calibrator], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "timing", "--queue", "--yes"]) == 0
    assert calibrator.asked[:2] == [
        tmp_path / "pdcd.sock", (CalibrateRequest(steps=("timing",), attended=False), True),
    ]  # fmt: skip
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "lag: doubtful, 7 photos, 1.2 s of computing"
    assert [line.split() for line in lines[1:6]] == [
        ["figure", "value", "limit", "verdict"],
        ["lag", "12.35", "+-", "0.12", "ms", "<", "9", "good"],
        ["gain", "2", "<", "9", "good"], ["noise", "unknown", "<", "9", "good"],
        ["slope", "3", "e-", "<", "9", "good"],
    ]  # fmt: skip
    assert lines[6].split() == ["measure", "again"]
    assert [line.split(maxsplit=1) for line in lines[7:]] == [
        ["verdict", "good, in use"], ["photos", "7"], ["folder", "/c"],
        ["to", "look at  /c/preview"],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("state", "verdict", "code", "words"),
    [
        ("done", "bad", 5, "bad, in use; bad steps are left out: mend them, and calibrate again"),
        ("done", "doubtful", 0, "doubtful, in use"), ("failed", "bad", 5, None),
        ("cancelled", "good", 130, None),
    ],
)  # fmt: skip
def test_a_bad_calibration_fails_and_what_is_bad_is_not_used(
    calibrator: type[Calibrator],
    capsys: pytest.CaptureFixture[str],
    state: Any,
    verdict: str,
    code: int,
    words: str | None,
) -> None:
    calibrator.result = CaptureResult(
        job=JOB, state=state, folder="/c", warnings=("dust",),
        summary={
            "verdict": verdict, "used": 1,
            "quality": Quality(verdict="doubtful", reasons=("dark",)),
        },
    )  # fmt: skip
    assert main(["calibrate"]) == code
    out = capsys.readouterr().out
    assert words is None or words in " ".join(out.split())
    assert "warning: dust" in out and "doubtful: dark" in out
    assert main(["calibrate", "--json"]) == code
    assert json.loads(capsys.readouterr().out)["summary"]["verdict"] == verdict


@pytest.mark.parametrize(
    ("terminal", "words", "attended"),
    [(True, [], True), (False, [], False), (True, ["--yes"], False), (True, ["--json"], False)],
)
def test_somebody_is_asked_where_somebody_is_there(
    calibrator: type[Calibrator],
    monkeypatch: pytest.MonkeyPatch,
    terminal: bool,
    words: list[str],
    attended: bool,
) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: terminal))
    assert main(["calibrate", *words]) == 0
    assert calibrator.asked[1] == (CalibrateRequest(steps=(), attended=attended), False)


def test_a_scene_may_stand_in_the_place_of_the_card(calibrator: type[Calibrator]) -> None:
    typed = ["calibrate", "geometry", "--scene", "--marks", "phase", "--anew", "--yes"]
    assert main(typed) == 0
    asked = CalibrateRequest(steps=("geometry",), subject="scene", marks="phase", anew=True)
    assert calibrator.asked[1] == (asked, False)


@pytest.mark.parametrize("identical", [True, False])
def test_a_calibration_that_is_computed_again_is_compared(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], identical: bool
) -> None:
    items = [SimpleNamespace(name="lag", identical=True),
             SimpleNamespace(name="gain", identical=identical)]  # fmt: skip
    asked: list[Path] = []

    def again(folder: Path) -> SimpleNamespace:
        asked.append(folder)
        return SimpleNamespace(items=items)

    monkeypatch.setattr("pdcd.capture.again.recompute_calibration", again)
    assert main(["calibrate", "--again", "f"]) == (0 if identical else 5)
    second = "identical  gain" if identical else "DIFFERS    gain"
    assert capsys.readouterr().out.splitlines() == ["identical  lag", second]
    assert asked == [Path("f")]


@pytest.mark.parametrize("fails", [True, False])
def test_a_rig_of_this_process_is_stopped_whatever_comes_of_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], fails: bool
) -> None:
    engine = stub_engine(monkeypatch)

    def calibrate(self: StubEngine, request: Any, **how: Any) -> CaptureResult:
        how["emit"](STEP)
        self.calls.append((request, sorted(how), how["cancelled"](), len(how["job"])))
        if fails:
            raise Cancelled("ended")
        return CaptureResult(
            job=JOB, state="done", folder="/c", summary={"verdict": "good", "used": 1}
        )

    monkeypatch.setattr(engine, "calibrate", calibrate, raising=False)
    assert main(["calibrate", "timing", "--local"]) == (130 if fails else 0)
    _, start, asked, stop = engine.calls
    assert (start, stop) == ("start", "stop")
    names = ["cancelled", "emit", "job", "out", "proceed"]
    assert asked == (CalibrateRequest(steps=("timing",), attended=False), names, False, len(JOB))
    assert ("in use" in capsys.readouterr().out) == (not fails)


@pytest.mark.parametrize("answered", [True, False])
def test_who_is_asked_may_press_return_or_give_up(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], answered: bool
) -> None:
    looks: list[float] = []
    read: list[str] = []

    def look(readers: list[Any], _: Any, __: Any, wait_s: float) -> Any:
        looks.append(wait_s)
        return (readers * (answered and len(looks) == 3), [], [])

    monkeypatch.setattr(select, "select", look)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(readline=lambda: read.append("line")))
    ask = calibrate_cli._asker(lambda: len(looks) == 5)
    ask("put the card there")
    assert capsys.readouterr().err == "put the card there; then press Return\n"
    assert looks == [0.1] * (3 if answered else 5) and len(read) == answered
