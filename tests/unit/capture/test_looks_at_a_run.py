"""Whether a run is on the bench that was calibrated, with one camera; and who is told of it."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.capture import bench_check
from pdcd.capture.bench_check import FrameCheck, find_calibration_doubts, is_camera_turned
from pdcd.capture.job import EngineJob, Journal
from pdcd.errors import Cancelled, ConfigError, ExposureError
from pdcd.protocol import events
from pdcd.protocol.request import CaptureRequest


def config(**said: Any) -> Any:
    table = {"use": "/cals/b", "sha256": "0", "max_age_days": 30.0, "check": "never"}
    camera = SimpleNamespace(f_number=said.pop("f_number", "auto"))
    return SimpleNamespace(calibration=SimpleNamespace(**{**table, **said}), camera=camera)


def record(**said: Any) -> Any:
    seen = {
        "iso": 100, "f_number": 8.0, "camera_model": "EOS", "camera_serial": "1",
        "projector": "P", "mask": "", "projector_hz": 60.0, "mask_hz": 50.0, "flip": 5,
        "frame_quads": (600, 400), "truth": "",
    }  # fmt: skip
    return SimpleNamespace(
        name="b", measured=said.pop("measured", {}), bench=said.pop("bench", {}),
        verdict=said.pop("verdict", "bad"), left_out=said.pop("left_out", {}),
        stopped=said.pop("stopped", None), identity=SimpleNamespace(**{**seen, **said}),
        finished_utc="some day",
    )  # fmt: skip


def rig(**said: Any) -> Any:
    told = {
        "model": "EOS", "serial": "1", "hz": 50.0, "identity": {"projector": "P"},
        "frame_quads": None, **said,
    }  # fmt: skip
    camera = {name: told[name] for name in ("model", "serial", "frame_quads")}
    return SimpleNamespace(
        camera_info=SimpleNamespace(**camera),
        display_info=SimpleNamespace(refresh_hz=told["hz"], identity=told["identity"]),
    )


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The calibration in use, its age, and the newest one."""
    found: dict[str, Any] = {"record": record(), "days": 0.0, "newest": None}
    monkeypatch.setattr(bench_check, "read_calibration", lambda _: (found["record"], "0"))
    monkeypatch.setattr(bench_check, "compute_age_days", lambda _: found["days"])
    monkeypatch.setattr(
        bench_check, "find_newest_calibration",
        lambda folder, _, *, bad=False: found["newest"] if bad and folder == Path("/cals") else 0,
    )  # fmt: skip
    return found


def test_a_calibration_that_fits_raises_no_doubt(kept: dict[str, Any]) -> None:
    assert list(find_calibration_doubts(config(), rig(), 100)) == []
    kept["record"] = record(measured={"camera.profile": 1}, iso=100)
    assert list(find_calibration_doubts(config(f_number=8.0), rig(), 100)) == []
    kept["record"] = None  # none is in use
    assert list(find_calibration_doubts(config(sha256=None), rig(), 7)) == []


@pytest.mark.parametrize(
    ("f_number", "doubted"), [(8.4, False), (8.5, True), (7.6, False), (7.5, True)]
)
def test_another_aperture_is_doubtful_from_6_percent_on(
    f_number: float, doubted: bool, kept: dict[str, Any]
) -> None:
    found = list(find_calibration_doubts(config(f_number=f_number), rig(), 100))
    assert found == [f"calibration b was taken at f/8, not at f/{f_number:g}"] * doubted
    kept["record"] = record(f_number=None)
    assert list(find_calibration_doubts(config(f_number=f_number), rig(), 100)) == []


def test_another_iso_matters_where_the_sensor_was_measured(kept: dict[str, Any]) -> None:
    assert list(find_calibration_doubts(config(), rig(), 200)) == []
    kept["record"] = record(measured={"camera.profile": 1})
    words = "calibration b measured the sensor at ISO 100, not at ISO 200"
    assert list(find_calibration_doubts(config(), rig(), 200)) == [words]


@pytest.mark.parametrize(("name", "doubted"), [("a", False), ("b", False), ("c", True)])
def test_a_later_calibration_that_is_bad_is_told_of(
    name: str, doubted: bool, kept: dict[str, Any]
) -> None:
    kept["newest"] = Path("/cals") / name
    found = list(find_calibration_doubts(config(), rig(), 100))
    assert len(found) == doubted and all("c, a calibration or check after b" in t for t in found)


def test_what_a_calibration_could_not_find_is_told_of(kept: dict[str, Any]) -> None:
    kept["record"] = record(left_out={"timing": "bad", "shutter": "it goes by timing"})
    (said,) = find_calibration_doubts(config(), rig(), 100)
    assert "timing: bad; shutter: it goes by timing" in said and "calibration b" in said
    kept["record"] = record(stopped=SimpleNamespace(step="timing", message="too bright"))
    (said,) = find_calibration_doubts(config(), rig(), 100)
    assert "stopped at timing: too bright" in said and "goes on from there" in said


@pytest.mark.parametrize(
    ("days", "check", "count"),
    [
        (30.0, "never", 0), (30.1, "never", 1), (math.nan, "never", 1), (1.0, "daily", 0),
        (1.01, "daily", 1), (1.0 / 24.0, "always", 0), (0.05, "always", 1), (31.0, "daily", 2),
        (-0.5, "daily", 0), (-2.0, "never", 1),
    ],
)  # fmt: skip
def test_an_old_calibration_is_to_be_checked_or_made_again(
    days: float, check: str, count: int, kept: dict[str, Any]
) -> None:
    kept["days"] = days
    found = list(find_calibration_doubts(config(check=check), rig(), 100))
    assert len(found) == count
    if check != "never" and count:
        assert found[-1] == (
            f"the bench has not been checked for {24.0 * days:.0f} h: run pdcd calibrate check"
        )


@pytest.mark.parametrize(
    ("said", "device"),
    [
        ({"model": "other"}, "camera"), ({"serial": "2"}, "camera"),
        ({"frame_quads": (300, 200)}, "camera"), ({"frame_quads": (600, 400)}, None),
        ({"identity": {"projector": "Q"}}, "projector"), ({"hz": 50.06}, "display"),
        ({"hz": 49.94}, "display"), ({"hz": 60.0}, "display"), ({"hz": 50.04}, None),
        ({"identity": {}}, None), ({"identity": {"projector": "P", "mask": "M"}}, None),
    ],
)  # fmt: skip
def test_a_calibration_of_other_devices_is_refused(
    said: dict[str, Any], device: str | None, kept: dict[str, Any]
) -> None:
    if device is None:
        assert list(find_calibration_doubts(config(), rig(**said), 100)) == []
        return
    with pytest.raises(ConfigError) as told:
        list(find_calibration_doubts(config(), rig(**said), 100))
    assert told.value.device == device and "pdcd calibrate" in str(told.value.hint)


def test_devices_that_are_not_open_are_no_others(kept: dict[str, Any]) -> None:
    closed: Any = SimpleNamespace(camera_info=None, display_info=None)
    assert list(find_calibration_doubts(config(), closed, 100)) == []


@pytest.mark.parametrize(
    ("then", "flip", "held"), [(5, 5, False), (5, 6, True), (None, 6, False), (0, 5, True)]
)
def test_a_camera_that_is_held_another_way(
    then: int | None, flip: int, held: bool, kept: dict[str, Any]
) -> None:
    kept["record"] = record(flip=then)
    assert is_camera_turned(config(), flip) is held
    assert is_camera_turned(config(sha256=None), flip) is False


def head(
    rows: int = 4, cols: int = 6, turned: str = "upright", model: str = "EOS", colours: int = 3
) -> Any:
    return SimpleNamespace(frame=(rows, cols), turned=turned, model=model, flip=0, colours=colours)


def frame_check(
    warned: list[str], frame_quads: tuple[int, int] | None = (6, 4), colours: int = 3
) -> FrameCheck:
    camera: Any = SimpleNamespace(frame_quads=frame_quads, colours=colours, profile="modern")
    journal: Any = SimpleNamespace(warn=warned.append)
    return FrameCheck(config(sha256=None), camera, journal)


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (head(4, 7), "raw/b is unlike raw/a: its size is 7 x 4 quads, not 6 x 4 quads"),
        (head(turned="left"), "raw/b is unlike raw/a: its orientation is left, not upright"),
        (head(model=""), "raw/b is unlike raw/a: its camera is unnamed, not EOS"),
    ],
)
def test_photos_of_a_run_are_alike(other: Any, words: str) -> None:
    warned: list[str] = []
    seen = frame_check(warned)
    seen.saw("raw/a", head())
    seen.saw("raw/a2", head())
    with pytest.raises(ExposureError) as told:
        seen.saw("raw/b", other)
    assert (told.value.message, told.value.device, warned) == (words, "camera", [])


def test_photos_of_another_number_of_colours_are_refused_at_the_first() -> None:
    with pytest.raises(ConfigError, match="raw/a has colours, no colours were expected") as told:
        frame_check([], colours=1).saw("raw/a", head())
    assert told.value.hint == "choose a camera.profile without mono = true"
    with pytest.raises(ConfigError, match="raw/a has no colours, colours were expected") as told:
        frame_check([]).saw("raw/a", head(colours=1))
    assert told.value.hint == "choose a camera.profile with mono = true"


def test_a_camera_whose_photos_are_of_another_size_than_it_says_is_told_of(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    warned: list[str] = []
    frame_check(warned, None).saw("raw/a", head())
    assert warned == []
    frame_check(warned, (4, 6)).saw("raw/a", head())
    assert len(warned) == 1 and warned[0].startswith("photos have 6 x 4 quads, not the 4 x 6 that")
    grey: list[str] = []
    frame_check(grey, (4, 6), colours=1).saw("raw/a", head(colours=1))
    assert grey[0].startswith("photos have 6 x 4 pixels, not the 4 x 6 that")
    monkeypatch.setattr("pdcd.capture.bench_check.is_camera_turned", lambda _, flip: flip == 0)
    frame_check(warned).saw("raw/a", head())
    assert "turned since it was calibrated" in warned[1]


@pytest.mark.parametrize("there", [True, False])
def test_a_journal_writes_tells_and_then_asks(there: bool) -> None:
    steps: list[Any] = []

    def cancelled() -> bool:
        steps.append("asked")
        return True

    folder: Any = SimpleNamespace(log=steps.append, where="/x" if there else None)
    clock: Any = SimpleNamespace(now_ns=lambda: 99)
    ledger: Any = SimpleNamespace(warn=steps.append)
    job = EngineJob("job", CaptureRequest(goal="white"), None, steps.append, cancelled)
    journal = Journal(job, folder, clock, [], ledger)
    event = events.PilotLearning(photos=3)
    with pytest.raises(Cancelled):
        journal.notify(event)
    assert steps == [{"t_mono_ns": 99, "event": "learning", "photos": 3}, event, "asked"]
    journal.warn("dim")
    assert journal.warnings == ["dim"] and steps[3:] == ["dim"] * there
