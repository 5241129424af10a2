"""Pixels of a root window out of a library that stands in for libxcb; formats, failures."""

from __future__ import annotations

import ctypes
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from Xlib import error

from pdcd.errors import ConfigError, DeviceLost
from pdcd.presenter import xgrab
from pdcd.presenter.xgrab import Grabs, RootGrabber, reserve_pictures


class Server:
    """A screen of 6 x 4 pixels, seen by python-xlib and by libxcb, which has none to give."""

    def __init__(self) -> None:
        self.depth, self.wide, self.order = 24, 32, 0
        self.masks = (0xFF0000, 0xFF00, 0xFF)
        self.visual = 3
        self.broken = 0
        self.done: list[Any] = []
        self.fault: Exception | None = None

    # As python-xlib.

    def screen(self) -> Any:
        if self.fault is not None:
            raise self.fault
        red, green, blue = self.masks
        right = SimpleNamespace(visual_id=3, red_mask=red, green_mask=green, blue_mask=blue)
        other = SimpleNamespace(visual_id=2, red_mask=1, green_mask=2, blue_mask=4)
        return SimpleNamespace(
            root=SimpleNamespace(id=99), width_in_pixels=6, height_in_pixels=4,
            root_depth=self.depth, root_visual=self.visual,
            allowed_depths=[
                SimpleNamespace(depth=1, visuals=[other]),
                SimpleNamespace(depth=self.depth, visuals=[other, right]),
            ],
        )  # fmt: skip

    @property
    def display(self) -> Any:
        formats = [
            SimpleNamespace(depth=1, bits_per_pixel=32),
            SimpleNamespace(depth=self.depth, bits_per_pixel=self.wide),
        ]
        info = SimpleNamespace(pixmap_formats=formats, image_byte_order=self.order)
        return SimpleNamespace(info=info)

    def get_display_name(self) -> str:
        return ":7"

    # As libxcb.

    def xcb_connect(self, name: bytes, number: Any) -> int:
        self.done.append(("connect", name, number))
        return 0x1000

    def xcb_connection_has_error(self, connection: int) -> int:
        return self.broken

    def xcb_disconnect(self, connection: int) -> None:
        self.done.append(("disconnect", connection))

    def xcb_get_image(self, *words: int) -> int:
        self.done.append(words)
        return 77

    def xcb_get_image_reply(self, connection: int, cookie: int, told: Any) -> None:
        assert (connection, cookie) == (0x1000, 77)
        told._obj.value = 0x5000  # an error, to be let go

    def free(self, pointer: int) -> None:
        self.done.append(("free", pointer))


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Server:
    made = Server()
    monkeypatch.setattr(xgrab, "open_x_connection", lambda name: made)
    monkeypatch.setattr(xgrab, "close_x_connection", lambda look: made.done.append("left"))
    monkeypatch.setattr(xgrab, "_library", lambda: made)
    return made


@pytest.mark.parametrize(
    ("name", "value"),
    [("depth", 16), ("wide", 24), ("order", 1), ("masks", (0xFF, 0xFF00, 0xFF0000)), ("visual", 9)],
)
def test_a_screen_of_other_pixels_is_refused(server: Server, name: str, value: Any) -> None:
    setattr(server, name, value)
    with pytest.raises(ConfigError, match=r"another form: .* \(DefaultDepth 24 in xorg\.conf\)"):
        RootGrabber()
    assert server.done == ["left"]


def test_a_server_that_goes_at_the_first_look_or_refuses_the_second_is_lost(
    server: Server,
) -> None:
    server.broken = 1
    with pytest.raises(DeviceLost, match=":7 does not answer: connection refused"):
        RootGrabber()
    assert server.done == ["left", ("connect", b":7", None), ("disconnect", 0x1000)]
    server.fault = error.ConnectionClosedError("server")
    with pytest.raises(DeviceLost, match=":7 does not answer"):
        RootGrabber()
    assert server.done[3:] == ["left"]


def test_a_screen_that_became_smaller_is_a_fault(server: Server) -> None:
    with pytest.raises(
        ConfigError, match=r"6 x 4 pixels at \+0\+0 are not within .* \(has an output changed"
    ):
        RootGrabber().grab()
    assert server.done[-1] == ("free", 0x5000)


def test_a_library_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str | None) -> Any:
        raise OSError("libxcb.so.1: no such file")

    xgrab._library.cache_clear()
    monkeypatch.setattr(ctypes, "CDLL", missing)
    with pytest.raises(DeviceLost, match=r"library is missing: libxcb\.so\.1: no such file .*apt"):
        xgrab._library()


# Pictures of a pass.


def test_there_is_room_for_each_refresh_of_both_panels() -> None:
    found = reserve_pictures(5, ((6, 4), (3, 2)))
    assert {name: array.shape for name, array in found.items()} == {
        "projector_pictures": (5, 4, 6), "mask_pictures": (5, 2, 3),
    }  # fmt: skip
    assert all(array.dtype == np.uint16 and not array.any() for array in found.values())


def test_pictures_take_two_gibibytes_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xgrab, "MOST_GRAB_BYTES", 2 * 5 * (6 * 4 + 3 * 2))
    reserve_pictures(5, ((6, 4), (3, 2)))
    with pytest.raises(ConfigError, match=r"pictures of 6 refreshes would take 0\.0 GiB"):
        reserve_pictures(6, ((6, 4), (3, 2)))
    with pytest.raises(ConfigError, match=r"of 1024 refreshes would take 6\.0 GiB"):
        reserve_pictures(1024, ((2048, 1024), (1024, 1024)))


def test_a_refresh_is_looked_at_once_the_server_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    screen = np.arange(72, dtype=np.uint8).reshape(4, 6, 3)

    class Grabber:
        def __init__(self, name: str) -> None:
            done.append(name)

        def grab(self) -> Any:
            done.append("grab")
            return screen

    monkeypatch.setattr(xgrab, "RootGrabber", Grabber)
    made = Grabs(":7", ((0, 0, 2, 3), (3, 1, 3, 2)), lambda: done.append("settle"))
    made.take(0)
    assert done == [":7"]  # nobody asked for pictures of this pass
    arrays = {name: np.zeros((2, *size), np.uint16) for name, size in
              (("projector_pictures", (3, 2)), ("mask_pictures", (2, 3)))}  # fmt: skip
    made.begin(arrays)
    made.take(1)
    assert done == [":7", "settle", "grab"]
    levels = screen.sum(axis=2, dtype=np.uint16)
    np.testing.assert_array_equal(arrays["projector_pictures"][1], levels[:3, :2])
    np.testing.assert_array_equal(arrays["mask_pictures"][1], levels[1:3, 3:6])
    assert not arrays["projector_pictures"][0].any() and not arrays["mask_pictures"][0].any()
    made.begin({})
    made.take(0)
    assert done == [":7", "settle", "grab"]
