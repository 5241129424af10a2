"""The mock panels to the nanosecond: vblanks, faults, planes, and what is told meanwhile.

Panels of 100 Hz have a vblank every 10 ms, and the virtual clock begins at one, at 1 s.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.mock.bench import MockBench
from drivers.mock.display import MockDisplay
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DisplayInfo, DriverContext
from pdcd.bench.tables import (
    CameraConfig,
    Config,
    DisplayConfig,
    FaultsConfig,
    PanelConfig,
    RigConfig,
    SceneConfig,
)
from pdcd.errors import Cancelled, ConfigError, PdcdError
from pdcd.panels.frames import BLACK, FrameLog, Frames

MS = 1_000_000

T0 = 1000 * MS

GRID = (3, 4)


def frames_of(count: int) -> Frames:
    """So many refreshes of one pattern of 12 cells."""
    patterns = np.zeros((1, 2), dtype=np.uint8)
    index = np.zeros(count, dtype=np.int32)
    none = np.zeros(count, dtype=np.uint8)
    guard = np.zeros(count, dtype=np.bool_)
    return Frames(patterns, patterns, index, index, none, index, guard, GRID, GRID, "whole")


class Rig:
    """The mock display on its bench."""

    def __init__(
        self,
        projector: dict[str, Any] | None = None,
        mask: dict[str, Any] | None = None,
        rig: dict[str, Any] | None = None,
        **display: Any,
    ) -> None:
        self.clock = VirtualClock()
        assert self.clock.now_ns() == T0
        panels = [
            PanelConfig(**{"size_px": size, "refresh_hz": 100.0, **(given or {})})
            for size, given in (((64, 48), projector), ((80, 60), mask))
        ]
        config = Config(
            projector=panels[0],
            mask=panels[1],
            scene=SceneConfig(grid=GRID),
            camera=CameraConfig(noise="none"),
            rig=RigConfig(**{"on_miss": "flag", **(rig or {})}),
            display=DisplayConfig(**display),
        )
        context = DriverContext(config=config, clock=self.clock)
        self.bench = MockBench.of(context)
        self.display = MockDisplay.create(context)
        self.told: list[tuple[int, int, int]] = []

    def play(self, count: int, cancel_after: int | None = None) -> FrameLog:
        """Show so many refreshes; `cancel_after` looks they are cancelled."""
        self.told.clear()
        looks = iter(range(10**9))

        def cancelled() -> bool:
            return cancel_after is not None and next(looks) >= cancel_after

        self.display.load(frames_of(count))
        return self.display.play(lambda *numbers: self.told.append(numbers), cancelled)


def times(log: FrameLog) -> tuple[list[float], list[float]]:
    """Rows of both panels in ms after the clock's beginning, and their end."""
    primal, dual = (
        [(at - T0) / MS for at in (*stamps.tolist(), end)]
        for stamps, end in zip((log.primal_ns, log.dual_ns), log.end_ns.tolist(), strict=True)
    )
    return primal, dual


# When.


@pytest.mark.parametrize(
    ("projector_s", "mask_s", "first"),
    [
        (0.0, 0.0, (0, 0)),
        (0.0, 0.004, (0, 4)),  # the mask follows
        (0.0, -0.003, (10, 7)),  # the mask leads: its vblank and the one after it belong together
        (0.002, 0.0, (2, 0)),
        (0.002, 0.006, (2, 6)),
        (0.007, 0.002, (7, 2)),
    ],
)
def test_the_vblanks_nearest_each_other_take_a_refresh(
    projector_s: float, mask_s: float, first: tuple[float, float]
) -> None:
    rig = Rig({"phase_s": projector_s}, {"phase_s": mask_s})
    primal, dual = times(rig.play(3))
    nearest = abs((mask_s - projector_s + 0.005) % 0.01 - 0.005)
    assert abs(dual[0] - primal[0]) == pytest.approx(1e3 * nearest)
    assert [at - primal[0] for at in primal] == [0, 10, 20, 30]
    assert [at - dual[0] for at in dual] == [0, 10, 20, 30]
    if projector_s == 0.0:
        assert (primal[0], dual[0]) == first


@pytest.mark.parametrize(("later_ns", "first_ms"), [(0, 0), (5, 0), (15, 10), (10 * MS, 10)])
def test_the_first_refresh_is_shown_at_the_next_vblank(later_ns: int, first_ms: int) -> None:
    """A vblank that is 10 ns over is taken for now: so much may be lost in rounding."""
    rig = Rig()
    rig.clock.sleep_until_ns(T0 + later_ns)
    primal, dual = times(rig.play(2))
    assert primal == dual == [first_ms, first_ms + 10, first_ms + 20]


def test_the_slower_panel_throttles_both() -> None:
    rig = Rig(mask={"refresh_hz": 50.0})
    log = rig.play(4)
    assert times(log) == ([0, 10, 30, 50, 70], [0, 20, 40, 60, 80])
    assert log.missed.tolist() == [0, 0, 1, 1]  # vblanks of the faster one without a new frame


def test_panels_jitter_as_much_as_said_and_never_run_backwards() -> None:
    rig = Rig({"jitter_s": 0.001})
    primal, dual = times(rig.play(400))
    off = np.array(primal) - 10.0 * np.arange(401)
    assert off.std() == pytest.approx(1.0, rel=0.15) and abs(off.mean()) < 0.2
    assert dual == [10.0 * n for n in range(401)]
    assert times(Rig({"jitter_s": 0.001}).play(400)) == (primal, dual)  # of the same seed
    wild = Rig({"jitter_s": 0.1})
    assert (np.diff(wild.play(50).primal_ns) >= 0).all()


# Faults.


def test_a_late_refresh_stretches_the_one_before() -> None:
    rig = Rig(faults=FaultsConfig(late={"2": 3, "4": 1}))
    log = rig.play(5)
    assert times(log)[0] == times(log)[1] == [0, 10, 50, 60, 80, 90]
    assert log.missed.tolist() == [0, 0, 3, 0, 1]
    assert log.primal_shown.tolist() == [0, 1, 2, 3, 4]
    assert rig.told[-1] == (5, 5, 4)


def test_a_dropped_refresh_leaves_the_one_before_on_both_panels() -> None:
    log = Rig(faults=FaultsConfig(dropped=(0, 2, 3, 5))).play(5)
    assert log.primal_shown.tolist() == log.dual_shown.tolist() == [0, 1, 1, 1, 4]
    assert log.missed.tolist() == [0, 0, 1, 1, 0]
    assert times(log)[0] == [0, 10, 20, 30, 40, 50]


def test_a_stale_panel_keeps_what_it_showed_alone() -> None:
    log = Rig(faults=FaultsConfig(stale_mask=(1,), stale_projector=(3,))).play(5)
    assert log.primal_shown.tolist() == [0, 1, 2, 2, 4]
    assert log.dual_shown.tolist() == [0, 0, 2, 3, 4]
    assert log.missed.tolist() == [0, 1, 0, 1, 0]
    assert log.primal_asked is not None and log.primal_asked.tolist() == [0, 1, 2, 3, 4]
    assert log.dual_asked is not None and log.dual_asked.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("exposures", "faulty"),
    [(0, [True] * 3), (1, [True, False, False]), (2, [True, True, False])],
)
def test_so_many_exposures_have_the_faults(exposures: int, faulty: list[bool]) -> None:
    """0 is all of them; each counts its refreshes from 0."""
    rig = Rig(faults=FaultsConfig(dropped=(1,), exposures=exposures))
    assert [bool(rig.play(3).missed.any()) for _ in range(3)] == faulty


# What.


def test_a_log_says_what_it_is_of() -> None:
    log = Rig(mask_delay_refreshes=1).play(2)
    assert (log.source, log.verified, log.mask_delay) == ("mock", True, 1)
    assert log.primal_shown.tolist() == [0, 1, BLACK]
    assert log.dual_shown.tolist() == [BLACK, 0, 1]
    assert log.primal_asked is not None and log.primal_asked.tolist() == [0, 1, BLACK]
    assert log.dual_asked is not None and log.dual_asked.tolist() == [BLACK, 0, 1]
    assert len(log.primal_ns) == len(log.dual_ns) == len(log.missed) == 3
    assert times(log)[0] == [0, 10, 20, 30]


@pytest.mark.parametrize("count", [24, 30, 47, 48])
@pytest.mark.parametrize("late", [{}, {"1": 2}])
@pytest.mark.parametrize("first", [0.0, 0.01])
def test_planes_of_a_picture_have_their_part_of_the_refresh(
    count: int, late: dict[str, int], first: float
) -> None:
    """Every time that the picture is shown; planes of the last one that nobody asked for are none.

    The first of two pictures is shown three times where the second comes two refreshes late.
    """
    starts = tuple(first + plane / 25.0 for plane in range(24))
    rig = Rig(
        planes_per_refresh=24, plane_starts=starts, faults=FaultsConfig(late=late)
    )  # on panels of 100 Hz
    log = rig.play(count)
    rows: list[tuple[int, float, int]] = []
    pictures = -(-count // 24)
    again = late.get("1", 0) if pictures == 2 else 0
    for picture in range(pictures):
        begins_ms = picture * (10.0 + 10.0 * again)
        for turn in range(1 + (again if picture == 0 else 0)):
            for plane in range(24):
                lost = again if picture == 1 and plane == 0 else 0
                at_ms = begins_ms + 10.0 * (turn + starts[plane])
                row = 24 * picture + plane
                rows.append((row if row < count else BLACK, at_ms, lost))
    end_ms = 10.0 * (pictures + again + first)
    if count % 24:
        cut = len(rows) - (24 - count % 24)
        end_ms, rows = rows[cut][1], rows[:cut]
    shown, at, missed = (list(column) for column in zip(*rows, strict=True))
    for side in (log.primal_shown, log.dual_shown, log.primal_asked, log.dual_asked):
        assert side is not None and side.tolist() == shown
    np.testing.assert_allclose(times(log)[0], [*at, end_ms], atol=1e-5)
    np.testing.assert_allclose(times(log)[1], [*at, end_ms], atol=1e-5)
    assert log.missed.tolist() == missed


# What is told.


def test_progress_is_told_ten_times_a_second_and_at_both_ends() -> None:
    rig = Rig(faults=FaultsConfig(late={"15": 1}))
    rig.play(25)
    assert rig.told == [(0, 25, 0), (10, 25, 0), (19, 25, 1), (25, 25, 1)]


def test_a_cancelled_exposure_ends_black_and_is_none() -> None:
    rig = Rig()
    with pytest.raises(Cancelled) as caught:
        rig.play(50, cancel_after=2)
    assert caught.value.device == "display"
    assert rig.clock.now_ns() == T0 + 200 * MS  # it was looked for three times
    assert rig.bench.black_since_ns == T0 + 200 * MS
    assert rig.bench.frames is None and rig.bench.log is None and not rig.bench.whole


def test_panels_that_hold_a_refresh_are_lit_until_they_are_black() -> None:
    rig = Rig()
    rig.display.show(frames_of(2))
    assert rig.bench.black_since_ns is None
    rig.clock.sleep_until_ns(T0 + 5)
    rig.display.black()
    assert rig.bench.black_since_ns == T0 + 5
    for end in (rig.display.connect, rig.display.disconnect):
        rig.display.show(frames_of(2))
        end()
        assert rig.bench.black_since_ns is not None


# What is said of them, and refused.


def test_panels_say_what_they_are() -> None:
    rig = Rig({"skew_s": 0.001}, {"phase_s": 0.004, "skew_s": 0.0035}, mask_delay_refreshes=2)
    info = rig.display.connect()
    assert info == DisplayInfo(
        (64, 48), (80, 60), 100.0,
        {"projector": "mock projector", "mask": "mock mask"}, info.mask_lag_s,
    )  # fmt: skip
    assert info.mask_lag_s == pytest.approx(0.004 + 0.0035 - 0.001 + 0.02)
    for side in ("projector", "mask"):
        drifting = Rig(**{side: {"refresh_hz": 50.0}}).display.connect()
        assert (drifting.refresh_hz, drifting.mask_lag_s) == (50.0, None)


def test_frames_must_fit_the_bench_and_both_panels() -> None:
    rig = Rig()
    wide = replace(frames_of(2), grid=(4, 3), lattice=(4, 3))
    with pytest.raises(ConfigError, match=r"frames of \(4, 3\) cells for a bench of \(3, 4\)"):
        rig.display.load(wide)
    for side in ("projector", "mask"):
        with pytest.raises(PdcdError, match=r"cells|pixels"):
            Rig(**{side: {"size_px": (2, 2)}}).display.load(frames_of(2))
    grey = replace(frames_of(2), dual_patterns=np.full((1, 12), 0.5, dtype=np.float32))
    rig.display.load(grey)
    with pytest.raises(ConfigError):
        Rig(planes_per_refresh=24).display.load(grey)
