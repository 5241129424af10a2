"""A live view on the mock bench: its pictures, its end, and a camera that hangs."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.mock import MockBench
from pdcd.bench.devices import Preview
from pdcd.bench.registry import list_known_drivers
from pdcd.capture import live
from pdcd.capture.engine import Engine
from pdcd.errors import ExposureError
from pdcd.files.images import decode_jpeg
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.views import LiveFrame
from tests import bench_rig

REQUEST = CaptureRequest(goal="white", codes=4)


class Viewer:
    """Takes pictures until it has enough; `over` says how they end then."""

    def __init__(self, enough: int, over: str = "cancelled") -> None:
        self.enough, self.over = enough, over
        self.seen: list[LiveFrame] = []
        self.lit: list[bool] = []

    def look(self, engine: Engine, pattern: str = "white") -> CaptureResult:
        def has_enough(over: str) -> bool:
            return over == self.over and len(self.seen) >= self.enough

        def see(frame: LiveFrame) -> None:
            self.seen.append(frame)
            self.lit.append(not bench_rig.are_panels_black(bench_rig.bench_of(engine)))

        return engine.live(
            pattern,
            job="job",
            tell=see,
            cancelled=lambda: has_enough("cancelled"),
            ended=lambda: has_enough("done"),
        )


def is_safe(bench: MockBench) -> bool:
    return (
        bench_rig.are_panels_black(bench) and not bench.shutter_open and bench.shared.held is None
    )


@pytest.mark.parametrize("over", ["cancelled", "done"])
def test_pictures_come_until_the_end_and_the_rig_is_safe(engine: Engine, over: str) -> None:
    bench, viewer = bench_rig.bench_of(engine), Viewer(3, over)
    result = viewer.look(engine)
    assert (result.state, result.warnings) == (over, ())
    assert [frame.number for frame in viewer.seen][:3] == [1, 2, 3]
    assert all(viewer.lit) and is_safe(bench)
    first = viewer.seen[0]
    picture = decode_jpeg(first.jpeg)
    assert picture is not None and picture.shape == (3, 4, 3)
    assert first.mean > 0.1 and first.saturated == 0.0 and first.best >= first.focus > 0.0
    # What was shown leaves no trace in the photo that follows.
    assert bench_rig.capture(engine, REQUEST).state == "done"


def test_panels_show_what_was_asked_for(engine: Engine) -> None:
    means = {}
    for pattern in ("white", "black", "checker"):
        viewer = Viewer(1)
        viewer.look(engine, pattern)
        means[pattern] = viewer.seen[0].mean
    assert means["black"] < 0.01 < means["checker"]
    result = Viewer(1).look(engine, "nonsense")
    assert result.state == "failed" and (result.error or {})["kind"] == "request"
    assert is_safe(bench_rig.bench_of(engine))


class _Finder:
    """A finder that does what a test wants, in `grab`."""

    def __init__(self) -> None:
        self.hangs, self.let_go = threading.Event(), threading.Event()
        self.error: BaseException | None = None
        self.picture: NDArray[np.generic] = np.zeros((4, 6), np.uint8)

    def connect(self) -> dict[str, str]:
        return {}

    def grab(self, timeout_s: float) -> NDArray[np.uint8]:
        if self.error is not None:
            raise self.error
        self.hangs.set()
        assert self.let_go.wait(60.0)
        return self.picture  # type: ignore[return-value]

    def disconnect(self) -> None:
        pass


@pytest.fixture
def finder(monkeypatch: pytest.MonkeyPatch) -> _Finder:
    made = _Finder()

    def make(rig: object) -> tuple[Preview, float]:
        return made, 0.0

    monkeypatch.setattr(live, "_make_finder", make)
    monkeypatch.setattr(live, "_GRACE_S", 0.05)
    return made


@pytest.mark.parametrize("over", ["cancelled", "failed"])
def test_a_camera_that_hangs_is_left_behind(
    engine: Engine, finder: _Finder, over: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "_FIRST_S", 0.0)
    monkeypatch.setattr(live, "_OVER_S", 0.0 if over == "failed" else 0.2)
    cancelled = finder.hangs.is_set if over == "cancelled" else lambda: False
    result = engine.live("white", job="job", tell=print, cancelled=cancelled)
    assert result.state == over and is_safe(bench_rig.bench_of(engine))
    for again in (bench_rig.capture(engine, REQUEST), Viewer(1).look(engine)):
        assert again.state == "failed" and (again.error or {})["kind"] == "device_lost"
    engine.show("white", 0)  # the panels are no camera
    engine.show("black", 0)
    finder.let_go.set()
    (thread,) = (each for each in threading.enumerate() if each.name == "pdcd-finder")
    thread.join(60.0)
    assert bench_rig.capture(engine, REQUEST, job="job-2").state == "done"


def test_the_next_photo_waits_for_a_picture_that_is_not_done(
    engine: Engine, finder: _Finder
) -> None:
    """A view that ends before its first picture, which a camera may take its time for."""
    result = engine.live("white", job="job", tell=print, cancelled=finder.hangs.is_set)
    assert result.state == "cancelled"
    threading.Timer(0.5, finder.let_go.set).start()
    assert bench_rig.capture(engine, REQUEST).state == "done"


@pytest.mark.parametrize("picture", [np.zeros((4, 6), np.float64), np.zeros((0, 6), np.uint8)])
def test_what_is_no_picture_ends_it(
    engine: Engine, finder: _Finder, picture: NDArray[np.generic]
) -> None:
    finder.picture = picture
    finder.let_go.set()
    result = Viewer(1).look(engine)
    assert result.state == "failed" and "no picture" in str((result.error or {})["message"])


def test_an_error_of_the_finder_is_that_of_the_job(engine: Engine, finder: _Finder) -> None:
    finder.error = ExposureError("its mirror is stuck", device="camera", hint="tap it")
    result = Viewer(1).look(engine)
    assert result.error == {
        "kind": "exposure", "message": "its mirror is stuck", "device": "camera", "hint": "tap it",
    }  # fmt: skip
    assert is_safe(bench_rig.bench_of(engine))


def test_a_finder_that_would_end_the_program_ends_the_job(engine: Engine, finder: _Finder) -> None:
    finder.error = SystemExit(3)
    assert Viewer(1).look(engine).state == "failed" and is_safe(bench_rig.bench_of(engine))


def test_a_camera_without_a_finder_takes_photos(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = {key: at for key, at in list_known_drivers().items() if key != ("preview", "mock")}
    monkeypatch.setattr(live, "list_known_drivers", lambda: others)
    viewer, bench = Viewer(2), bench_rig.bench_of(engine)
    before = bench.exposures
    assert viewer.look(engine).state == "cancelled"
    assert bench.exposures - before >= 2 and is_safe(bench)
    # Exposed by itself: what is bright is seen, and not saturated.
    assert 0.1 < viewer.seen[-1].mean < 0.9
    assert bench_rig.capture(engine, REQUEST).state == "done"
