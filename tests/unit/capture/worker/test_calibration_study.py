"""The study of a calibration: its steps ask for photos, and what they found is kept."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.bench.calibration import CALIBRATION_ARRAYS, MAPS, PROFILE
from pdcd.bench.tables import Config
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.script import ConfigValue, PhotoRequest, StepOutcome, StepScript, UserPrompt
from pdcd.calibration.shown import PanelSequence
from pdcd.capture.worker import calibrating
from pdcd.capture.worker.calibrating import (
    CalibrationStart,
    CalibrationStudy,
    NextPhoto,
    OperatorTask,
    StepResult,
    read_arrays,
    write_arrays,
)
from pdcd.errors import CalibrationError, DiskError, PdcdError
from pdcd.panels.map import Map
from pdcd.panels.map_file import load_map

UTC = "2026-01-01T12:00:00Z"


def test_arrays_come_back_as_they_were_written(tmp_path: Path) -> None:
    arrays = {"b": np.arange(6.0).reshape(2, 3), "a": np.array([True, False])}
    write_arrays(tmp_path / "x.npz", arrays)
    write_arrays(tmp_path / "y.npz", dict(reversed(arrays.items())))
    assert (tmp_path / "x.npz").read_bytes() == (tmp_path / "y.npz").read_bytes()
    back = read_arrays(tmp_path / "x.npz")
    assert back.keys() == arrays.keys()
    assert all(np.array_equal(back[name], arrays[name]) for name in arrays)
    assert read_arrays(tmp_path / "none.npz") == {}


def test_a_calibration_that_keeps_no_arrays_is_one_to_go_on_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As that of the focus alone, with which a bench is set up."""

    def script() -> StepScript:
        yield UserPrompt("turn the ring")
        return StepOutcome()

    one = study(tmp_path, monkeypatch, script())
    one.begin("focus", UTC)
    assert isinstance(one.answered(), StepResult)
    one.write()
    assert (
        not (tmp_path / CALIBRATION_ARRAYS).exists()
        and read_arrays(tmp_path / CALIBRATION_ARRAYS) == {}
    )


def test_arrays_that_are_none_are_refused(tmp_path: Path) -> None:
    for wrong in (np.nan, np.inf):
        with pytest.raises(ValueError, match="array a"):
            write_arrays(tmp_path / "x.npz", {"a": np.array([1.0, wrong])})
    assert not (tmp_path / "x.npz").exists()
    (tmp_path / "x.npz").write_bytes(b"PK nothing")
    with pytest.raises(CalibrationError, match="cannot be used"):
        read_arrays(tmp_path / "x.npz")
    with pytest.raises(CalibrationError, match="cannot be used: it is a folder"):
        read_arrays(tmp_path)
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(CalibrationError, match="cannot be used: it is a FIFO"):
        read_arrays(tmp_path / "pipe.npz")  # nobody writes into it: it would be waited for for ever


def study(
    folder: Path, monkeypatch: pytest.MonkeyPatch, script: StepScript, **begin: Any
) -> CalibrationStudy:
    camera: Any = SimpleNamespace(isos=(400, 100, 200))
    profile: Any = object()
    monkeypatch.setattr(calibrating, "start_step_script", lambda step, session: script)
    return CalibrationStudy.begun(CalibrationStart(Config(), profile, camera, **begin), folder)


def shown(name: str) -> PanelSequence:
    none = np.zeros((0, 1, 1), np.bool_)
    index = np.full(2, -1, np.int32)
    return PanelSequence(name, none, none, index, index)


def test_a_step_asks_and_ends_with_what_it_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "preview").mkdir()
    figures = (
        MeasuredFigure("a", 1.5, np.inf, "s", "below 2", Verdict.GOOD),
        MeasuredFigure("b", np.nan, 0.25, "px", "", Verdict.DOUBTFUL),
        MeasuredFigure("c", 1.0, 0.0, "", "", Verdict.DOUBTFUL),
    )
    words = {"mask.skew_s": ConfigValue(0.001, 1e-4), "mask.rise_s": ConfigValue(0.002)}
    maps = {"mask": Map.filling((40, 30))}

    def script() -> StepScript:
        assert (yield PhotoRequest(shown("dots"))) is None
        assert (yield UserPrompt("cover the lens")) is None
        yield PhotoRequest(shown("dark"), iso=400, f_number=5.6, covered=True)
        return StepOutcome(
            figures,
            words,
            maps,
            {"kept": np.ones(2)},
            advice=("clean it",),
            picture=lambda figure: figure.suptitle("dots"),
        )

    one = study(tmp_path, monkeypatch, script(), helped=True)
    first = one.begin("geometry", UTC)
    assert isinstance(first, NextPhoto)
    assert (first.name, first.iso, first.f_number) == ("geometry-dots", 100, None)
    assert not first.covered and first.frames.primal_index.size == 2
    asked = one.answered()
    assert isinstance(asked, OperatorTask) and asked.ask.text == "cover the lens"
    last = one.answered()
    assert isinstance(last, NextPhoto)
    assert (last.name, last.iso, last.f_number, last.covered) == ("geometry-dark", 400, 5.6, True)
    found = one.answered()
    assert isinstance(found, StepResult)
    step = found.step
    assert (step.name, step.made_utc, step.verdict) == ("geometry", UTC, "doubtful")
    assert [(f.value, f.sigma, f.verdict) for f in step.figures] == [
        (1.5, None, "good"), (None, 0.25, "doubtful"), (1.0, 0.0, "doubtful"),
    ]  # fmt: skip
    assert (step.figures[0].name, step.figures[0].unit, step.figures[0].limit) == (
        "a", "s", "below 2",
    )  # fmt: skip
    assert step.advice == ("clean it",) and step.photos == () and step.seconds >= 0.0
    assert step.settings == {"iso": 100.0, "full_refreshes": 0.0, "helped": 1.0}
    assert (tmp_path / "preview" / "geometry.png").exists()
    with pytest.raises(PdcdError, match="no step"):
        one.answered()
    entries = one.write()
    assert entries["mask.skew_s"].value == 0.001
    assert {(e.step, e.made_utc, e.folder) for e in entries.values()} == {("geometry", UTC, None)}
    assert entries["mask.skew_s"].sigma == 1e-4 and entries["mask.rise_s"].sigma is None
    assert one.session.config.mask.skew_s == 0.001 and one.session.done == ["geometry"]
    assert [*read_arrays(tmp_path / CALIBRATION_ARRAYS)] == ["kept"]
    assert load_map(tmp_path / MAPS, "mask").size_px == (40, 30)
    assert not (tmp_path / PROFILE).exists()


def test_what_is_bad_is_kept_out_with_what_goes_by_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def script(key: str, verdict: Verdict) -> StepScript:
        yield UserPrompt("wait")
        figure = MeasuredFigure("a", 1.0, 0.0, "", "", verdict)
        maps = {"mask": Map.filling((40, 30))} if key == "rig.misregistration_px" else {}
        return StepOutcome((figure,), {key: ConfigValue(0.5)}, maps, {key: np.ones(2)})

    one = study(tmp_path, monkeypatch, script("", Verdict.GOOD))
    left_out = {}
    for step, key, verdict in (
        ("light", "mask.contrast", Verdict.DOUBTFUL),
        ("timing", "mask.skew_s", Verdict.BAD),
        ("shutter", "trigger.lag_s", Verdict.GOOD),
        ("registration", "rig.misregistration_px", Verdict.GOOD),
        ("response", "mask.gamma", Verdict.GOOD),
    ):
        monkeypatch.setattr(
            calibrating, "start_step_script", lambda *_, k=key, v=verdict: script(k, v)
        )
        one.begin(step, UTC)
        found = one.answered()
        assert isinstance(found, StepResult)
        left_out[step] = found.left_out
    assert left_out == {
        "light": "", "timing": "bad", "shutter": "it goes by timing",
        "registration": "it goes by timing", "response": "",
    }  # fmt: skip
    assert one.write("kept").keys() == {"mask.contrast", "mask.gamma"}
    assert read_arrays(tmp_path / "kept" / CALIBRATION_ARRAYS).keys() == {
        "mask.contrast",
        "mask.gamma",
    }
    assert not (tmp_path / "kept" / MAPS).exists()
    # The rest of this calibration goes by what was seen, for what is told of it.
    assert one.session.config.mask.skew_s == 0.5


def test_a_calibration_begins_with_the_arrays_of_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = tmp_path / "before"
    before.mkdir()
    write_arrays(before / CALIBRATION_ARRAYS, {"old": np.ones(3)})

    def script() -> StepScript:
        yield UserPrompt("wait")
        return StepOutcome()

    one = study(tmp_path, monkeypatch, script(), before=before)
    assert [*one.session.arrays] == ["old"] and not one.session.helped
    one.session.f_number, one.session.full = 8.0, 30
    one.photos, one.seconds = [object()], 5.0  # type: ignore[list-item]
    assert isinstance(one.begin("timing", UTC), OperatorTask)
    assert one.photos == [] and one.seconds < 5.0
    assert one.settings == {
        "iso": 100.0, "full_refreshes": 30.0, "helped": 0.0, "f_number": 8.0,
    }  # fmt: skip
    assert one.write() == {} and not (tmp_path / MAPS).exists()
    one.folder = tmp_path / "gone"
    with pytest.raises(DiskError):
        one.write()


def test_an_error_of_a_script_is_not_taken_for_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def script() -> StepScript:
        yield UserPrompt("wait")
        raise CalibrationError("no dots were seen")

    one = study(tmp_path, monkeypatch, script())
    one.begin("geometry", UTC)
    with pytest.raises(CalibrationError, match="no dots"):
        one.answered()
