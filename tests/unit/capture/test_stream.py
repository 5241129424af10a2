"""A stream on the mock bench: its pictures are those of a capture, their errors what sigma says,
and it ends with the rig safe however it ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.mock import MockBench
from pdcd.api.run import Run, open_run
from pdcd.bench.tables import CameraConfig, LimitsConfig, SceneConfig, ServerConfig
from pdcd.bench.tables import Config as Bench
from pdcd.capture.engine import Engine
from pdcd.errors import DeviceLost, PhotoError, SyncError
from pdcd.files.images import decode_jpeg
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.protocol.stream import StreamedPicture, StreamRequest
from pdcd.runs.recording import RecordOrder, StreamListener
from pdcd.runs.verify import verify_run
from tests import bench_rig
from tests.stream_bench.recorded import decode_parts

GRID = (12, 16)


def config(folder: Path, profile: str = "modern", **camera: Any) -> Bench:
    """A bench of pixels whose cells have 3 x 3 quads."""
    return Bench(
        camera=CameraConfig(profile=profile, frame_quads=(48, 36), **camera),
        scene=SceneConfig(kind="open-book", grid=GRID),
        limits=LimitsConfig(min_free_bytes=0),
        server=ServerConfig(state_dir=str(folder / "state")),
    )


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Callable[[Bench], Engine]]:
    made: list[Engine] = []

    def start(bench: Bench) -> Engine:
        made.append(Engine.from_config(bench))
        made[-1].start()
        return made[-1]

    yield start
    for engine in made:
        engine.stop()


class Viewer:
    """Sees so many pictures and spoilt photos; then it has had enough. After `records` of them it
    wants a run, and keeps what was seen last of each part until then."""

    def __init__(self, enough: int, records: int = 0) -> None:
        self.enough, self._records = enough, records
        self.seen: list[StreamedPicture] = []
        self.recorded: CaptureResult | None = None
        self.newest: Mapping[int, StreamedPicture] = {}
        self.over = False

    def _record(self) -> RecordOrder | None:
        if not self._records or len(self.seen) < self._records:
            return None
        self._records = 0
        return RecordOrder(make_job_id(), None, self._done)

    def _done(self, result: CaptureResult) -> None:
        self.recorded = result
        self.newest = {seen.frame.part: seen for seen in self.seen if seen.arrays}

    def watch(self, engine: Engine, request: StreamRequest) -> CaptureResult:
        return engine.stream(
            request,
            job="job",
            listener=StreamListener(
                self.seen.append,
                lambda: self.over or len(self.seen) >= self.enough,
                lambda: True,
                self._record,
            ),
        )

    def run(self) -> Run:
        assert self.recorded is not None and self.recorded.folder is not None, self.recorded
        return open_run(Path(self.recorded.folder))


def is_safe(engine: Engine) -> bool:
    bench: MockBench = bench_rig.bench_of(engine)
    return bench_rig.are_panels_black(bench) and not bench.shutter_open


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.whole
@pytest.mark.parametrize(
    "profile, goal", [("mono", "indirect"), ("modern", "indirect"), ("mono", "direct")]
)
def test_each_picture_is_that_of_its_photo_alone_and_sigma_is_its_error(
    started: Callable[[Bench], Engine], tmp_path: Path, profile: str, goal: str
) -> None:
    engine, viewer = started(config(tmp_path, profile)), Viewer(12, records=9)
    request = StreamRequest(goal=goal, codes=16, window="whole", seed=3)  # type: ignore[arg-type]
    result = viewer.watch(engine, request)
    assert (result.state, result.warnings) == ("cancelled", ()) and is_safe(engine)
    numbers = [seen.number for seen in viewer.seen]
    assert numbers == list(range(1, len(numbers) + 1))
    assert [seen.frame.part for seen in viewer.seen[:8]] == [1, 2, 3, 4, 1, 2, 3, 4]
    # Of the codes nothing is known before four photos.
    kinds = [seen.frame.sigma_kind for seen in viewer.seen]
    assert kinds == ["sensor"] * 3 + ["measured"] * (len(kinds) - 3)
    # The run that was recorded is whole, and its photos are those of the last four pictures.
    run = viewer.run()
    assert verify_run(run.folder).whole and run.goal == goal
    assert run.summary["parts"] == 4 and run.summary["codes"] == 64
    truth = run.truth
    assert truth is not None and set(viewer.newest) == {1, 2, 3, 4}
    last = max(viewer.newest, key=lambda part: viewer.newest[part].number)
    for part, seen in viewer.newest.items():
        if goal == "direct" and part != last:  # its white photo was taken again since
            continue
        alone = decode_parts(run, {part}).answer
        np.testing.assert_allclose(seen.arrays["picture"], alone.image, rtol=0, atol=1e-9)
        error, sigma = seen.arrays["image"] - truth, seen.arrays["sigma"]
        known = np.isfinite(sigma) & np.isfinite(error)
        assert known.mean() > 0.9
        assert 0.7 < rms(sigma[known]) / rms(error[known]) < 1.5
    picture = decode_jpeg(viewer.seen[-1].frame.jpeg)
    assert picture is not None and picture.shape[:2] == (36, 48)
    # Nothing but runs is left on the disk.
    assert {path.name for path in (tmp_path / "state").iterdir()} <= {"captures", "calibrations"}


@pytest.mark.whole
def test_a_picture_over_a_whole_set_is_that_of_the_run(
    started: Callable[[Bench], Engine], tmp_path: Path
) -> None:
    engine, viewer = started(config(tmp_path, "mono")), Viewer(7, records=5)
    assert viewer.watch(engine, StreamRequest(goal="indirect", codes=16, over=4)).state
    assert [seen.frame.over for seen in viewer.seen[:5]] == [1, 2, 3, 4, 4]
    run, last = viewer.run(), max(viewer.newest.values(), key=lambda seen: seen.number)
    np.testing.assert_allclose(last.arrays["image"], run.image, rtol=0, atol=1e-9)
    np.testing.assert_allclose(last.arrays["sigma"], run.sigma, rtol=1e-9)
    again = run.decode(progress=False)
    np.testing.assert_allclose(again.image, run.image, rtol=0, atol=0)


class Flawed:
    """Takes the place of a method of a device: what call of it goes wrong, and how."""

    def __init__(self, real: Callable[..., Any], wrong: Callable[[int], BaseException | None]):
        self.real, self.wrong, self.calls = real, wrong, 0

    def __call__(self, *args: Any) -> Any:
        self.calls += 1
        error = self.wrong(self.calls)
        made = self.real(*args)
        if error is not None:
            raise error
        return made


REQUEST = StreamRequest(goal="indirect", codes=8, window="whole", black_level="none")


@pytest.fixture
def plain(started: Callable[[Bench], Engine], tmp_path: Path) -> Engine:
    """A bench of twelve cells, without noise."""
    return started(bench_rig.config(tmp_path))


def spoil(
    engine: Engine, device: str, method: str, after: int, errors: list[BaseException | None]
) -> Viewer:
    """Have calls of a device go wrong, `after` so many pictures were seen."""
    real = getattr(getattr(engine._rig, device), method)
    viewer = Viewer(after + len(errors) + 1)
    left = list(errors)

    def wrong(_: int) -> BaseException | None:
        return left.pop(0) if len(viewer.seen) >= after and left else None

    setattr(getattr(engine._rig, device), method, Flawed(real, wrong))
    return viewer


LOST = PhotoError("the photo was lost", device="camera")


@pytest.mark.parametrize("error", [LOST, SyncError("out of step", device="display")])
def test_a_spoilt_photo_is_told_of_and_has_no_picture(plain: Engine, error: Exception) -> None:
    viewer = spoil(plain, "readout", "fetch", 6, [error, None, error, error])
    result = viewer.watch(plain, REQUEST)
    assert result.state == "cancelled" and is_safe(plain), result
    bad = [seen for seen in viewer.seen if seen.frame.spoilt]
    assert len(bad) == 3 and all(not seen.arrays and not seen.frame.jpeg for seen in bad)
    assert {seen.frame.spoilt for seen in bad} == {str(error.args[0])}
    assert viewer.seen[-1].frame.lost == 3
    good = [seen.frame for seen in viewer.seen if seen.arrays]
    assert {frame.sigma_kind for frame in good[3:]} == {"measured"}


def test_three_spoilt_photos_in_a_row_end_it_and_say_why(plain: Engine) -> None:
    viewer = spoil(plain, "readout", "fetch", 3, [LOST] * 5)
    result = viewer.watch(plain, REQUEST)
    assert result.state == "failed" and result.error is not None and is_safe(plain)
    assert result.error["kind"] == "exposure"
    assert result.error["message"] == "3 photos in a row were spoilt: the photo was lost"
    assert [bool(seen.frame.spoilt) for seen in viewer.seen[-3:]] == [True] * 3
    # The rig is fit for what comes next.
    assert bench_rig.capture(plain, CaptureRequest(goal="white", codes=4)).state == "done"


def test_a_device_that_is_lost_ends_it_at_once(plain: Engine) -> None:
    viewer = spoil(plain, "display", "play", 3, [DeviceLost("it went", device="display")])
    result = viewer.watch(plain, REQUEST)
    assert result.state == "failed" and result.error is not None and is_safe(plain)
    assert result.error["kind"] == "device_lost" and not viewer.seen[-1].frame.spoilt


def test_a_camera_whose_iso_is_turned_meanwhile_ends_it(plain: Engine) -> None:
    viewer, readout = Viewer(100), plain._rig.readout
    real = readout.fetch

    def fetch(*args: Any) -> Any:
        if len(viewer.seen) >= 3:
            readout._settings = replace(readout._settings, iso=400)  # type: ignore[attr-defined]
        return real(*args)

    setattr(readout, "fetch", fetch)  # noqa: B010
    result = viewer.watch(plain, REQUEST)
    assert result.state == "failed" and result.error is not None and is_safe(plain)
    assert "was taken at ISO 400, not at ISO 100" in str(result.error["message"])


def test_a_camera_that_hangs_is_left_by_a_cancel(plain: Engine) -> None:
    viewer, patience = Viewer(100), plain._rig.context.patience
    real = plain._rig.readout.fetch

    def fetch(*args: Any) -> Any:
        if len(viewer.seen) >= 3:
            viewer.over = True
            while True:  # as drivers wait, which ask whether they may leave
                patience.look()
        return real(*args)

    setattr(plain._rig.readout, "fetch", fetch)  # noqa: B010
    result = viewer.watch(plain, REQUEST)
    assert result.state == "cancelled" and is_safe(plain) and len(viewer.seen) >= 3


def test_time_ends_it_as_done(
    plain: Engine,
) -> None:
    viewer = Viewer(10**6)
    result = viewer.watch(plain, msgspec.structs.replace(REQUEST, for_s=0.3, rate_hz=50.0))
    assert result.state == "done" and result.summary["pictures"] == len(viewer.seen) > 0


def test_what_is_no_stream_is_refused_before_the_rig_is_touched(plain: Engine) -> None:
    for wrong in ({"over": 5}, {"error": 0.1}, {"parts": 3}, {"repeat": 2}, {"method": "pairs"}):
        request = StreamRequest(**{"goal": "indirect", **wrong})  # type: ignore[arg-type]
        result = Viewer(1).watch(plain, request)
        assert result.state == "failed" and result.error is not None
        assert result.error["kind"] == "request" and result.error["hint"]
