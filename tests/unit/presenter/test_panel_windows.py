"""Windows by a library that stands in for GLFW and GL: how they open, draw, swap and close."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import glfw
import moderngl
import pytest

from pdcd.errors import DeviceLost
from pdcd.panels.map import Map, PanelView
from pdcd.presenter import windows as windows_module
from pdcd.presenter.messages import Rect
from pdcd.presenter.windows import PanelWindows

PLACES = Rect(0, 0, 256, 192), Rect(256, 7, 400, 290)
SCREEN_PX = 656, 300
VIEWS = PanelView("projector", Map.filling((256, 192))), PanelView("mask", Map.filling((400, 290)))
SPAN = Rect(0, 0, 656, 300)


class Desk:
    """GLFW, GL and Xlib at once; `done` is what they were told, in order."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done: list[Any] = []
        self.opened: list[tuple[int, int]] = []
        self.places: list[Rect] = []
        self.panels: list[Any] = []
        self.contexts = 0
        self.error = "GL_NO_ERROR"
        for name in (
            "window_hint", "create_window", "set_input_mode", "make_context_current",
            "swap_interval", "swap_buffers", "show_window", "poll_events", "get_window_pos",
            "get_framebuffer_size", "get_x11_window", "get_x11_display",
        ):  # fmt: skip
            monkeypatch.setattr(glfw, name, getattr(self, name, None) or self._noting(name))
        monkeypatch.setattr(moderngl, "create_context", self.create_context)
        monkeypatch.setattr(windows_module, "Viewport", self.viewport)
        monkeypatch.setattr(windows_module, "_x_sync", lambda display: self._noting("sync"))

    def _noting(self, name: str) -> Any:
        return lambda *words: self.done.append((name, *words))

    def window_hint(self, hint: int, value: Any) -> None: ...

    def create_window(self, width: int, height: int, *rest: Any) -> str:
        self.opened.append((width, height))
        return f"w{len(self.opened)}"

    def get_window_pos(self, handle: str) -> tuple[int, int]:
        place = self.places[int(handle[1:]) - 1]
        return place.x, place.y

    def get_framebuffer_size(self, handle: str) -> tuple[int, int]:
        place = self.places[int(handle[1:]) - 1]
        return place.width, place.height

    def get_x11_window(self, handle: str) -> int:
        return 100 + int(handle[1:])

    def get_x11_display(self) -> int:
        return 0x7F00

    def create_context(self, require: int) -> Any:
        assert require == 330
        self.contexts += 1
        name = f"c{self.contexts}"
        screen = SimpleNamespace(
            clear=self._noting(f"{name} clear"), use=self._noting(f"{name} use")
        )
        desk = self

        class Context:
            info = {"GL_RENDERER": f"renderer {name}"}  # noqa: RUF012

            def __init__(self) -> None:
                self.screen, self.name = screen, name
                self.finish = desk._noting(f"{name} finish")

            @property
            def error(self) -> str:
                desk.done.append(f"{name} error?")
                return desk.error

            def disable_direct(self, number: int) -> None:
                desk.done.append((f"{name} disable", number))

        return Context()

    def viewport(self, context: Any, view: PanelView, *rest: Any) -> Any:
        self.panels.append((context.name, view, *rest))
        role = view.role
        names = ("load", "warm_up", "prepare", "draw_pieces", "draw")
        return SimpleNamespace(**{name: self._noting(f"{role} {name}") for name in names})

    def open(self, layout: str, order: str | None = None) -> PanelWindows:
        self.places = [SPAN] if layout == "span" else list(PLACES)
        return PanelWindows(layout, SCREEN_PX, PLACES, VIEWS, order)

    def told(self) -> list[Any]:
        found = [what[0] if isinstance(what, tuple) and len(what) == 1 else what
                 for what in self.done]  # fmt: skip
        del self.done[:]
        return found


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch) -> Desk:
    return Desk(monkeypatch)


def opening(handle: str, context: str, interval: int) -> list[Any]:
    """What a window is told from its making to its first appearance: black, twice, before it."""
    return [
        ("set_input_mode", handle, glfw.CURSOR, glfw.CURSOR_HIDDEN),
        ("make_context_current", handle), ("swap_interval", interval),
        (f"{context} disable", 0x0BD0), f"{context} clear", ("swap_buffers", handle),
        f"{context} clear", ("swap_buffers", handle), ("show_window", handle), f"{context} clear",
        ("swap_buffers", handle), "poll_events",
    ]  # fmt: skip


def test_one_window_covers_the_screen_and_has_both_panels_counted_from_its_bottom(
    desk: Desk,
) -> None:
    made = desk.open("span")
    assert desk.opened == [(656, 300)] and desk.told() == opening("w1", "c1", 1)
    assert desk.panels == [
        ("c1", VIEWS[0], (0, 108), 0, None), ("c1", VIEWS[1], (256, 3), 3, None),
    ]  # fmt: skip
    assert made.planes == 1 and made.timed_window == 101
    assert made.renderer == "renderer c1"


def test_windows_of_their_own_wait_for_the_masks_vblank_alone(desk: Desk) -> None:
    made = desk.open("windows", "RGB")
    assert desk.opened == [(256, 192), (400, 290)]
    assert desk.told() == opening("w1", "c1", 0) + opening("w2", "c2", 1)
    assert desk.panels == [
        ("c1", VIEWS[0], (0, 0), 0, "RGB"), ("c2", VIEWS[1], (0, 0), 0, "RGB"),
    ]  # fmt: skip
    assert made.planes == 24 and made.timed_window == 102
    assert made.renderer == "renderer c1"


@pytest.mark.parametrize("place", [Rect(0, 1, 656, 300), Rect(0, 0, 656, 299)])
def test_a_window_that_comes_out_elsewhere_is_refused(desk: Desk, place: Rect) -> None:
    desk.places = [place]
    with pytest.raises(DeviceLost, match=r"came out as .* \(no window manager may run"):
        PanelWindows("span", SCREEN_PX, PLACES, VIEWS, None)


def test_a_fault_of_the_graphics_card_is_a_lost_device(desk: Desk) -> None:
    made = desk.open("span")
    desk.error = "GL_OUT_OF_MEMORY"
    with pytest.raises(DeviceLost, match=r"card reports GL_OUT_OF_MEMORY \(see the kernel's log"):
        made.check()


@pytest.mark.parametrize("layout", ["span", "windows"])
def test_black_is_drawn_shown_and_waited_for_in_every_window(desk: Desk, layout: str) -> None:
    made = desk.open(layout)
    several = layout == "windows"
    desk.told()

    def each(*words: str) -> list[Any]:
        """What each window is told; where there are several, it is made current first."""
        found: list[Any] = []
        for number in (1, 2)[: 1 + several]:
            found += [("make_context_current", f"w{number}")] * several
            found += [
                ("swap_buffers", f"w{number}") if word == "swap" else f"c{number} {word}"
                for word in words
            ]
        return found

    for call, done in (
        (made.draw_black, each("clear")),
        (made.finish, each("finish")),
        (made.swap, each("swap")),
        (made.check, each("error?")),
        (made.settle, [*each("finish"), "sync"]),
        (
            made.black,
            [*each("clear"), *each("finish"), *each("swap"), *each("finish"), "sync"],
        ),
    ):
        call()
        assert desk.told() == done
