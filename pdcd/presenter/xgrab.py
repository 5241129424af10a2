"""Pixels of the root window: what the X server holds for both panels, whoever drew it.

These are the pixels that the server would scan out, before gamma tables, the link and the panel.
With option `grab_px` the display process reads them after every refresh, for tests of the whole
chain: a wrong pixel, exchanged panels, a mirrored or shifted window then show in the photo of a
virtual camera. That takes about 2 ms at a quarter of full size; at full size it takes longer than a
refresh, so that every refresh counts as missed.

Source: X11 protocol, GetImage; xcb/xproto.h for the layout of its reply.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError, DeviceLost
from pdcd.panels.pixels import PanelBox, PanelImage, crop_panel
from pdcd.presenter.xconnection import (
    close_x_connection,
    guard_x_calls,
    make_server_lost,
    open_x_connection,
)

Pixels = NDArray[np.uint8]

PICTURES = ("projector_pictures", "mask_pictures")
"""Names of the shared arrays, (refreshes, height, width) uint16: sums of the colour channels."""

MOST_GRAB_BYTES = 2**31
"""Most bytes of pictures; a longer run is refused."""

_ZPIXMAP = 2
_ALL_PLANES = 0xFFFFFFFF
_REPLY_HEADER = 32
_SUPPORTED = (24, 0xFF0000, 0x00FF00, 0x0000FF)
"""Depth and masks of red, green and blue: 32 bits a pixel in the order blue, green, red, unused."""


class RootGrabber:
    """Reads the root window, (H, W, 3) uint8 RGB, top row first.

    Blocks until the server answers: 0.9 ms for 656 x 300 pixels, 19 ms for 2624 x 1200 (median of
    20, two cores, software rendering). Belongs to one thread.

    Raises ConfigError when the screen is not 24-bit true colour, DeviceLost when the server is
    gone.
    """

    def __init__(self, display_name: str | None = None) -> None:
        look = open_x_connection(display_name)
        try:
            with guard_x_calls(look):
                screen, format_ = look.screen(), _pixel_format(look)
                self._root = int(screen.root.id)
                self._size_px = (int(screen.width_in_pixels), int(screen.height_in_pixels))
                self._name = str(look.get_display_name())
        finally:
            close_x_connection(look)
        if format_ != _SUPPORTED:
            raise ConfigError(
                f"the X screen has pixels of another form: depth and masks are {format_}",
                device="display",
                hint="DefaultDepth 24 in xorg.conf",
            )
        self._xcb = _library()
        self._connection = self._xcb.xcb_connect(self._name.encode(), None)
        if self._xcb.xcb_connection_has_error(self._connection):
            self.close()
            raise make_server_lost(self._name, "connection refused")

    def grab(self) -> Pixels:
        """Pixels of the whole screen in its first size. Raises ConfigError when it is smaller."""
        width, height = self._size_px
        if self._connection is None:
            raise DeviceLost("the grabber is closed", device="display", hint="open a new one")
        cookie = self._xcb.xcb_get_image(
            self._connection, _ZPIXMAP, self._root, 0, 0, width, height, _ALL_PLANES
        )
        error = ctypes.c_void_p()
        reply = self._xcb.xcb_get_image_reply(self._connection, cookie, ctypes.byref(error))
        try:
            if reply is None:
                if error.value is None:
                    raise make_server_lost(self._name, "it ended while being asked for pixels")
                raise ConfigError(
                    f"{width} x {height} pixels at +0+0 are not within the X screen",
                    device="display",
                    hint="has an output changed?",
                )
            size = width * height * 4
            held = (ctypes.c_uint8 * size).from_address(reply + _REPLY_HEADER)
            bgrx = np.ctypeslib.as_array(held).reshape(height, width, 4)
            return bgrx[..., 2::-1].copy()
        finally:
            for pointer in (reply, error.value):
                if pointer is not None:
                    self._xcb.free(pointer)

    def close(self) -> None:
        """Release the connection. Idempotent."""
        connection, self._connection = self._connection, None
        if connection is not None:
            self._xcb.xcb_disconnect(connection)


def _pixel_format(display: Any) -> tuple[int, int, int, int] | None:
    """Depth and colour masks of the root window; None when pixels are not 32 bits wide."""
    screen, info = display.screen(), display.display.info
    wide = any(f.depth == screen.root_depth and f.bits_per_pixel == 32 for f in info.pixmap_formats)
    if not wide or info.image_byte_order != 0:
        return None
    for depth in screen.allowed_depths:
        for visual in depth.visuals:
            if visual.visual_id == screen.root_visual:
                return depth.depth, visual.red_mask, visual.green_mask, visual.blue_mask
    return None


class _Library:
    """The libxcb functions that are used, and `free`, with their signatures."""

    def __init__(self) -> None:
        xcb, pointer, u32 = ctypes.CDLL("libxcb.so.1"), ctypes.c_void_p, ctypes.c_uint32
        i16, u16 = ctypes.c_int16, ctypes.c_uint16
        self.xcb_connect = xcb.xcb_connect
        self.xcb_connect.restype, self.xcb_connect.argtypes = pointer, [ctypes.c_char_p, pointer]
        self.xcb_connection_has_error = xcb.xcb_connection_has_error
        self.xcb_connection_has_error.argtypes = [pointer]
        self.xcb_disconnect = xcb.xcb_disconnect
        self.xcb_disconnect.restype, self.xcb_disconnect.argtypes = None, [pointer]
        self.xcb_get_image = xcb.xcb_get_image
        self.xcb_get_image.restype = u32
        self.xcb_get_image.argtypes = [pointer, ctypes.c_uint8, u32, i16, i16, u16, u16, u32]
        self.xcb_get_image_reply = xcb.xcb_get_image_reply
        self.xcb_get_image_reply.restype = pointer
        self.xcb_get_image_reply.argtypes = [pointer, u32, pointer]
        self.free = ctypes.CDLL(None).free
        self.free.restype, self.free.argtypes = None, [pointer]


@functools.cache
def _library() -> _Library:
    try:
        return _Library()
    except OSError as err:
        raise DeviceLost(
            f"the X library is missing: {err}", device="display", hint="apt-get install libxcb1"
        ) from err


# Pictures of both panels, refresh by refresh.


def reserve_pictures(
    count: int, sizes_px: tuple[tuple[int, int], tuple[int, int]]
) -> dict[str, PanelImage]:
    """Empty arrays for the pictures of `count` refreshes of panels (width, height).

    Raises ConfigError when they would be too large.
    """
    size = sum(2 * count * width * height for width, height in sizes_px)
    if size > MOST_GRAB_BYTES:
        raise ConfigError(
            f"pictures of {count} refreshes would take {size / 2**30:.1f} GiB",
            device="display",
            hint="grab_px is for short tests: fewer codes, smaller panels, or leave it out",
        )
    return {
        name: np.zeros((count, height, width), dtype=np.uint16)
        for name, (width, height) in zip(PICTURES, sizes_px, strict=True)
    }


class Grabs:
    """Pictures of both panels, taken by the display process after each refresh.

    `boxes` are where the virtual bench has its panels, wherever the windows are: if a panel is
    shown elsewhere, the pictures show that. `settle` returns once the server has taken the swapped
    buffers.
    """

    def __init__(
        self, name: str, boxes: tuple[PanelBox, PanelBox], settle: Callable[[], None]
    ) -> None:
        self._grabber = RootGrabber(name)
        self._boxes = boxes
        self._settle = settle
        self._into: list[NDArray[Any]] = []

    def begin(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take over the arrays of the coming pass."""
        self._into = [arrays[name] for name in PICTURES if name in arrays]

    def take(self, number: int) -> None:
        """Read the screen, as the picture of refresh `number`."""
        if not self._into:
            return
        self._settle()
        screen = self._grabber.grab()
        for out, box in zip(self._into, self._boxes, strict=True):
            out[number] = crop_panel(screen, box)
