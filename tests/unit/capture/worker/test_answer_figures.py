"""What a worker tells of a run: figures of an answer, leaks, guards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
import scipy.sparse
from numpy.typing import NDArray

from pdcd.bench.tables import Config, LimitsConfig
from pdcd.capture.worker import leak_check
from pdcd.capture.worker.answers import RigFacts, compute_rms_sigma, compute_transport_figures
from pdcd.capture.worker.leak_check import AmbientResponse
from pdcd.capture.worker.worker import Worker
from pdcd.errors import PdcdError
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


def test_a_worker_without_a_job_or_a_folder_says_what_is_missing(tmp_path: Path) -> None:
    nothing: Any = None
    worker, watch = Worker(RigFacts(Config(), nothing, (3, 4), None)), Watch()
    calls: dict[str, tuple[Callable[[], object], ...]] = {
        "no calibration is under way": (
            lambda: worker.step(watch, "timing", UTC), lambda: worker.answered(watch),
            lambda: worker.photo(watch, nothing), lambda: worker.measured(watch),
        ),
        "no stream is under way": (lambda: worker.keep(watch, tmp_path),),
        "no plan to work on": (
            lambda: worker.begin(watch, tmp_path), lambda: worker.next_exposure(watch, None),
            lambda: worker.look(watch, "raw", ""),
        ),
        "no run folder yet": (
            lambda: worker.next_exposure(watch, None), lambda: worker.look(watch, "raw/a.dng", "0"),
            lambda: worker.develop(watch),
        ),
        "need to know the camera": (lambda: worker.begin(watch, tmp_path),),
    }  # fmt: skip
    for words, asked in calls.items():
        if words == "no run folder yet":
            worker.plan(watch, CaptureRequest(goal="white", codes=4), {}, None, None)
        for call in asked:
            with pytest.raises(PdcdError, match=words):
                call()
    assert worker.report(watch) is None
    worker.forget(watch)
    with pytest.raises(PdcdError, match="no plan to work on"):
        worker.begin(watch, tmp_path)
