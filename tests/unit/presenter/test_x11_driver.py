"""The driver of two real panels without them: when it goes black, what it forgets, what it asks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import x11
from drivers.x11 import X11Display
from pdcd.bench.clock import RealClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import DisplayConfig, PanelConfig, RigConfig
from pdcd.codes.make import make_codes
from pdcd.errors import ConfigError, DeviceLost
from pdcd.panels.frames import BLACK, Frames
from pdcd.panels.schedule import build_frames
from pdcd.presenter.messages import LOG_COLUMNS, Column, Ready
from tests import bench_rig

PERIOD_NS = 16_667_000


class Process:
    """Stands in for the display process; `said` is what all of them were asked, in order."""

    said: list[Any]
    sent: list[Any]
    told: tuple[tuple[int, int], ...]
    fault: Exception | None
    late: dict[int, int]
    ready = Ready("clock", 60.0, {"renderer": "none"}, 0.001)

    def __init__(self, request: Any, alive: Callable[[], object], look: Any) -> None:
        self.alive = True
        self.said.append("start")

    def _do(self, what: Any) -> None:
        self.said.append(what)
        if self.fault is not None:
            raise self.fault

    def load(self, frames: Frames) -> None:
        self._do("load")

    def show(self, row: int) -> None:
        self._do(("show", row))

    def black(self) -> None:
        self._do("black")

    def close(self) -> None:
        self.alive = False
        self._do("close")

    def play(
        self, primal: Any, dual: Any, progress: Any, cancelled: Any, **asked: Any
    ) -> np.ndarray[Any, Any]:
        self._do(("play", len(primal), asked["abort"], asked["stalls_from"]))
        self.sent[:] = primal, dual
        assert not cancelled()
        for numbers in self.told:
            progress(*numbers)
        log = np.zeros((len(primal) + 1, LOG_COLUMNS), dtype=np.int64)
        steps = [1 + self.late.get(n, 0) for n in range(len(log))]
        log[:, Column.MSC] = np.cumsum(steps)
        log[:, Column.NS] = log[:, Column.MSC] * PERIOD_NS
        return log


@pytest.fixture
def process(monkeypatch: pytest.MonkeyPatch) -> type[Process]:
    monkeypatch.setattr(x11, "DisplayProcess", Process)
    Process.said, Process.sent, Process.told = [], [], ((1, 0),)
    Process.fault, Process.late = None, {}
    return Process


def display(
    folder: Path,
    *,
    rig: dict[str, Any] | None = None,
    shown: dict[str, Any] | None = None,
    **options: Any,
) -> X11Display:
    panels: dict[str, Any] = {
        role: PanelConfig(size_px=(256, 192), skew_s=skew_s)
        for role, skew_s in (("projector", 0.001), ("mask", 0.0035))
    }
    named = {"projector": "HDMI-1", "mask": "HDMI-2", **options}
    config = bench_rig.config(
        folder,
        rig=RigConfig(clock="real", **(rig or {})),
        display=DisplayConfig(driver="x11", options=named, **(shown or {})),
        **panels,
    )
    return X11Display.create(DriverContext(config=config, clock=RealClock()))


def frames(codes: int = 4) -> Frames:
    made = make_codes("hadamard", bench_rig.GRID, codes, dual="complement")
    return build_frames(
        bench_rig.pairs(made), bench_rig.GRID, window="whole", schedule="full", passes=1
    )


def play(panels: X11Display) -> list[tuple[int, int, int]]:
    told: list[tuple[int, int, int]] = []
    panels.play(lambda *numbers: told.append(numbers), lambda: False)
    return told


def test_panels_that_were_never_opened_are_neither_blackened_nor_closed(
    process: type[Process], tmp_path: Path
) -> None:
    panels = display(tmp_path)
    panels.black()
    panels.disconnect()
    assert process.said == []


def test_black_reaches_the_panels_and_its_failure_the_caller(
    process: type[Process], tmp_path: Path
) -> None:
    panels = display(tmp_path)
    info = panels.connect()
    assert (info.refresh_hz, info.identity["renderer"]) == (60.0, "none")
    panels.black()
    assert process.said == ["start", "black"]
    process.fault = DeviceLost("gone")
    with pytest.raises(DeviceLost):
        panels.black()


@pytest.mark.parametrize("fault", [None, DeviceLost("gone")])
def test_a_disconnect_closes_once_and_forgets_what_was_loaded(
    process: type[Process], tmp_path: Path, fault: Exception | None
) -> None:
    panels = display(tmp_path)
    panels.load(frames())
    process.fault = fault
    if fault is None:
        panels.disconnect()
    else:
        with pytest.raises(DeviceLost):
            panels.disconnect()
    panels.disconnect()
    panels.black()
    assert process.said == ["start", "load", "close"]
    with pytest.raises(ConfigError, match="no frames are loaded"):
        play(panels)


def test_a_process_that_died_is_let_go_of_and_another_started(
    process: type[Process], tmp_path: Path
) -> None:
    panels = display(tmp_path)
    for _ in range(2):
        panels.connect()
    assert process.said == ["start"]
    panels.load(frames())
    assert panels._presenter is not None
    panels._presenter.alive = False  # type: ignore[misc]
    with pytest.raises(DeviceLost, match=r"has ended \(take the shot again\)"):
        play(panels)
    panels.show(frames())
    assert process.said == ["start", "load", "close", "start", "load", ("show", 0)]
    play(panels)


def test_patterns_that_were_refused_are_not_played(process: type[Process], tmp_path: Path) -> None:
    panels = display(tmp_path)
    panels.load(frames())
    process.fault = ConfigError("too many")
    with pytest.raises(ConfigError, match="too many"):
        panels.load(frames())
    process.fault = None
    with pytest.raises(ConfigError, match="no frames are loaded"):
        play(panels)


@pytest.mark.parametrize(
    ("on_miss", "codes", "abort"), [("abort", 4, True), ("abort", 1, False), ("balance", 4, False)]
)
def test_a_miss_ends_a_pass_only_where_it_makes_codes_unequal_and_that_is_asked_for(
    process: type[Process], tmp_path: Path, on_miss: str, codes: int, abort: bool
) -> None:
    panels = display(tmp_path, rig={"on_miss": on_miss})
    shown = frames(4)
    if codes == 1:
        code = shown.dual_index >= 0
        shown.dual_index[code], shown.primal_index[code] = 0, 0
    panels.load(shown)
    play(panels)
    assert process.said[-1] == ("play", len(shown), abort, 0)


@pytest.mark.parametrize(("exposures", "stalled"), [(0, [1, 1, 1]), (1, [1, 0, 0]), (2, [1, 1, 0])])
def test_so_many_exposures_are_stalled(
    process: type[Process], tmp_path: Path, exposures: int, stalled: list[int]
) -> None:
    """0 is all of them."""
    panels = display(tmp_path, stall_exposures=exposures)
    panels.load(frames())
    for _ in stalled:
        play(panels)
    said = [what[3] for what in process.said if what[0] == "play"]
    assert said == [0 if one else None for one in stalled]


def test_progress_counts_on_through_the_passes_that_make_up_for_a_miss(
    process: type[Process], tmp_path: Path
) -> None:
    panels = display(tmp_path, rig={"on_miss": "balance"})
    shown = frames()
    panels.load(shown)
    code = int(np.flatnonzero(shown.dual_index >= 0)[0])
    process.late = {code + 1: 2}  # the first code lasts three refreshes

    def once(*args: Any, **kwargs: Any) -> Any:
        found = Process.play(first, *args, **kwargs)
        process.late = {}
        return found

    panels.connect()
    first: Any = panels._presenter
    first.play = once
    told = play(panels)
    passes = [what for what in process.said if what[0] == "play"]
    assert len(passes) == 2
    count, more = len(shown), passes[1][1]
    assert passes[1][3] == count
    assert told == [
        (1, count, 0),
        (count, count, 2),
        (count + 1, count + more, 2),
        (count + more, count + more, 2),
    ]


def test_pictures_of_several_planes_are_not_looked_at(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="several planes"):
        display(tmp_path, shown={"planes_per_refresh": 24}, grab_px=[[0, 0], [300, 0]])


def test_panels_say_what_they_are_and_how_far_the_mask_is_behind(
    process: type[Process], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    panels = display(tmp_path, shown={"mask_delay_refreshes": 2})
    info = panels.connect()
    assert (info.primal_size_px, info.dual_size_px) == ((256, 192), (256, 192))
    assert (info.refresh_hz, info.identity) == (60.0, {"renderer": "none"})
    assert info.mask_lag_s == pytest.approx(0.001 + 0.0035 - 0.001 + 2 / 60)
    monkeypatch.setattr(Process, "ready", Ready("clock", 60.0, {}, None))
    assert panels.connect().mask_lag_s is None


def test_the_mask_is_sent_its_rows_later_and_the_log_says_so(
    process: type[Process], tmp_path: Path
) -> None:
    panels = display(tmp_path, rig={"on_miss": "flag"}, shown={"mask_delay_refreshes": 1})
    panels.load(frames())
    log = panels.play(lambda *_: None, lambda: False)
    count = len(frames())
    primal, dual = (sent.ravel().tolist() for sent in process.sent)
    assert primal == [*range(count), BLACK] and dual == [BLACK, *range(count)]
    assert log.mask_delay == 1 and log.primal_shown.tolist() == primal


def test_pictures_of_24_planes_are_filled_up_by_black_and_counted_in_rows(
    process: type[Process], tmp_path: Path
) -> None:
    panels = display(tmp_path, rig={"on_miss": "flag"}, shown={"planes_per_refresh": 24})
    grey = replace(frames(), dual_patterns=np.full((4, 12), 0.5, dtype=np.float32))
    with pytest.raises(ConfigError):
        panels.load(grey)  # grey is not sent in single bits
    assert process.said == []
    process.told = ((0, 0), (1, 3), (2, 3))
    panels.load(frames(12))
    told: list[tuple[int, int, int]] = []
    log = panels.play(lambda *numbers: told.append(numbers), lambda: False)
    assert told == [(0, 36, 0), (24, 36, 3), (36, 36, 3), (36, 36, 0)]
    assert process.sent[0].shape == (2, 24)
    assert process.sent[0].ravel().tolist() == [*range(36), *[BLACK] * 12]
    assert len(log) == 36 and panels._shared.pixels is None
