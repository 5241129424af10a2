"""How the photos of a job are exposed: ISO, and apertures by test exposures."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.bench.devices import CameraSettings
from pdcd.bench.stops import Stop
from pdcd.capture.worker import exposing
from pdcd.capture.worker.answers import AuxiliaryPhoto, Order, PhotoOrder, RigFacts
from pdcd.capture.worker.exposing import Exposer, Orders
from pdcd.errors import ConfigError
from pdcd.planning.metering import MAX_TESTS
from pdcd.recipes.recipe import Shot
from pdcd.runs.record import MeterRecord
from pdcd.sensor.shelf import PhotoShelf

SHA, SECOND = "a" * 64, "b" * 64
SEQUENCE: Any = SimpleNamespace(
    frames=lambda pairs, times=1: f"frames of {pairs} pairs" + f" {times} times" * (times > 1),
    passes=4,
)
CODED, WHITE, PILOT = (
    Shot("coded", "coded"), Shot("white", "", white=True), Shot("pilot", "pilot", only=1)
)  # fmt: skip
PLAN: Any = SimpleNamespace(
    sequence=lambda shot: SEQUENCE, recipe=SimpleNamespace(shots=(WHITE, PILOT, CODED))
)
PROFILE: Any = SimpleNamespace(saturation_dn=lambda iso: 10.0 * iso)


def exposer(f_number: Any = "auto", f_numbers: Any = (4.0, 8.0), iso: int | None = None) -> Exposer:
    config: Any = SimpleNamespace(camera=SimpleNamespace(f_number=f_number, stops=()))
    camera: Any = SimpleNamespace(isos=(200, 100, 400), f_numbers=f_numbers)
    return Exposer(
        RigFacts(config, PROFILE, (3, 4), None), camera, iso, PhotoShelf(Path("/run")), Orders()
    )


def metered(
    made: Exposer, shot: Shot = CODED, *, planes: int = 1, planned: Any = PLAN.recipe.shots
) -> tuple[float, list[Order]]:
    """The aperture, and what was ordered for it; photos come as they are wanted."""
    orders: list[Order] = []
    asking = made.aperture(shot, planned, PLAN.sequence)
    taken = None
    while True:
        try:
            order = asking.send(taken)
        except StopIteration as end:
            return end.value, orders
        orders.append(order)
        assert order.photo is not None
        name = order.photo.name
        raws = ((f"raw/{name}.dng", SHA), (f"raw/{name}-b.dng", SECOND))
        taken = AuxiliaryPhoto(raws[:planes], 1.0)


@pytest.fixture
def shares(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What planes show, by path, and what is made of it."""
    told: dict[str, Any] = {"asked": [], "seen": {}, "steps": []}

    def seen(
        self: Exposer, raw: str, sha256: str, f_number: float, ratio: Any, saturation_dn: float
    ) -> Any:
        told["asked"].append((raw, sha256, ratio, saturation_dn))
        return told["seen"].get(raw, (0.1, 0.1))

    def step(apertures: Any, f_number: float, peak: float, expected: float) -> Any:
        told["steps"].append((apertures, f_number, peak, expected))
        stop = told.get("stop", 4.0) if len(told["steps"]) > 2 else 4.0
        return stop, told.get("settles", True) and len(told["steps"]) > 1

    monkeypatch.setattr(Exposer, "_shares", seen)
    monkeypatch.setattr(exposing, "choose_test_pairs", lambda sequence: (3, "ratio"))
    monkeypatch.setattr(exposing, "choose_next_aperture", step)
    return told


def test_an_aperture_is_metered_once(shares: dict[str, Any]) -> None:
    shares["seen"] = {
        "raw/meter-coded-1.dng": (0.1, 0.4), "raw/meter-coded-1-b.dng": (0.2, 0.3),
        "raw/meter-coded-2.dng": (0.5, 0.5), "raw/meter-coded-2-b.dng": (0.5, 0.6),
    }  # fmt: skip
    made = exposer(f_numbers=(4.0, 7.5, 16.0), iso=200)
    f_number, orders = metered(made, planes=2)
    assert f_number == 4.0 and made.apertures == {"coded": 4.0}
    assert shares["steps"] == [
        ((4.0, 7.5, 16.0), 7.5, 0.2, 0.4), ((4.0, 7.5, 16.0), 4.0, 0.5, 0.6)
    ]  # fmt: skip
    frames: Any = "frames of 3 pairs"
    settings = [CameraSettings(200, f) for f in (7.5, 4.0)]
    assert [vars(order.photo) for order in orders] == [
        vars(PhotoOrder("test", "meter-coded-1", frames, settings[0], 7.5)),
        vars(PhotoOrder("test", "meter-coded-2", frames, settings[1], 4.0)),
    ]
    first = MeterRecord(raw="raw/meter-coded-1.dng", f_number=7.5, peak=0.2)
    second = MeterRecord(raw="raw/meter-coded-2.dng", f_number=4.0, peak=0.5)
    # A photo is told of before anything else is done with the devices.
    assert [order.notes for order in orders] == [(), (first,)]
    assert made.orders.end() == Order((second,), done=True)
    assert shares["asked"][:2] == [
        ("raw/meter-coded-1.dng", SHA, "ratio", 2000.0),
        ("raw/meter-coded-1-b.dng", SECOND, "ratio", 2000.0),
    ]
    assert metered(made) == (4.0, [])
    assert made.stops == (Stop(4.0, 4.0, 0.0),)


def test_metering_that_does_not_settle_is_told_of(shares: dict[str, Any]) -> None:
    shares["settles"] = False
    made = exposer()
    f_number, orders = metered(made)
    assert f_number == 4.0 and len(orders) == MAX_TESTS
    assert made.orders.end().notes[-1] == "metering of coded did not settle; took f/4"


def test_a_shot_of_leaks_takes_the_stop_of_the_light_that_it_is_taken_off(
    shares: dict[str, Any],
) -> None:
    """It comes first, and is so dark that its own stop would saturate the other."""
    far, leaks = Shot("far", "far"), Shot("far-black-dual", "far", dual_black=True)
    made = exposer()
    orders = metered(made, leaks, planned=(WHITE, CODED, leaks, far))[1]
    names = [order.photo.name for order in orders if order.photo is not None]
    assert names[:3] == ["meter-coded-1", "meter-coded-2", "meter-far-1"]


@pytest.mark.parametrize(
    ("shot", "peak", "expected", "slots"),
    [
        (WHITE, 0.2, 0.8, 3),  # of four slots as many as stay at 60 %
        (WHITE, 0.05, 0.2, 4),
        (WHITE, 0.8, 3.2, 1),
        (PILOT, 0.06, 0.06, None),
        (PILOT, 0.8, 0.8, None),
    ],
)
def test_others_take_the_stop_of_the_codes(
    shares: dict[str, Any], shot: Shot, peak: float, expected: float, slots: int | None
) -> None:
    shares["seen"] = {f"raw/meter-{shot.name}-1.dng": (peak, expected)}
    made = exposer()
    f_number, orders = metered(made, shot)
    names = [order.photo.name for order in orders if order.photo is not None]
    assert names == ["meter-coded-1", "meter-coded-2", f"meter-{shot.name}-1"]
    assert f_number == 4.0 and made.stops == (Stop(4.0, 4.0, 0.0),)
    assert slots is None or made.white_slots(4) == slots


@pytest.mark.parametrize(
    ("shot", "seen", "dim"), [(WHITE, (0.9, 3.6), CODED), (PILOT, (0.01, 0.01), PILOT)]
)
def test_a_second_stop_is_compared_with_the_first(
    shares: dict[str, Any], monkeypatch: pytest.MonkeyPatch, shot: Shot, seen: Any, dim: Shot
) -> None:
    """By what is not too bright for the wider one of both."""
    shares["seen"] = {f"raw/meter-{shot.name}-1.dng": seen}
    stop = shares["stop"] = 8.0 if shot is WHITE else 2.0
    asked: list[Shot] = []

    def sequence(one: Shot) -> Any:
        asked.append(one)
        return SEQUENCE

    monkeypatch.setattr(PLAN, "sequence", sequence)
    monkeypatch.setattr(PhotoShelf, "read", lambda _, raw, **said: raw)
    monkeypatch.setattr(exposing, "compare_stops", lambda *raws: (3.9, 0.002))
    made = exposer()
    f_number, orders = metered(made, shot)
    compared = [order.photo for order in orders if order.photo and "stop-" in order.photo.name]
    assert [photo.f_number for photo in compared] == [4.0, stop] and asked[-1] is dim
    assert {str(photo.frames) for photo in compared if photo.f_number == max(4.0, stop)} == {
        "frames of 3 pairs 4 times"
    }
    assert f_number == stop
    true = 4.0 * (3.9 * (4.0 if stop > 4.0 else 0.25)) ** 0.5
    assert made.stops[0] == Stop(4.0, 4.0, 0.0)
    assert (made.stops[1].f_number, made.stops[1].sigma) == (stop, 0.002)
    assert made.stops[1].true == pytest.approx(true)


def test_a_second_stop_that_has_no_light_is_what_is_engraved(
    shares: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A capture does not end for it: f/2.8 stands for 2^(3/2), f/4 for 4, each sure to 4 %."""
    shares["seen"], shares["stop"] = {"raw/meter-pilot-1.dng": (0.0, 0.0)}, 2.8
    monkeypatch.setattr(PhotoShelf, "read", lambda _, raw, **said: raw)
    monkeypatch.setattr(exposing, "compare_stops", lambda *raws: None)
    made = exposer()
    f_number, _ = metered(made, PILOT)
    assert f_number == 2.8
    assert made.stops[1].true == pytest.approx(2.0**1.5)
    assert made.stops[1].sigma == pytest.approx(0.04 * 2.0**0.5)
    assert "too little light to compare" in str(made.orders.end().notes[-1])


def test_a_lens_that_cannot_be_set_is_not_set() -> None:
    fixed = exposer(5.6, (), 400)
    assert metered(fixed) == (5.6, [])
    (stop,) = fixed.stops  # engraved for 2^(5/2)
    assert stop.true == pytest.approx(2.0**2.5) and stop.sigma == 0.0
    assert fixed.settings(5.6) == CameraSettings(400, None)
    assert exposer(5.6).settings(5.6) == CameraSettings(100, 5.6)
    with pytest.raises(ConfigError, match="cannot be set"):
        metered(exposer("auto", ()))
    for call in (lambda one: one.settings(8.0), metered):
        with pytest.raises(ConfigError, match="ISO 50 is not offered") as told:
            call(exposer(iso=50))
        assert told.value.hint == "take one of 200, 100, 400"
