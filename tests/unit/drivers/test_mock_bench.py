"""The mock bench's shutter and what it makes of an exposure: states, edges, and who may look."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.mock.bench import MockBench
from drivers.mock.shutter import Lag, MockShutter
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import (
    CameraConfig,
    Config,
    PanelConfig,
    RigConfig,
    SceneConfig,
    TriggerConfig,
)
from pdcd.errors import ExposureError
from pdcd.panels.frames import FrameLog, Frames

MS = 1_000_000

GRID = (3, 4)


def context_of(**tables: Any) -> DriverContext:
    given = {
        "projector": PanelConfig(size_px=(64, 48)),
        "mask": PanelConfig(size_px=(80, 60)),
        "camera": CameraConfig(noise="none"),
        "scene": SceneConfig(grid=GRID, ambient=1.0),
        "rig": RigConfig(settle_s=0.05),
        **tables,
    }
    return DriverContext(config=Config(**given), clock=VirtualClock())


@pytest.fixture
def bench() -> MockBench:
    return MockBench.of(context_of())


class Draws:
    """A source of chance that says what it is told to."""

    def __init__(self, *numbers: float) -> None:
        self.numbers = list(numbers)

    def standard_normal(self) -> float:
        return self.numbers.pop(0)


# The shutter's blades.


@pytest.mark.parametrize(
    ("lag_s", "jitter_s", "draw", "late_ns"),
    [
        (0.06, 0.01, 0.0, 60 * MS),
        (0.06, 0.01, 1.5, 75 * MS),
        (0.06, 0.01, -1.5, 45 * MS),
        (0.06, 0.01, 4.5, 100 * MS),  # at most four jitters
        (0.06, 0.01, -4.5, 20 * MS),
        (0.01, 0.01, -3.0, 0),  # and never before the order
        (0.0, 0.0, 1.0, 0),
    ],
)
def test_blades_are_late_by_the_lag_and_up_to_four_jitters(
    monkeypatch: pytest.MonkeyPatch, lag_s: float, jitter_s: float, draw: float, late_ns: int
) -> None:
    monkeypatch.setattr(np.random, "default_rng", lambda seed: Draws(draw))
    assert Lag(TriggerConfig(lag_s=lag_s, jitter_s=jitter_s), 0).draw_ns() == late_ns


@pytest.fixture
def still() -> tuple[MockShutter, MockBench, VirtualClock]:
    """A shutter without jitter, late by 60 ms, that is believed to be by 50 and four times 5 ms."""
    context = context_of(trigger=TriggerConfig(lag_s=0.05, jitter_s=0.005))
    shutter, bench = MockShutter.create(context), MockBench.of(context)
    shutter._lag = Lag(TriggerConfig(lag_s=0.06, jitter_s=0.0), 0)
    assert isinstance(context.clock, VirtualClock)
    return shutter, bench, context.clock


def test_times_are_those_by_which_it_is_believed_to_have_moved(
    still: tuple[MockShutter, MockBench, VirtualClock],
) -> None:
    shutter, bench, clock = still
    asked_ns = clock.now_ns()
    assert shutter.open() == asked_ns + 70 * MS == clock.now_ns()
    assert (bench.open_ns, bench.close_ns, bench.shutter_open) == (asked_ns + 60 * MS, None, True)
    asked_ns = clock.now_ns()
    assert shutter.close() == asked_ns + 70 * MS == clock.now_ns()
    assert (bench.close_ns, bench.shutter_open) == (asked_ns + 60 * MS, False)
    assert shutter.close() == clock.now_ns() == asked_ns + 70 * MS  # closed: nothing happens
    for end in (shutter.connect, shutter.disconnect):
        shutter.open()
        end()
        assert not bench.shutter_open


# Panels that have to settle.


@pytest.mark.parametrize(("after_ms", "settled"), [(49.999, False), (50, True)])
def test_a_shutter_opens_on_panels_that_have_settled(
    bench: MockBench, after_ms: float, settled: bool
) -> None:
    assert bench.black_since_ns is not None
    bench.lit()
    assert bench.black_since_ns is None
    for t_ns in (1000 * MS, 1040 * MS):  # black from when they were first told
        bench.black(t_ns)
    bench.open_shutter(1000 * MS + round(after_ms * MS))
    bench.close_shutter(5000 * MS)
    if settled:
        assert bench.photo().shape == (12, 3)
    else:
        for look in (bench.photo, bench.quads):
            with pytest.raises(ExposureError, match="opened on panels that had not") as caught:
                look()
            assert caught.value.device == "shutter"
        bench.open_shutter(2000 * MS)  # the next one is another
        assert bench.unsettled == ""


@pytest.mark.parametrize("whole", [True, False])
def test_an_exposure_that_was_given_up_may_close_at_any_time(bench: MockBench, whole: bool) -> None:
    bench.open_shutter(0)
    bench.lit()
    bench.whole = whole
    bench.close_shutter(10 * MS)
    assert ("the shutter closed on panels" in bench.unsettled) == whole
    assert not bench.shutter_open and bench.close_ns == 10 * MS


def frames_and_log() -> tuple[Frames, FrameLog]:
    patterns, one = np.zeros((1, 2), np.uint8), np.zeros(1, np.int32)
    none, guard = np.zeros(1, np.uint8), np.zeros(1, np.bool_)
    frames = Frames(patterns, patterns, one, one, none, one, guard, GRID, GRID, "whole")
    at = np.zeros(1, np.int64)
    return frames, FrameLog(one, one, at, at, np.array([1, 1]), one, "mock", True)


# What there is to read out.


def test_an_exposure_is_finished_once_it_is_closed_and_read_out_once(bench: MockBench) -> None:
    with pytest.raises(ExposureError, match=r"no finished exposure \(open and close"):
        bench.exposed_ns()
    bench.open_shutter(3)
    bench.shared.exposed_ns = (1, 2)  # another driver's shutter, before: this one counts
    with pytest.raises(ExposureError, match="no finished exposure"):
        bench.exposed_ns()
    bench.close_shutter(9)
    assert bench.exposed_ns() == (3, 9)
    bench.photo_taken()
    left: list[object] = [bench.open_ns, bench.close_ns, bench.shared.exposed_ns]
    assert left == [None] * 3
    with pytest.raises(ExposureError, match="no finished exposure"):
        bench.photo()


@pytest.mark.parametrize("by", ["frames", "played"])
def test_what_was_shown_before_the_shutter_opened_does_not_count(by: str) -> None:
    photos = []
    for lit in (True, False):
        bench = MockBench.of(context_of())
        if lit:
            frames, log = frames_and_log()
            both = np.array([-2], np.int32)
            white = replace(frames, primal_index=both, dual_index=both)
            log = replace(log, end_ns=np.array([500 * MS, 500 * MS]))
            if by == "frames":
                bench.frames, bench.log = white, log
            else:
                bench.shared.played = white, log
        bench.open_shutter(0)
        bench.close_shutter(500 * MS)
        photos.append(bench.photo())
    np.testing.assert_array_equal(photos[0], photos[1])


def test_ambient_light_comes_through_what_the_mask_leaks() -> None:
    """1 of ambient for 2 s through a black mask of contrast 4."""
    bench = MockBench.of(context_of(mask=PanelConfig(size_px=(80, 60), contrast=4.0)))
    bench.open_shutter(0)
    bench.close_shutter(2000 * MS)
    np.testing.assert_allclose(bench.photo(), 0.5, rtol=1e-9)
    assert bench.quads().shape == (3, 4, 3)
    np.testing.assert_allclose(bench.quads(), 0.5, rtol=1e-9)


def test_the_second_bucket_sees_what_the_first_does_not() -> None:
    """Of light that the mask stopped: it is open for the second where it is shut for the first."""
    bench = MockBench.of(context_of())
    frames, log = frames_and_log()
    white = replace(frames, primal_index=np.array([-2], np.int32))
    bench.open_shutter(0)
    bench.frames, bench.log = white, replace(log, end_ns=np.array([500 * MS, 500 * MS]))
    bench.close_shutter(500 * MS)
    first = bench.photo().sum()
    bench.second = True
    assert bench.photo().sum() > first
