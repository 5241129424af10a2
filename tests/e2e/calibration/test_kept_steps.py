"""What a calibration found is kept whatever becomes of the rest, and the next one goes on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pdcd.bench import calibration as kept
from pdcd.bench.calibration import read_calibration
from pdcd.bench.choosing import CALIBRATIONS_FOLDER
from pdcd.bench.config import load_config
from pdcd.bench.measured import apply_calibration, choose_calibration
from pdcd.calibration import steps
from pdcd.calibration.check import check_step
from pdcd.calibration.script import CalibrationSession, StepScript
from pdcd.capture.again import recompute_calibration
from pdcd.cli.main import main
from pdcd.errors import CalibrationError, DeviceLost, PdcdError
from pdcd.protocol.events import Event
from pdcd.protocol.request import CalibrateRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.verify_calibration import verify_calibration
from tests.e2e.calibration.test_calibrate_job import bench
from tests.taken import calibrate_once, started, take_with

pytestmark = pytest.mark.whole

FEW = frozenset(steps.STEP_SCRIPTS) - {"geometry", "check"}
"""Steps that are left out of a whole calibration here, for these tests shall not last."""
KILLED = """
import sys
from pdcd.calibration import steps
steps.AT_WISH = frozenset(steps.STEP_SCRIPTS) - {"geometry", "check"}
from pdcd.cli.main import main
sys.exit(main(["calibrate", "--local", "--yes", "--config", sys.argv[1]]))
"""


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "AT_WISH", FEW)


def fail_at_check(monkeypatch: pytest.MonkeyPatch, err: Exception) -> None:
    def check(session: CalibrationSession) -> StepScript:
        raise err
        yield

    monkeypatch.setattr(check_step, "check_bench", check)


def calibrate(path: Path, job: str, *, cancel_at: str = "") -> tuple[CaptureResult, list[Event]]:
    """One calibration by an engine of its own, as a new process has it."""
    heard: list[Event] = []
    with started(load_config(path)) as engine:
        result = engine.calibrate(
            CalibrateRequest(),
            job=job,
            emit=heard.append,
            cancelled=lambda: (
                bool(cancel_at) and any(getattr(e, "step", "") == cancel_at for e in heard)
            ),
        )
        # What a photo goes by is what was kept, at once.
        used = take_with(engine, f"{job}-white", goal="white", codes=4).manifest.config
        kept_now = used["calibration"]["use"] == result.folder
        assert kept_now is bool(result.summary.get("used"))
    return result, heard


@pytest.mark.parametrize("how", ["failed", "cancelled", "broken"])
def test_a_step_that_fails_leaves_the_steps_before_it_in_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    path = bench(tmp_path, scene="open-book")
    errors = {
        "failed": CalibrationError("the room is too bright", hint="darken it"),
        "broken": RuntimeError("a fault of the program"),
    }
    with monkeypatch.context() as patch:
        if how in errors:
            fail_at_check(patch, errors[how])
        at = "check" if how == "cancelled" else ""
        result, _ = calibrate(path, "20260101T000000Z-0001", cancel_at=at)
    assert result.state == ("cancelled" if how == "cancelled" else "failed")
    assert (result.passed, result.summary["used"]) == (False, 1)
    assert any(text.startswith("kept: geometry") for text in result.warnings)
    folder = Path(str(result.folder))
    record, _ = read_calibration(folder)
    assert folder.parent == tmp_path / "state" / CALIBRATIONS_FOLDER and folder.name == record.name
    assert [s.name for s in record.steps] == ["meter", "geometry"] and record.stopped is not None
    assert (record.state, record.stopped.step) == (result.state, "check")
    if how == "failed":
        assert (record.stopped.message, record.stopped.hint) == (
            "the room is too bright",
            "darken it",
        )
    assert verify_calibration(folder).whole
    assert apply_calibration(load_config(path)).mask.place.map is not None
    if how != "failed":
        return  # all that comes later is alike
    assert recompute_calibration(folder).identical
    result, heard = calibrate(path, "20260101T000001Z-0001")
    assert result.state == "done" and result.passed and result.summary["used"]
    begun = [event for event in heard if event.type == "step_begun"]
    assert [getattr(e, "step", "") for e in begun] == ["meter", "check"]
    assert "goes on where 20260101T000000Z-0001 stopped: geometry" in getattr(begun[0], "note", "")
    record, _ = read_calibration(Path(str(result.folder)))
    assert record.measured["mask.place.map"].folder == str(folder)
    assert (Path(str(result.folder)) / kept.MAPS).read_bytes() == (folder / kept.MAPS).read_bytes()
    assert verify_calibration(Path(str(result.folder))).whole

    # That one came to its end: there is nothing to go on with.
    result, heard = calibrate(path, "20260101T000002Z-0001", cancel_at="meter")
    assert result.state == "cancelled" and not getattr(heard[0], "note", "")


def test_devices_that_go_away_take_nothing_with_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = bench(tmp_path)
    with monkeypatch.context() as patch:
        fail_at_check(patch, DeviceLost("the camera went away", device="camera"))
        result = calibrate_once(load_config(path)).result
    assert result.state == "failed" and result.error is not None
    assert result.error["kind"] == "device_lost"
    assert choose_calibration(load_config(path)).folder == Path(str(result.folder))


def test_a_disk_that_fills_up_at_the_end_leaves_what_was_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pdcd.runs.folder import RunFolder

    def full(*_: object) -> str:
        raise PdcdError("no room")

    path = bench(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "finish_with", full)
        result = calibrate_once(load_config(path)).result
    assert result.state == "failed" and str(result.folder).endswith(".partial")
    found = choose_calibration(load_config(path))
    assert found.folder == Path(str(result.folder)) / f"{kept.STEP_FOLDER_PREFIX}02"
    assert found.config.mask.place.map is not None


def test_a_killed_one_is_gone_on_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, log = bench(tmp_path), tmp_path / "log"
    with log.open("w") as out:
        child = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(path)],
            stdin=subprocess.DEVNULL, stdout=out, stderr=out,
        )  # fmt: skip
        until_s = time.monotonic() + 60.0
        while "check-" not in log.read_text():
            assert time.monotonic() < until_s and child.poll() is None, log.read_text()
            time.sleep(0.02)
        os.kill(child.pid, signal.SIGKILL)
        child.wait(30.0)
    (left,) = (p for p in (tmp_path / "state" / CALIBRATIONS_FOLDER).iterdir() if p.is_dir())
    assert left.name.endswith(".partial") and not (left / kept.RECORD).exists()
    words = ["--config", str(path)]
    assert main(["calibrate", "list", *words, "--json"]) == 0
    (one,) = map(json.loads, capsys.readouterr().out.splitlines())
    assert (one["fits"], one["in_use"], one["steps"]) == (True, True, {"geometry": "good"})
    name = left.name.removesuffix(".partial")
    assert one["name"] == name and Path(one["folder"]).parent == left

    assert main(["calibrate", "--local", "--yes", *words]) == 0
    said = capsys.readouterr()
    assert f"goes on where {name} stopped: geometry taken over" in said.err
    assert "\ngeometry: " not in said.out and "check: good" in said.out
    assert "verdict     good, in use" in said.out
    assert main(["calibrate", "list", *words]) == 0
    said_now = capsys.readouterr().out
    assert all(one in said_now for one in ("in use", "(taken over)", "cut short"))

    # By name, none, and the latest again.
    assert main(["calibrate", "use", "none", *words]) == 0
    assert apply_calibration(load_config(path)).mask.place.map is None
    assert main(["calibrate", "use", name, *words]) == 0
    assert apply_calibration(load_config(path)).calibration.use.startswith(str(left))
    assert main(["calibrate", "use", "gone", *words]) == 2
    assert main(["calibrate", "use", "latest", *words]) == 0
    assert main(["calibrate", "forget", name, *words]) == 2  # nobody is there to agree
    assert "--yes" in capsys.readouterr().err and left.exists()
    assert main(["calibrate", "forget", name, "--yes", *words]) == 0
    assert not left.exists()
    assert main(["calibrate", "forget", name, "--yes", *words]) == 2
    assert main(["calibrate", "list", "geometry", *words]) == 2


def test_what_does_not_fit_stops_no_capture_and_is_told_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two files of one home, as the README has them: one of a bench that was measured."""
    path, words = bench(tmp_path), ["--local", "--json"]
    assert main(["calibrate", "geometry", *words, "--config", str(path)]) == 0
    name = Path(json.loads(capsys.readouterr().out.splitlines()[-1])["folder"]).name
    other = tmp_path / "other.toml"
    other.write_text(path.read_text().replace("frame_quads = [300, 200]", "quads_per_cell = 2"))
    assert main(["config", "check", "--config", str(other)]) == 0
    said = capsys.readouterr().out
    assert "calibration: none" in said and f"passed over: {name}: camera.quads_per_cell" in said
    assert main(["plan", "indirect", "--local", "--config", str(other)]) == 0
    assert f"none is used; calibration {name}: camera.quads_per_cell" in capsys.readouterr().err
    assert main(["capture", "white", "--codes", "4", *words, "--config", str(other)]) == 0
    taken = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert sum(name in text for text in taken["warnings"]) == 1
    assert main(["config", "check", "--config", str(path)]) == 0
    assert f"{name}, 0.0 days old" in capsys.readouterr().out
    assert main(["calibrate", "use", name, "--config", str(other)]) == 2
    assert "its camera has 300 x 200 pixels, and this one" in capsys.readouterr().err
