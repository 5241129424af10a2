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
from pdcd.panels.frames import Frames
from pdcd.panels.schedule import build_frames
from pdcd.presenter.messages import LOG_COLUMNS, Column, Ready
from tests import bench_rig

PERIOD_NS = 16_667_000


class Process:
    """Stands in for the display process; `said` is what all of them were asked, in order."""

    said: list[Any]
    fault: Exception | None
    late: dict[int, int]

    def __init__(self, request: Any, alive: Callable[[], object]) -> None:
        self.alive = True
        self.ready = Ready("clock", 60.0, {"renderer": "none"}, 0.001)
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
        assert not cancelled()
        progress(1, 0)
        log = np.zeros((len(primal) + 1, LOG_COLUMNS), dtype=np.int64)
        steps = [1 + self.late.get(n, 0) for n in range(len(log))]
        log[:, Column.MSC] = np.cumsum(steps)
        log[:, Column.NS] = log[:, Column.MSC] * PERIOD_NS
        return log


@pytest.fixture
def process(monkeypatch: pytest.MonkeyPatch) -> type[Process]:
    monkeypatch.setattr(x11, "DisplayProcess", Process)
    Process.said, Process.fault, Process.late = [], None, {}
    return Process


def display(folder: Path, *, rig: dict[str, Any] | None = None, **options: Any) -> X11Display:
    size = (256, 192)
    config = bench_rig.config(
        folder,
        rig=RigConfig(clock="real", **(rig or {})),
        projector=PanelConfig(size_px=size),
        mask=PanelConfig(size_px=size),
        display=DisplayConfig(
            driver="x11", options={"projector": "HDMI-1", "mask": "HDMI-2", **options}
        ),
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
    ("on_miss", "codes", "abort"),
    [("abort", 4, True), ("abort", 1, False), ("balance", 4, False), ("flag", 4, False)],
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


def test_misses_of_earlier_passes_are_counted_while_the_next_is_shown(
    process: type[Process], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    panels = display(tmp_path, rig={"on_miss": "balance"})
    shown = frames()
    panels.load(shown)
    code = int(np.flatnonzero(shown.dual_index >= 0)[0])
    process.late = {code + 1: 2}
    real = Process.play

    def missing_one(self: Process, primal: Any, dual: Any, progress: Any, *a: Any, **k: Any) -> Any:
        progress(1, 1)
        found = real(self, primal, dual, progress, *a, **k)
        process.late = {}
        return found

    monkeypatch.setattr(Process, "play", missing_one)
    lost = [numbers[2] for numbers in play(panels)]
    assert lost == [1, 0, 2, 3, 2, 2]


def test_grey_is_not_sent_in_single_bits(process: type[Process], tmp_path: Path) -> None:
    size = (256, 192)
    config = bench_rig.config(
        tmp_path,
        rig=RigConfig(clock="real"),
        projector=PanelConfig(size_px=size),
        mask=PanelConfig(size_px=size),
        display=DisplayConfig(
            driver="x11", planes_per_refresh=24, options={"projector": "A", "mask": "B"}
        ),
    )
    panels = X11Display.create(DriverContext(config=config, clock=RealClock()))
    grey = replace(frames(), dual_patterns=np.full((4, 12), 0.5, dtype=np.float32))
    with pytest.raises(ConfigError):
        panels.load(grey)
    assert process.said == []
    panels.load(frames())
    play(panels)
    assert process.said[-1] == ("play", -(-len(frames()) // 24), True, 0)


def test_pictures_of_several_planes_are_not_looked_at(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="several planes"):
        X11Display.create(
            DriverContext(
                config=bench_rig.config(
                    tmp_path,
                    rig=RigConfig(clock="real"),
                    display=DisplayConfig(
                        driver="x11",
                        planes_per_refresh=24,
                        options={
                            "projector": "A", "mask": "B", "grab_px": [[0, 0], [300, 0]],
                        },
                    ),
                ),
                clock=RealClock(),
            )
        )  # fmt: skip


@pytest.mark.parametrize("count", [5, 6])
def test_planes_of_a_picture_have_their_part_of_the_refresh_each_time_it_is_shown(
    count: int,
) -> None:
    """The second of three pictures lasts two refreshes of 10 ms; the third may be half empty."""
    starts, period_ns = (0.1, 0.4), 10_000_000
    late = [0, 1, 0]
    log = np.zeros((4, LOG_COLUMNS), dtype=np.int64)
    log[:, Column.MSC] = [100, 101, 103, 104]
    log[:, Column.NS] = log[:, Column.MSC] * period_ns
    primal = np.arange(10, 10 + count, dtype=np.int32)
    found = x11.build_frame_log(primal, primal + 50, log, Ready("clock", 100.0, {}), starts)

    wanted: list[tuple[int, int, int]] = []
    for picture, again in enumerate(late):
        for turn in range(1 + again):
            for plane, start in enumerate(starts):
                at_ns = int(log[picture, Column.NS]) + round((turn + start) * period_ns)
                lost = late[picture - 1] if picture and not turn and not plane else 0
                wanted.append((10 + 2 * picture + plane, at_ns, lost))
    end_ns = 1040 * 1_000_000 + 1_000_000  # black begins with its own first plane
    if count == 5:  # the plane that fills the last picture up is black already
        end_ns = wanted.pop()[1]
    rows, times_ns, missed = (list(column) for column in zip(*wanted, strict=True))
    assert found.primal_shown.tolist() == rows
    assert found.dual_shown.tolist() == [row + 50 for row in rows]
    assert found.primal_ns.tolist() == found.dual_ns.tolist() == times_ns
    assert found.missed.tolist() == missed
    assert found.end_ns.tolist() == [end_ns, end_ns]
    assert found.primal_shown.dtype == found.missed.dtype == np.int32


def test_planes_never_run_backwards_where_stamps_jitter() -> None:
    log = np.zeros((3, LOG_COLUMNS), dtype=np.int64)
    log[:, Column.MSC] = [100, 101, 102]
    log[:, Column.NS] = [1_000_000_000, 1_008_000_000, 1_020_000_000]
    rows = np.arange(4, dtype=np.int32)
    found = x11.build_frame_log(rows, rows, log, Ready("clock", 100.0, {}), (0.0, 0.9))
    assert found.primal_ns.tolist() == [
        1_000_000_000, 1_009_000_000, 1_009_000_000, 1_017_000_000,
    ]  # fmt: skip


def test_pictures_of_the_screen_are_kept_with_the_black_between_two_passes(
    process: type[Process], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[Any] = []

    class Recorder:
        def __init__(self, *sizes_px: tuple[int, int]) -> None:
            kept.append(sizes_px)

        def add(self, projector: Any, mask: Any) -> None:
            kept.append((projector, mask))

        def black(self) -> None:
            kept.append("black")

        def shown(self) -> str:
            return "all of them"

    monkeypatch.setattr(x11, "Recorder", Recorder)
    panels = display(
        tmp_path, rig={"on_miss": "balance"}, time_source="present-msc",
        grab_px=[[0, 0], [300, 0]],
    )  # fmt: skip
    shown = frames()
    panels.load(shown)
    code = int(np.flatnonzero(shown.dual_index >= 0)[0])
    process.late = {code + 1: 2}
    real = Process.play

    def grabbed(self: Any, *a: Any, **k: Any) -> Any:
        self.pictures = [["p0", "p1"], ["m0", "m1"]]
        assert panels._shared.pixels is None  # those of the last exposure are gone
        found = real(self, *a, **k)
        process.late = {}
        return found

    monkeypatch.setattr(Process, "play", grabbed)
    panels._shared.pixels = "older"  # type: ignore[assignment]
    play(panels)
    pair = [("p0", "m0"), ("p1", "m1")]
    assert kept == [((256, 192), (256, 192)), *pair, "black", *pair]
    assert panels._shared.pixels == "all of them"  # type: ignore[comparison-overlap]
