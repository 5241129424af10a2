"""The photos of a job one by one: exposed, taken again, and what is kept of each."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.bench.devices import CameraSettings
from pdcd.capture import shots
from pdcd.capture.exposure import RigExposure
from pdcd.capture.shots import ShotTaker
from pdcd.capture.worker.answers import PhotoOrder, SpoiltPhoto
from pdcd.errors import ExposureError, PhotoError, SyncError

FOLDER = Path("/run")
SHA, SECOND = "a" * 64, "b" * 64
SETTINGS = CameraSettings(100, 5.6, exposure_s=2.0)
HEAD = SimpleNamespace(exposure_s=2.0, iso=100, f_number=5.6)


class Log:
    """What a display says of an exposure."""

    def __init__(self, *missed: int, verified: bool = True) -> None:
        self.missed, self.verified, self.source = np.array(missed), verified, "flips"
        self.end_ns = np.array([70, 80])

    mask_delay = 0

    def __len__(self) -> int:
        return len(self.missed)


def raw(name: str, *, two: bool = False) -> Any:
    second = SimpleNamespace(path=FOLDER / f"raw/{name}-b.dng", sha256=SECOND, size_bytes=4)
    return SimpleNamespace(
        path=FOLDER / f"raw/{name}.dng", sha256=SHA, size_bytes=3, second=second if two else None
    )


def shot(name: str, kind: Any = "shot", **said: Any) -> PhotoOrder:
    frames: Any = f"frames of {name}"
    return PhotoOrder(kind, name, frames, SETTINGS, 5.6, f"window of {name}", **said)


class Bench:
    """Rig, worker, journal and frame check in one; what happens is noted in order."""

    def __init__(self, *exposed: Any, two: bool = False) -> None:
        self.exposed, self.two = list(exposed), two
        self.steps: list[Any] = []
        self.heads: list[Any] = []
        self.open_s: list[float] = []
        self.warned: list[str] = []
        self.kept: list[Any] = []
        self.path = FOLDER
        self.folder = self.ledger = self
        self.job = SimpleNamespace(watch=lambda: "watch", emit=self.warned.append, cancelled="end")

    def expose(
        self, frames: str, settings: Any, folder: Path, name: str, **more: Any
    ) -> RigExposure:
        assert folder == FOLDER / "raw" and more["notify"] == self.notify
        assert more["cancelled"] == "end"
        self.steps.append(("expose", frames, settings, name))
        found = self.exposed.pop(0) if self.exposed else Log(0)
        if isinstance(found, Exception):
            raise found
        log: Any = found
        open_s = self.open_s.pop(0) if self.open_s else 2.0
        return RigExposure(10, 10 + round(open_s * 1e9), log, raw(name, two=self.two), settings)

    def do(self, watch: str, task: Any, *args: Any) -> Any:
        assert watch == "watch"
        self.steps.append((task.__name__, *args))
        return self.heads.pop(0) if self.heads else HEAD

    def saw(self, file: str, head: Any) -> None:
        self.steps.append(("saw", file, head))

    def write_frames(self, name: str, frames: str, log: Log) -> None:
        self.steps.append(("frames", name, frames, len(log)))

    def set_aside(self, name: str, number: int) -> str:
        self.steps.append(("aside", name, number))
        return f"{name}-discarded-{number}"

    def notify(self, event: Any) -> None:
        self.steps.append((event.type, event.name, event.cause))

    def warn(self, text: str) -> None:
        self.warned.append(text)

    def take(self, record: Any) -> None:
        self.kept.append(record)

    def heard(self, *kinds: str) -> list[Any]:
        return [step for step in self.steps if step[0] in kinds]


def taker(bench: Bench, **rig: Any) -> Any:
    config: Any = SimpleNamespace(
        rig=SimpleNamespace(**{"retries": 2, "on_miss": "retry", **rig}), row_hz=60.0
    )
    known: Any = bench
    return ShotTaker(config, known, known, known, known)


@pytest.fixture(autouse=True)
def weights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Codes were lit evenly."""
    even = SimpleNamespace(realised=np.ones(1), planned=np.ones(1), level=1.0)
    monkeypatch.setattr(shots, "count_lit_weights", lambda *_: even)


def test_the_second_bucket_comes_with_the_first() -> None:
    frames: Any = "frames of b"
    one = shot("a", beside=(("b", frames),))
    bench = Bench(Log(0), two=True)
    first, second = taker(bench).take(one)
    assert (second.name, second.raw, second.sha256, second.size_bytes) == (
        "b", "raw/a-b.dng", SECOND, 4,
    )  # fmt: skip
    assert (second.open_ns, second.level) == (first.open_ns, first.level)
    assert bench.kept == [first, second]
    assert [step[1:3] for step in bench.heard("frames")] == [
        ("a", "frames of a"), ("b", "frames of b"),
    ]  # fmt: skip
    with pytest.raises(ExposureError, match="one plane"):
        taker(Bench(Log(0))).take(one)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"iso": 400}, "raw/a.dng was taken at ISO 400, not at ISO 100"),
        ({"f_number": 8.0}, "raw/a.dng was taken at f/8, not at f/5.6"),
        ({"iso": 0, "f_number": None}, ""),
        ({"f_number": 5.7}, ""),
    ],
)
@pytest.mark.parametrize("kind", ["shot", "test", "look"])
def test_a_photo_of_other_settings_than_its_order_ends_the_run(
    kind: str, said: dict[str, Any], words: str
) -> None:
    bench = Bench()
    bench.refusal = lambda frames: None  # type: ignore[attr-defined]
    bench.heads = [SimpleNamespace(**{**vars(HEAD), **said})]
    if not words:
        assert taker(bench).take(shot("a", kind))
        return
    with pytest.raises(ExposureError) as told:
        taker(bench).take(shot("a", kind))
    assert (told.value.message, told.value.device) == (words, "camera")


def test_what_a_kept_shot_has_suffered_is_told() -> None:
    bench = Bench(Log(2, 1, verified=False))
    taker(bench).take(shot("a"))
    assert bench.warned == [
        "shot a: 3 refreshes were missed, without harm to the codes",
        "shot a: presentation times are not verified",
    ]


@pytest.mark.parametrize("kind", ["test", "dark"])
@pytest.mark.parametrize("spoilt", [0, 2, 3])
def test_a_test_exposure_that_is_given_up_is_taken_again(kind: str, spoilt: int) -> None:
    bench = Bench(*(SyncError("gave up") for _ in range(spoilt)), two=kind == "test")
    made = taker(bench, retries=2)
    if spoilt == 3:  # a run goes on without a dark photo
        if kind == "dark":
            assert made.take(shot("a", kind)) == SpoiltPhoto("gave up")
            return
        with pytest.raises(SyncError, match="gave up"):
            made.take(shot("a", kind))
        return
    found = made.take(shot("a", kind))
    planes = (("raw/a.dng", SHA), ("raw/a-b.dng", SECOND))
    assert found.planes == planes[: 1 + bench.two] and found.raw == "raw/a.dng"
    assert found.seconds == pytest.approx(2.0)
    assert [step[3] for step in bench.heard("expose")] == ["a"] * (spoilt + 1)
    assert bench.heard("aside", "discarded") == [
        ("aside", "a", 1), ("discarded", "a-discarded-1", "gave up"),
        ("aside", "a", 2), ("discarded", "a-discarded-2", "gave up"),
    ][: 2 * spoilt]  # fmt: skip
    assert bench.kept == [] and bench.heard("frames") == []


@pytest.mark.parametrize("kind", ["shot", "test"])
def test_where_misses_are_only_flagged_nothing_is_taken_again(kind: str) -> None:
    bench = Bench(SyncError("gave up"))
    with pytest.raises(SyncError, match="gave up"):
        taker(bench, on_miss="flag").take(shot("a", kind))
    assert bench.heard("aside") == []


LONG = "the shutter was open for 8.2 s instead of 2 s"
SHORT = "the camera reports 0.005 s for an exposure of 2 s"


@pytest.mark.parametrize("kind", ["shot", "test", "dark"])
@pytest.mark.parametrize(
    ("open_s", "told_s", "cause"), [([8.2, 2.0], [], LONG), ([], [0.005, 2.0], SHORT)]
)
def test_a_photo_whose_times_disagree_is_taken_once_more(
    kind: str, open_s: list[float], told_s: list[float], cause: str
) -> None:
    bench = Bench()
    bench.open_s = list(open_s)
    bench.heads = [SimpleNamespace(**{**vars(HEAD), "exposure_s": told}) for told in told_s]
    taker(bench, retries=0).take(shot("a", kind))
    assert bench.heard("discarded") == [("discarded", "a-discarded-1", cause)]
    assert len(bench.heard("expose")) == 2


@pytest.mark.parametrize("kind", ["shot", "test", "dark"])
def test_times_that_disagree_again_are_kept_and_told(kind: str) -> None:
    bench = Bench()
    bench.open_s = [8.2, 8.2]
    found = taker(bench).take(shot("a", kind))
    assert len(bench.heard("expose")) == 2 and LONG in bench.warned[-1]
    if kind == "shot":
        assert (found[0].planned_s, found[0].close_ns) == (2.0, 8_200_000_010)


@pytest.mark.parametrize("on_miss", ["retry", "flag", "balance"])
@pytest.mark.parametrize("kind", ["shot", "dark"])
def test_a_photo_that_was_lost_is_taken_again_and_its_last_loss_is_raised(
    on_miss: str, kind: str
) -> None:
    lost = PhotoError("frame 7 is not whole")
    bench = Bench(lost, lost, Log(0))
    taker(bench, on_miss=on_miss).take(shot("a", kind))
    assert bench.heard("aside") == [("aside", "a", 1), ("aside", "a", 2)]
    told = [step[2] for step in bench.heard("discarded")]
    assert told == [lost.message] * 2
    bench = Bench(lost, lost, lost, Log(0))
    with pytest.raises(PhotoError):
        taker(bench, on_miss=on_miss).take(shot("a", kind))
    assert len(bench.heard("expose")) == 3
    # Whatever else goes wrong with an exposure is nobody's to take again.
    bench = Bench(ExposureError("the shutter is open"), Log(0))
    with pytest.raises(ExposureError):
        taker(bench, on_miss=on_miss).take(shot("a", kind))
    assert len(bench.heard("expose")) == 1
