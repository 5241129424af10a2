"""A pass of the display process without its windows: what is shown, what ends it, and that it is
black whatever happens."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import glfw
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.errors import ConfigError, DeviceLost
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.presenter import realtime
from pdcd.presenter.messages import HEAD_SIZE, LOG_COLUMNS, Head, Load, Play
from pdcd.presenter.options import X11Options
from pdcd.presenter.process import Presenter

PERIOD_NS = 10_000_000


class Rows:
    """Frames of which the mask's half matters: rows 0 and 2 open it."""

    def __init__(self, count: int) -> None:
        self.dual_index = np.array([0, BLACK, WHITE, BLACK, BLACK, 0][:count], dtype=np.int32)

    def __len__(self) -> int:
        return len(self.dual_index)


class Stage:
    """A presenter with one code among four rows; `done` is what its windows and places did."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, planes: int = 1, **options: Any) -> None:
        self.done: list[Any] = []
        self.switch_s: list[float] = []
        self.slept_s: list[float] = []
        self.news = self.changed = self.gone = False
        self.ns = self.msc = self.flipped = self.steps = 0
        self.name, self.queues = "stage", False
        self.fault: Exception | None = None
        monkeypatch.setattr(realtime, "arm_dead_mans_switch", self.switch_s.append)
        monkeypatch.setattr(time, "sleep", self.slept_s.append)
        words = ("black", "check", "settle")
        windows = SimpleNamespace(
            planes=planes, prepare=self.prepare, draw=self.draw,
            **{word: lambda word=word: self.done.append(word) for word in words},
        )  # fmt: skip
        self.presenter = made = Presenter.__new__(Presenter)
        made._options = X11Options(projector="A", mask="B", hang_s=3.0, **options)
        made._windows, made._source = windows, self  # type: ignore[assignment]
        made._period_ns, made._grabs, made._hung_up = float(PERIOD_NS), None, lambda: self.gone
        made._news = SimpleNamespace(poll=lambda wait: [1] if self.news else [])  # type: ignore[assignment]
        made._places = SimpleNamespace(  # type: ignore[assignment]
            changed=lambda: self.changed,
            check=lambda unheard: self.done.append("places" if unheard else "heard"),
        )
        self.frames(4)

    def frames(self, count: int) -> None:
        self.presenter._frames = Rows(count) if count else None  # type: ignore[assignment]

    def prepare(self, primal: Any, dual: Any) -> None:
        self.done.append(("prepare", np.array(primal).tolist(), np.array(dual).tolist()))

    def draw(self, number: int) -> None:
        self.done.append(("draw", number))
        if self.fault is not None and number == 2:
            raise self.fault

    def sync(self) -> None:
        self.done.append("sync")

    def put(self) -> None: ...

    def shown(self) -> None:
        self.steps += 1
        self.msc += 1 if self.steps != self.late else 2
        self.ns = self.msc * PERIOD_NS

    late = 0

    def play(self, *rows_of: list[int], **message: Any) -> NDArray[np.int64]:
        """Rows 0, 3, 2 and black; returns the head."""
        rows = np.array(rows_of or [[0], [3], [2], [BLACK]], dtype=np.int32)
        arrays: dict[str, NDArray[Any]] = {
            "head": np.zeros(HEAD_SIZE, dtype=np.int64), "primal": rows, "dual": rows,
            "log": np.zeros((4, LOG_COLUMNS), dtype=np.int64),
        }  # fmt: skip
        self.head = arrays["head"]
        self.head[Head.FIRST] = message.pop("first", 0)
        self.head[Head.STOP] = message.pop("told", 0)
        self.presenter.play(Play([], **message), arrays)
        return self.head

    @property
    def drawn(self) -> list[int]:
        return [what[1] for what in self.done if what[0] == "draw"]


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch) -> Stage:
    return Stage(monkeypatch, stalls_ms={"1": 30.0})


def test_a_pass_ends_in_black_with_the_switch_disarmed(stage: Stage) -> None:
    head = stage.play(stalls=False)
    assert (head[Head.SHOWN], head[Head.MISSED], head[Head.SPOILT]) == (4, 0, 0)
    assert stage.drawn == [0, 1, 2, 3]
    rows = [[0], [3], [2], [BLACK]]
    assert stage.done[0] == ("prepare", rows, rows)
    assert stage.done[-3:] == ["black", "check", "places"]
    # Armed before the first refresh and after each: none may take longer than that.
    assert stage.switch_s[-1] == 0.0 and len(stage.switch_s) == 6
    assert set(stage.switch_s[:-1]) == {6.0}
    assert stage.slept_s == []


def test_a_pass_that_fails_is_black_all_the_same(stage: Stage) -> None:
    stage.fault = DeviceLost("the window is gone")
    with pytest.raises(DeviceLost):
        stage.play()
    assert stage.done[-2:] == [("draw", 2), "black"] and stage.switch_s[-1] == 0.0


@pytest.mark.parametrize(
    ("happens", "shown"),
    [
        ({}, 4),
        ({"news": True}, 4),  # of something else
        ({"gone": True}, 4),  # nobody has said so
        ({"news": True, "gone": True}, 1),
        ({"news": True, "changed": True}, 1),
    ],
)
def test_a_driver_that_is_gone_or_an_output_that_changed_ends_a_pass(
    stage: Stage, happens: dict[str, bool], shown: int
) -> None:
    for name, value in happens.items():
        setattr(stage, name, value)
    assert stage.play()[Head.SHOWN] == shown
    assert stage.done[-3:] == ["black", "check", "places"]


def test_a_driver_that_says_stop_is_heard_after_the_next_refresh(stage: Stage) -> None:
    assert stage.play(told=1)[Head.SHOWN] == 1


@pytest.mark.parametrize(("abort", "late", "shown"), [
    (True, 2, 2), (True, 3, 4), (True, 4, 4), (True, 0, 4), (False, 2, 4),
])  # fmt: skip
def test_a_code_that_lasted_too_long_ends_a_pass_where_that_is_asked_for(
    stage: Stage, abort: bool, late: int, shown: int
) -> None:
    """The first and third refresh are codes: the second one, late, stretches the first."""
    stage.late = late
    head = stage.play(abort=abort)
    assert head[Head.SHOWN] == shown
    assert head[Head.SPOILT] == (late in (2, 4))


@pytest.mark.parametrize(("stalls", "first", "slept"), [
    (True, 0, 1), (True, 2, 1), (True, 3, 0), (False, 0, 0),
])  # fmt: skip
def test_stalls_are_for_passes_that_are_to_have_them(
    stage: Stage, stalls: bool, first: int, slept: int
) -> None:
    stage.play(stalls=stalls, first=first)
    assert stage.slept_s == [pytest.approx(0.03)] * slept


@pytest.mark.parametrize("refused", [False, True])
def test_what_was_loaded_is_taken_over_where_the_windows_take_it(
    stage: Stage, refused: bool
) -> None:
    taken: list[Frames] = []

    def load(frames: Frames) -> None:
        taken.append(frames)
        if refused:
            raise ConfigError("too many")

    stage.presenter._windows.load = load  # type: ignore[method-assign]
    index = np.zeros(2, dtype=np.int32)
    names = ("primal_patterns", "dual_patterns", "primal_index", "dual_index")
    arrays: dict[str, Any] = dict.fromkeys((*names, "shift", "code", "guard"), index)
    try:
        stage.presenter.load(Load([], (2, 3), (3, 4), "quarter"), arrays)
    except ConfigError:
        assert refused
    (frames,) = taken
    assert (frames.grid, frames.lattice, frames.window) == ((2, 3), (3, 4), "quarter")
    assert stage.presenter._frames is (None if refused else frames)
    assert stage.done == ["places"]


def test_nothing_is_played_before_it_was_loaded(stage: Stage) -> None:
    stage.presenter._frames = None
    with pytest.raises(ConfigError, match="no frames are loaded"):
        stage.play()
    assert stage.done == []


@pytest.mark.parametrize(
    ("planes", "count", "row", "rows"),
    [
        (1, 4, 2, [2]),
        (3, 6, 1, [1, 2, 3]),
        (3, 6, 3, [3, 4, 5]),
        (3, 6, 4, [4, 5, BLACK]),
        (3, 1, 0, [0, 0, 0]),  # one row alone fills a picture
        (3, 2, 0, [0, 1, BLACK]),
        (3, 0, 2, [2, 2, 2]),  # nothing is loaded: the windows know what that row is
    ],
)
def test_a_held_row_is_drawn_into_both_buffers(
    monkeypatch: pytest.MonkeyPatch, planes: int, count: int, row: int, rows: list[int]
) -> None:
    stage = Stage(monkeypatch, planes)
    stage.frames(count)
    stage.presenter.show(row)
    picture = ("prepare", [rows], [rows])
    assert stage.done == ["sync", picture, ("draw", 0), ("draw", 0), "settle", "check"]
    assert stage.steps == 2


def test_at_the_end_it_is_black_before_anything_is_closed(
    monkeypatch: pytest.MonkeyPatch, stage: Stage
) -> None:
    made, done = stage.presenter, stage.done

    def closing(name: str) -> Any:
        return SimpleNamespace(close=lambda: done.append(name), black=lambda: done.append("black"))

    made._windows, made._events = closing("windows"), closing("events")
    monkeypatch.setattr(glfw, "terminate", lambda: done.append("glfw"))
    made.close()
    assert done == ["black", "events", "windows", "glfw"]
