"""What the driver of real panels says of them, and the log that it makes of vblanks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import x11
from drivers.x11 import X11Display, build_frame_log, has_several_codes
from pdcd.bench.clock import RealClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import DisplayConfig, PanelConfig, RigConfig
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.presenter.messages import LOG_COLUMNS, Column, Ready
from tests import bench_rig

PERIOD_NS = 10_000_000


def log_of(vblanks: list[int], *, flipped: bool = True) -> np.ndarray[Any, Any]:
    log = np.zeros((len(vblanks), LOG_COLUMNS), dtype=np.int64)
    log[:, Column.MSC] = vblanks
    log[:, Column.NS] = log[:, Column.MSC] * PERIOD_NS
    log[:, Column.FLIPPED] = flipped
    return log


def rows(*numbers: int) -> np.ndarray[Any, Any]:
    return np.array(numbers, dtype=np.int32)


def test_a_row_is_shown_from_its_vblank_and_late_by_those_that_passed() -> None:
    ready = Ready("present-complete", 100.0, {})
    found = build_frame_log(rows(0, 1, BLACK), rows(BLACK, 0, 1), log_of([7, 8, 11, 12]), ready)
    assert found.primal_shown.tolist() == [0, 1, BLACK]
    assert found.dual_shown.tolist() == [BLACK, 0, 1]
    assert found.primal_asked is not None and found.primal_asked.tolist() == [0, 1, BLACK]
    assert found.dual_asked is not None and found.dual_asked.tolist() == [BLACK, 0, 1]
    assert found.primal_ns.tolist() == found.dual_ns.tolist() == [n * PERIOD_NS for n in (7, 8, 11)]
    assert found.primal_ns is not found.dual_ns
    assert found.end_ns.tolist() == [12 * PERIOD_NS] * 2
    assert found.missed.tolist() == [0, 0, 2] and found.missed.dtype == np.int32
    assert (found.source, found.verified, found.mask_delay) == ("present-complete", True, 0)


def test_a_black_that_came_late_is_no_missed_row() -> None:
    found = build_frame_log(rows(0, 1), rows(0, 1), log_of([7, 8, 15]), Ready("clock", 100.0, {}))
    assert found.missed.tolist() == [0, 0]


@pytest.mark.parametrize(
    ("source", "flips", "verified"),
    [
        ("present-complete", [1, 1, 1], True),
        ("present-complete", [1, 0, 1], False),  # one was copied
        ("present-complete", [0, 0, 0], False),
        ("clock", [1, 1, 1], False),
        ("swap", [1, 1, 1], False),
    ],
)
def test_a_log_is_proof_where_the_source_is_one_and_every_frame_was_a_flip(
    source: Any, flips: list[int], verified: bool
) -> None:
    log = log_of([1, 2, 3])
    log[:, Column.FLIPPED] = flips
    found = build_frame_log(rows(0, 1), rows(0, 1), log, Ready(source, 100.0, {}))
    assert (found.source, found.verified) == (source, verified)


def frames_of(primal: list[int], dual: list[int], shift: list[int]) -> Frames:
    patterns, count = np.zeros((4, 2), np.uint8), len(primal)
    return Frames(
        patterns, patterns, np.array(primal, np.int32), np.array(dual, np.int32),
        np.array(shift, np.uint8), np.zeros(count, np.int32), np.zeros(count, np.bool_),
        (3, 4), (3, 4), "whole",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("primal", "dual", "shift", "several"),
    [
        ([0, 0], [0, 0], [0, 0], False),
        ([0, 1], [0, 0], [0, 0], True),
        ([0, 0], [0, 1], [0, 0], True),
        ([0, 0], [0, 0], [0, 1], True),
        ([0, 1], [0, BLACK], [0, 0], False),  # behind a black mask nothing is seen
        ([0, 0], [WHITE, WHITE], [0, 3], False),  # an open mask has no sub-shift
        ([0, 0], [WHITE, 0], [0, 0], True),
    ],
)
def test_a_miss_makes_codes_unequal_where_there_are_several(
    primal: list[int], dual: list[int], shift: list[int], several: bool
) -> None:
    assert has_several_codes(frames_of(primal, dual, shift)) is several


class Process:
    """Stands in for the display process; says `ready`, and shows each row for one vblank."""

    ready = Ready("clock", 100.0, {"renderer": "none"}, 0.001)
    told: tuple[tuple[int, int], ...] = ()

    def __init__(self, request: Any, alive: Any) -> None:
        self.alive = True
        self.looks_alive = alive
        self.given: list[Any] = []

    def load(self, frames: Frames) -> None:
        self.given.append(frames)

    def play(self, primal: Any, dual: Any, progress: Any, cancelled: Any, **_: Any) -> Any:
        self.given.append((primal, dual))
        for numbers in self.told:
            progress(*numbers)
        return log_of(list(range(5, 6 + len(primal))))


def panels_of(folder: Path, patch: pytest.MonkeyPatch, **tables: Any) -> X11Display:
    patch.setattr(x11, "DisplayProcess", Process)
    display = tables.pop("display", {})
    options = {"projector": "HDMI-1", "mask": "HDMI-2"}
    given: dict[str, Any] = {
        "rig": RigConfig(clock="real", on_miss="flag"),
        "projector": PanelConfig(size_px=(256, 192), refresh_hz=100.0, skew_s=0.001),
        "mask": PanelConfig(size_px=(320, 240), refresh_hz=100.0, skew_s=0.0035),
        "display": DisplayConfig(driver="x11", options=options, **display),
        **tables,
    }
    config = bench_rig.config(folder, **given)
    return X11Display.create(DriverContext(config=config, clock=RealClock()))


def test_panels_say_what_they_are_and_how_far_the_mask_is_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    panels = panels_of(tmp_path, monkeypatch, display={"mask_delay_refreshes": 2})
    info = panels.connect()
    assert (info.primal_size_px, info.dual_size_px) == ((256, 192), (320, 240))
    assert (info.refresh_hz, info.identity) == (100.0, {"renderer": "none"})
    assert info.mask_lag_s == pytest.approx(0.001 + 0.0035 - 0.001 + 0.02)
    monkeypatch.setattr(Process, "ready", Ready("clock", 100.0, {}, None))
    assert panels.connect().mask_lag_s is None
    assert X11Display.maturity == "experimental"


def test_the_mask_is_sent_its_rows_later_and_the_log_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    panels = panels_of(tmp_path, monkeypatch, display={"mask_delay_refreshes": 1})
    panels.load(frames_of([0, 1, 2], [0, 1, 2], [0, 0, 0]))
    log = panels.play(lambda *_: None, lambda: False)
    assert panels._presenter is not None
    primal, dual = panels._presenter.given[-1]  # type: ignore[attr-defined]
    assert primal.tolist() == [[0], [1], [2], [BLACK]]
    assert dual.tolist() == [[BLACK], [0], [1], [2]]
    assert log.mask_delay == 1 and len(log) == 4
    assert log.primal_shown.tolist() == [0, 1, 2, BLACK]


def test_pictures_of_24_planes_are_filled_up_by_black_and_counted_in_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    panels = panels_of(tmp_path, monkeypatch, display={"planes_per_refresh": 24})
    monkeypatch.setattr(Process, "told", ((0, 0), (1, 3), (2, 3)))
    panels.load(frames_of([0] * 30, [0] * 30, [0] * 30))
    told: list[tuple[int, int, int]] = []
    log = panels.play(lambda *numbers: told.append(numbers), lambda: False)
    assert told == [(0, 30, 0), (24, 30, 3), (30, 30, 3), (30, 30, 0)]
    assert panels._presenter is not None
    primal, _ = panels._presenter.given[-1]  # type: ignore[attr-defined]
    assert primal.shape == (2, 24)
    assert primal.ravel().tolist() == [*range(30), *[BLACK] * 18]
    assert len(log) == 30 and panels._shared.pixels is None


def test_frames_may_be_played_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    panels = panels_of(tmp_path, monkeypatch)
    frames = frames_of([0, 1], [0, 1], [0, 0])
    panels.load(frames)
    first, second = (panels.play(lambda *_: None, lambda: False) for _ in range(2))
    assert first.primal_shown.tolist() == second.primal_shown.tolist() == [0, 1]
    panels.load(replace(frames, guard=np.ones(2, np.bool_)))
    assert panels._presenter is not None
    assert len(panels._presenter.given) == 4  # type: ignore[attr-defined]
