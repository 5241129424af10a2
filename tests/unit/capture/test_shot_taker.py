"""The shots of a job one by one: metered, exposed, taken again, and what is kept of each."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.bench.devices import CameraSettings
from pdcd.capture import shots
from pdcd.capture.rig import Exposure
from pdcd.capture.shots import ShotTaker
from pdcd.errors import ConfigError, ExposureError, SyncError
from pdcd.planning.metering import MAX_TESTS
from pdcd.runs.record import MeterRecord

FOLDER = Path("/run")
SHA, SECOND = "a" * 64, "b" * 64


class Log:
    """What a display says of an exposure."""

    def __init__(self, *missed: int, verified: bool = True) -> None:
        self.missed, self.verified, self.source = np.array(missed), verified, "flips"
        self.end_ns = np.array([70, 80])

    def __len__(self) -> int:
        return len(self.missed)


def raw(name: str, *, two: bool = False) -> Any:
    second = SimpleNamespace(path=FOLDER / f"raw/{name}-b.dng", sha256=SECOND, size_bytes=4)
    return SimpleNamespace(
        path=FOLDER / f"raw/{name}.dng", sha256=SHA, size_bytes=3, second=second if two else None
    )


def shot(name: str, **said: Any) -> Any:
    told = {"kind": "coded", "beside": "", "primal_black": False, "dual_black": False}
    return SimpleNamespace(name=name, **{**told, **said})


class Plan:
    """Two shots, and their frames by name."""

    def __init__(self, *planned: Any, iso: int | None = None) -> None:
        self.recipe, self.iso = SimpleNamespace(shots=planned), iso
        self.row_hz = 60.0

    def frames(self, one: Any, *, pairs: int | None = None) -> str:
        return f"frames of {one.name}" + ("" if pairs is None else f" x {pairs}")

    def window_of(self, one: Any) -> str:
        return f"window of {one.name}"


class Bench:
    """Rig, hands, journal and sight in one; what happens is noted in order."""

    def __init__(self, *exposed: Any, two: bool = False) -> None:
        self.exposed, self.two = list(exposed), two
        self.steps: list[Any] = []
        self.warned: list[str] = []
        self.kept: list[Any] = []
        self.metering: list[tuple[float, float]] = []
        self.path = FOLDER
        self.folder = self.ledger = self
        self.job = SimpleNamespace(watch=lambda: "watch", emit=self.warned.append, cancelled="end")

    def expose(self, frames: str, settings: Any, folder: Path, name: str, **more: Any) -> Exposure:
        assert folder == FOLDER / "raw" and more["notify"] == self.notify
        assert more["cancelled"] == "end"
        self.steps.append(("expose", frames, settings, name))
        found = self.exposed.pop(0) if self.exposed else Log(0)
        if isinstance(found, Exception):
            raise found
        log: Any = found
        return Exposure(10, 2_000_000_010, log, raw(name, two=self.two), settings)

    def do(self, watch: str, task: Any, *args: Any) -> Any:
        assert watch == "watch"
        self.steps.append((task.__name__, *args))
        if task.__name__ == "metered":
            peak, expected = self.metering.pop(0)
            return SimpleNamespace(peak=peak, expected=expected)
        return 3 if task.__name__ == "meter_pairs" else "head"

    def saw(self, file: str, head: str) -> None:
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

    def meter(self, record: Any) -> None:
        self.kept.append(record)

    def heard(self, *kinds: str) -> list[Any]:
        return [step for step in self.steps if step[0] in kinds]


def taker(bench: Bench, *, f_number: Any = 5.6, f_numbers: Any = (4.0, 8.0), **rig: Any) -> Any:
    config: Any = SimpleNamespace(
        rig=SimpleNamespace(**{"retries": 2, "on_miss": "retry", **rig}),
        camera=SimpleNamespace(f_number=f_number), row_hz=60.0,
    )  # fmt: skip
    camera: Any = SimpleNamespace(isos=(200, 100, 400), f_numbers=f_numbers)
    profile: Any = SimpleNamespace(saturation_dn=lambda iso: 10.0 * iso)
    known: Any = bench
    return ShotTaker(config, known, camera, profile, known, known, known)


@pytest.fixture(autouse=True)
def weights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Codes were lit evenly unless a refresh was missed: one by half, two beyond measure."""

    def lit(frames: str, log: Log, row_hz: float) -> Any:
        assert row_hz == 60.0
        lost = int(log.missed.sum())
        if lost > 1:
            raise SyncError("no code was lit")
        level = (1.0, 0.0)[lost] if lost < 2 else 0.0
        realised = np.array([2.0, 2.0 - lost])
        return SimpleNamespace(realised=realised, planned=np.full(2, 2.0), level=level)

    monkeypatch.setattr(shots, "lit_weights", lit)


def test_what_is_kept_of_a_shot() -> None:
    bench = Bench(Log(0, 0, 0))
    (record,) = taker(bench).take(Plan(shot("coded")), shot("coded"))
    assert bench.kept == [record] and bench.warned == []
    told = {name: getattr(record, name) for name in record.__struct_fields__}
    assert told == {
        "name": "coded", "window": "window of coded", "raw": "raw/coded.dng", "sha256": SHA,
        "size_bytes": 3, "iso": 100, "f_number": 5.6, "open_ns": 10, "close_ns": 2_000_000_010,
        "end_ns": (70, 80), "refreshes": 3, "missed": 0, "source": "flips", "verified": True,
        "level": 1.0,
    }  # fmt: skip
    assert bench.steps == [
        ("expose", "frames of coded", CameraSettings(100, 5.6), "coded"),
        ("look", "raw/coded.dng", SHA),
        ("saw", "raw/coded.dng", "head"),
        ("frames", "coded", "frames of coded", 3),
    ]


def test_a_lens_that_cannot_be_set_is_not_set() -> None:
    bench = Bench()
    (record,) = taker(bench, f_numbers=()).take(Plan(shot("a"), iso=400), shot("a"))
    assert bench.steps[0][2] == CameraSettings(400, None) and record.f_number == 5.6
    with pytest.raises(ConfigError, match="cannot be set"):
        taker(bench, f_numbers=(), f_number="auto").take(Plan(shot("a")), shot("a"))
    with pytest.raises(ConfigError, match="ISO 50 is not offered") as told:
        taker(bench).take(Plan(shot("a"), iso=50), shot("a"))
    assert told.value.hint == "take one of 200, 100, 400"


def test_the_second_bucket_comes_with_the_first() -> None:
    one, two = shot("a"), shot("b", beside="a")
    bench = Bench(Log(0), two=True)
    first, second = taker(bench).take(Plan(one, two), one)
    assert (second.name, second.raw, second.sha256, second.size_bytes) == (
        "b", "raw/a-b.dng", SECOND, 4,
    )  # fmt: skip
    assert (second.open_ns, second.level) == (first.open_ns, first.level)
    assert bench.kept == [first, second]
    assert [step[1:3] for step in bench.heard("frames")] == [
        ("a", "frames of a"), ("b", "frames of b"),
    ]  # fmt: skip
    with pytest.raises(ExposureError, match="one plane"):
        taker(Bench(Log(0))).take(Plan(one, two), one)


UNEVEN = "1 refreshes were missed; codes were lit 0.5 to 1 times as long as planned"


def test_a_shot_that_was_spoilt_is_set_aside_and_taken_again() -> None:
    bench = Bench(SyncError("the display gave up"), Log(1, 0), Log(0))
    (record,) = taker(bench).take(Plan(shot("a")), shot("a"))
    assert record.refreshes == 1
    assert bench.heard("aside", "frames", "discarded") == [
        ("aside", "a", 1),
        ("discarded", "a-discarded-1", "the display gave up"),
        ("aside", "a", 2),
        ("frames", "a-discarded-2", "frames of a", 2),
        ("discarded", "a-discarded-2", UNEVEN),
        ("frames", "a", "frames of a", 1),
    ]
    assert bench.warned == [
        "shot a: exposure 1 was discarded: the display gave up",
        f"shot a: exposure 2 was discarded: {UNEVEN}",
    ]


@pytest.mark.parametrize("retries", [0, 2])
def test_a_shot_that_is_spoilt_too_often_ends_the_run(retries: int) -> None:
    bench = Bench(*(Log(1) for _ in range(9)))
    with pytest.raises(SyncError) as told:
        taker(bench, retries=retries).take(Plan(shot("a")), shot("a"))
    assert len(bench.heard("expose")) == len(bench.heard("aside")) == retries + 1
    assert told.value.message == f"shot a was spoilt {retries + 1} times: {UNEVEN}"
    assert told.value.device == "display" and bench.kept == []


def test_where_misses_are_only_flagged_the_first_exposure_is_kept() -> None:
    bench = Bench(Log(1, 0))
    (record,) = taker(bench, on_miss="flag").take(Plan(shot("a")), shot("a"))
    assert (record.missed, record.level) == (1, None) and bench.heard("aside") == []
    assert bench.warned == [f"shot a: {UNEVEN}"]
    bench = Bench(Log(1, 1))
    taker(bench, on_miss="flag").take(Plan(shot("a")), shot("a"))
    assert bench.warned == ["shot a: 2 refreshes were missed; no code was lit"]
    bench = Bench(SyncError("gave up"))
    with pytest.raises(SyncError, match="gave up"):
        taker(bench, on_miss="flag").take(Plan(shot("a")), shot("a"))
    assert bench.heard("aside") == []


@pytest.mark.parametrize("black", ["primal_black", "dual_black"])
def test_shots_that_are_subtracted_from_each_other_were_shown_equally_often(
    black: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    levels = [0.5, 1.0]
    monkeypatch.setattr(
        shots, "lit_weights",
        lambda *_: SimpleNamespace(realised=np.ones(0), planned=np.ones(0), level=levels.pop(0)),
    )  # fmt: skip
    other = shot("b", **{black: True})
    (record,) = taker(Bench()).take(Plan(shot("a"), other), shot("a"))
    assert record.level == 1.0 and levels == []
    levels[:] = [0.5, 1.0]
    (record,) = taker(Bench()).take(Plan(shot("a"), shot("b")), shot("a"))
    assert record.level == 0.5 and levels == [1.0]


def test_what_a_kept_shot_has_suffered_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    even = SimpleNamespace(realised=np.ones(1), planned=np.ones(1), level=1.0)
    monkeypatch.setattr(shots, "lit_weights", lambda *_: even)
    bench = Bench(Log(2, 1, verified=False))
    taker(bench).take(Plan(shot("a")), shot("a"))
    assert bench.warned == [
        "shot a: 3 refreshes were missed, without harm to the codes",
        "shot a: presentation times are not verified",
    ]


def test_an_aperture_is_metered_once_for_each_program(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def stepped(apertures: Any, f_number: float, peak: float, expected: float) -> Any:
        asked.append((apertures, f_number, peak, expected))
        return 4.0, len(asked) > 1

    monkeypatch.setattr(shots, "next_aperture", stepped)
    bench = Bench(two=True)
    bench.metering = [(0.1, 0.4), (0.2, 0.3), (0.5, 0.5), (0.5, 0.6)]
    made = taker(bench, f_number="auto", f_numbers=(4.0, 7.5, 16.0))
    plan = Plan(shot("a"), iso=200)
    (record,) = made.take(plan, shot("a"))
    assert asked == [((4.0, 7.5, 16.0), 7.5, 0.2, 0.4), ((4.0, 7.5, 16.0), 4.0, 0.5, 0.6)]
    assert record.f_number == 4.0 and made.apertures == {"coded": 4.0}
    tests = [MeterRecord(raw=f"raw/meter-a-{n}.dng", f_number=f, peak=peak)
             for n, f, peak in ((1, 7.5, 0.2), (2, 4.0, 0.5))]  # fmt: skip
    assert made.meter == tests and bench.kept == [*tests, record]
    assert [step[1:] for step in bench.heard("expose")] == [
        ("frames of a x 3", CameraSettings(200, 7.5), "meter-a-1"),
        ("frames of a x 3", CameraSettings(200, 4.0), "meter-a-2"),
        ("frames of a", CameraSettings(200, 4.0), "a"),
    ]
    assert bench.heard("meter_pairs", "metered")[:3] == [
        ("meter_pairs", "a"),
        ("metered", "raw/meter-a-1.dng", SHA, 2000.0),
        ("metered", "raw/meter-a-1-b.dng", SECOND, 2000.0),
    ]
    made.take(plan, shot("b"))  # of the same program
    assert len(asked) == 2


@pytest.mark.parametrize(("spoilt", "taken"), [(2, True), (3, False)])
def test_a_test_exposure_that_is_given_up_is_taken_again(
    spoilt: int, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shots, "next_aperture", lambda *_: (4.0, True))
    bench = Bench(*(SyncError("gave up") for _ in range(spoilt)))
    bench.metering = [(0.1, 0.1)]
    made = taker(bench, f_number="auto", retries=2)
    if not taken:
        with pytest.raises(SyncError, match="gave up"):
            made.take(Plan(shot("a")), shot("a"))
        return
    (record,) = made.take(Plan(shot("a")), shot("a"))
    assert [step[3] for step in bench.heard("expose")] == [*["meter-a-1"] * 3, "a"]
    assert bench.heard("aside", "discarded") == [
        ("aside", "meter-a-1", 1), ("discarded", "meter-a-1-discarded-1", "gave up"),
        ("aside", "meter-a-1", 2), ("discarded", "meter-a-1-discarded-2", "gave up"),
    ]  # fmt: skip
    assert made.meter[0].raw == "raw/meter-a-1.dng" and record.f_number == 4.0


def test_metering_that_does_not_settle_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shots, "next_aperture", lambda *_: (4.0, False))
    bench = Bench()
    bench.metering = [(0.1, 0.1)] * MAX_TESTS
    taker(bench, f_number="auto").take(Plan(shot("a")), shot("a"))
    assert bench.warned == ["metering of a did not settle; took f/4"] and bench.metering == []


@pytest.mark.parametrize("settable", [True, False])
@pytest.mark.parametrize("lit", [True, False])
def test_a_dark_photo_is_taken_as_the_answer_is(
    lit: bool, settable: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shots, "last_exposed", lambda _: shot("coded"))
    monkeypatch.setattr(shots, "dark_frames", lambda _, *, lit: f"dark {lit}")
    monkeypatch.setattr(shots, "phase_rows", lambda _: 90)
    bench = Bench()
    made = taker(bench, f_numbers=(4.0,) if settable else ())
    found = made.dark(Plan(shot("coded")), "look-dark", lit=lit)
    assert (found.raw, found.sha256, found.iso, found.f_number) == (
        "raw/look-dark.dng", SHA, 100, 5.6,
    )  # fmt: skip
    assert (found.exposure_s, found.phase_s) == (pytest.approx(2.0), 1.5)
    settings = CameraSettings(100, 5.6 if settable else None)
    assert bench.heard("expose") == [("expose", f"dark {lit}", settings, "look-dark")]
    wanted = MeterRecord(raw="raw/look-dark.dng", f_number=5.6, peak=None)
    assert made.meter == bench.kept == [wanted]
