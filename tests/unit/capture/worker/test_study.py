"""What a worker keeps and tells: figures of an answer, leaks, steps of a calibration, guards."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
import scipy.sparse
from numpy.typing import NDArray

from pdcd.bench.calibration import CALIBRATION_ARRAYS, MAPS, PROFILE
from pdcd.bench.tables import Config, LimitsConfig
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.script import ConfigValue, PhotoRequest, StepOutcome, StepScript, UserPrompt
from pdcd.calibration.shown import PanelSequence
from pdcd.capture.worker import calibrating, leak_check
from pdcd.capture.worker.answers import RigFacts, compute_rms_sigma, compute_transport_figures
from pdcd.capture.worker.calibrating import (
    CalibrationStart,
    CalibrationStudy,
    NextPhoto,
    OperatorTask,
    StepResult,
    read_arrays,
    write_arrays,
)
from pdcd.capture.worker.leak_check import AmbientResponse
from pdcd.capture.worker.worker import Worker
from pdcd.errors import CalibrationError, DiskError, PdcdError
from pdcd.panels.map import Map
from pdcd.panels.map_file import load_map
from pdcd.pictures.leaks import DarkPhotoLight, LeakAnswer
from pdcd.pictures.picture import Picture
from pdcd.pictures.transport import TransportSlice
from pdcd.planning.guided import end_pilot, with_links
from pdcd.planning.make import make_plan
from pdcd.protocol.plan_summary import LeakErrors
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.record import DarkPhoto
from pdcd.watch import Watch

UTC = "2026-01-01T12:00:00Z"


@pytest.mark.parametrize(
    ("image", "sigma", "wanted"),
    [
        ([3.0, 4.0, 9.0], [0.3, 0.4, np.inf], 0.1),
        ([0.03, 0.04, 0.0], [0.03, 0.04, 0.0], 1.0),  # however dark
        ([0.0, 0.0, 1.0], [1.0, 1.0, np.inf], np.inf),
        ([1.0, 1.0, 1.0], [np.inf] * 3, np.inf),
    ],
)
def test_sigma_over_image_where_it_is_known(
    image: list[float], sigma: list[float], wanted: float
) -> None:
    picture = Picture(np.array([[image]]), np.array([[sigma]]))
    assert compute_rms_sigma(picture) == pytest.approx(wanted)


def sliced(sigma: float) -> TransportSlice:
    cells = np.array([0, 1])
    entries = np.full((2, 2, 3), 2.0)
    return TransportSlice(entries, np.full(entries.shape, sigma), cells, cells, 7, 0.0, 0.0)


def known_scene(truth: float, textures: object = None, grid: tuple[int, int] = (1, 2)) -> Any:
    def apply(light: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.full((*light.shape, 3), truth)

    return SimpleNamespace(grid=grid, textures=textures, cells=2, apply=apply)


@pytest.mark.parametrize(
    ("scene", "pixels", "error"),
    [
        (known_scene(1.0), False, 1.0),
        (known_scene(1.0), True, 1.0),
        (known_scene(1.0, "grain"), False, 1.0),
        (known_scene(1.0, "grain"), True, None),  # entries of cells are not what is seen there
        (known_scene(1.0, grid=(2, 1)), False, None),
        (known_scene(0.0), False, None),
        (None, False, None),
    ],
)
def test_entries_of_t_are_compared_where_their_truth_is_known(
    scene: Any, pixels: bool, error: float | None
) -> None:
    told = compute_transport_figures(sliced(0.5), scene, (1, 2), pixels=pixels)
    assert told == {"transport_photos": 7, "transport_sigma": 0.25, "transport_error": error}


def test_of_entries_that_are_not_there_or_not_known_nothing_is_told() -> None:
    assert compute_transport_figures(None, known_scene(1.0), (1, 2), pixels=False) == {}
    told = compute_transport_figures(sliced(np.inf), None, (1, 2), pixels=False)
    assert told["transport_sigma"] is None


MEANS = SimpleNamespace(panels={})
DARKS = (
    DarkPhoto(raw="raw/one", sha256="", iso=100, f_number=8.0, exposure_s=9.0, phase_s=2.0),
    DarkPhoto(raw="raw/two", sha256="", iso=100, f_number=8.0, exposure_s=9.0, phase_s=4.0),
)


AMBIENT = LeakErrors(ambient=5.0, mask=0.0, both=5.0, floor=0.0, limit=0.01, raw=())


def leaks(
    monkeypatch: pytest.MonkeyPatch,
    light: dict[str, float],
    darks: Any,
    before: DarkPhoto | None = None,
) -> Any:
    """Of an answer of brightness 1, open for 3 s and behind a closed mask for 5 s, and one that
    takes nothing of any leak. The former is made of photos open for 4 s less others of 1 s."""

    def answer(opened: float, closed: float) -> LeakAnswer:
        one = np.ones((2, 3))
        seen = np.ones(2, np.bool_)
        gross = np.array([opened + 1.0, 1.0])[:, None, None] * one[None, :, :1]
        return LeakAnswer(one, 0.0 * one, opened * one[:, :1], closed * one[:, :1], seen, gross)

    answers = [answer(3.0, 5.0), answer(0.0, 0.0)]
    monkeypatch.setattr(leak_check, "make_leak_answers", lambda *_, **__: answers)
    darkroom: Any = SimpleNamespace(
        means=lambda watch: (SimpleNamespace(shots=()), MEANS),
        record=SimpleNamespace(normalise="row"),
        dark_means=lambda photo: DarkPhotoLight(
            np.full((2, 3), light[photo.raw] / photo.phase_s), np.full((2, 3), 1e-13)
        ),
    )
    plan: Any = SimpleNamespace(look=SimpleNamespace(limit=0.01))
    return leak_check.estimate_leaks(plan, darkroom, darks, Watch(), before)


def test_one_dark_photo_tells_the_most_that_leaks_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    found = leaks(monkeypatch, {"raw/one": 0.02}, DARKS[:1])
    # 0.01 a second, for 5 s at most, of an answer that is 1 with it.
    assert found.both == pytest.approx(0.05 / 0.95, rel=1e-4)
    assert (found.ambient, found.mask) == (None, None)
    assert (found.limit, found.raw) == (0.01, ("raw/one",))
    assert 0.0 < found.floor < 1e-4


def test_two_dark_photos_tell_whose_a_leak_is(monkeypatch: pytest.MonkeyPatch) -> None:
    found = leaks(monkeypatch, {"raw/one": 0.02, "raw/two": 0.016}, DARKS)
    # 0.004 a second through the open mask; what is left of 0.01 came of the lit projector.
    assert found.ambient == pytest.approx(0.012 / 0.988, rel=1e-4)
    assert found.mask == pytest.approx(0.03 / 0.97, rel=1e-4)
    assert found.both == pytest.approx(0.042 / 0.958, rel=1e-4)
    assert found.raw == ("raw/one", "raw/two")


def test_a_room_that_changed_counts_for_all_photos_of_one_sign(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """0.004 a second came between: 4 s of it got into what counts for the answer, and none into
    what is taken off that."""
    before = msgspec.structs.replace(DARKS[0], raw="raw/zero")
    light = {"raw/zero": 0.0, "raw/one": 0.02, "raw/two": 0.016}
    found = leaks(monkeypatch, light, DARKS, before)
    assert found.changed == pytest.approx(0.016 / 0.984, rel=1e-4)


@pytest.mark.parametrize(("ambient", "known"), [(0.02, True), (0.01, False), (None, False)])
def test_only_ambient_light_that_matters_is_taken_off_a_pilot(
    ambient: float | None, known: bool
) -> None:
    leaks = LeakErrors(ambient=ambient, mask=0.5, both=0.5, floor=0.0, limit=0.01, raw=())
    plan = replace(
        make_plan(CaptureRequest(goal="indirect", codes=8), Config(), (3, 4)), leaks=leaks
    )
    darkroom: Any = SimpleNamespace(
        means=lambda watch: (SimpleNamespace(shots=()), MEANS), learned=lambda watch: None
    )
    after: list[Any] = []
    mended = AmbientResponse(CaptureRequest(goal="indirect"), Config(), None, None, average=False)
    found = mended.after(plan, DARKS[1], darkroom, after.append, Watch())
    assert (found.told, found.decided) == ((), "")
    assert after[-1].dark == (DARKS[1] if known else None)
    assert replace(after[-1], dark=None) == plan


@pytest.mark.parametrize("memory", [2**32, 1])
def test_a_pilot_goes_on_where_ambient_light_had_hidden_what_it_looks_for(
    memory: int,
) -> None:
    request = CaptureRequest(goal="indirect", codes=128, pilot=16, window="whole", white=False)
    before = make_plan(request, Config(), (6, 8))
    ended = replace(end_pilot(before, 0, 60.0), leaks=AMBIENT)
    limits = LimitsConfig(work_bytes=memory)
    mended = AmbientResponse(request, Config(limits=limits), None, before, average=False)
    seen: Any = SimpleNamespace(promising=True, sharpness=0.4, pays=False)
    darkroom: Any = SimpleNamespace(
        means=lambda watch: (SimpleNamespace(shots=()), MEANS), learned=lambda watch: seen
    )
    after: list[Any] = []
    found = mended.after(ended, DARKS[1], darkroom, after.append, Watch())
    plan = after[-1]
    if memory == 1:  # there is none for it
        assert (plan.how, found.told) == (ended.how, ())
        return
    assert (plan.how.pilot, plan.how.coded, plan.how.late) == (16, 112, True)
    assert found.told == (plan.reasons[-1],) and "sharpness 0.4 without it" in found.told[0]
    assert plan.dark == DARKS[1] and plan.leaks == AMBIENT
    names = [shot.name for shot in plan.recipe.shots]
    assert names[:16] == list(before.recipe.stack) and names[16] == "coded-late"


def test_a_map_that_is_clearer_guides_the_codes_that_were_not_shown() -> None:
    request = CaptureRequest(goal="indirect", codes=80, pilot=16, parts=4, white=False)
    plan = replace(make_plan(request, Config(), (6, 8)), leaks=AMBIENT)
    links = scipy.sparse.csr_array(np.eye(48, k=5))
    seen: Any = SimpleNamespace(promising=True, pays=True, links=links)
    darkroom: Any = SimpleNamespace(
        means=lambda watch: (SimpleNamespace(shots=()), SimpleNamespace(panels={"coded-1": None})),
        learned=lambda watch: seen,
    )
    after: list[Any] = []
    mended = AmbientResponse(request, Config(), None, None, average=False)
    mended.after(plan, DARKS[1], darkroom, after.append, Watch())
    found = after[-1].patterns
    assert found["coded-1"] is plan.patterns["coded-1"] and found["pilot"] is plan.patterns["pilot"]
    wanted = with_links(plan, links, request.seed).patterns
    for part in (2, 3, 4):
        name = f"coded-{part}"
        np.testing.assert_array_equal(found[name][0], wanted[name][0])
        assert not np.array_equal(found[name][0], plan.patterns[name][0])


def test_a_plan_that_looks_at_no_dark_photo_has_no_leaks() -> None:
    nothing: Any = SimpleNamespace(look=None)
    with pytest.raises(PdcdError, match="looks at no dark photo"):
        leak_check.estimate_leaks(nothing, nothing, (), Watch())


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


def test_a_worker_without_a_job_says_what_is_missing(tmp_path: Path) -> None:
    nothing: Any = None
    worker, watch = Worker(RigFacts(Config(), nothing, (3, 4), None)), Watch()
    for call, words in (
        (lambda: worker.step(watch, "timing", UTC), "no calibration is under way"),
        (lambda: worker.answered(watch), "no calibration is under way"),
        (lambda: worker.photo(watch, nothing), "no calibration is under way"),
        (lambda: worker.measured(watch), "no calibration is under way"),
        (lambda: worker.begin(watch, tmp_path), "no plan to work on"),
        (lambda: worker.next_exposure(watch, None), "no plan to work on"),
        (lambda: worker.look(watch, "raw", ""), "no plan to work on"),
    ):
        with pytest.raises(PdcdError, match=words):
            call()
    assert worker.report(watch) is None


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
