"""Windows of both panels on one X screen: drawn, swapped, black.

`pdcd.presenter.viewport` draws each panel's part of a window.
"""

from __future__ import annotations

import ctypes
from itertools import chain
from typing import Any

import glfw
import moderngl
import numpy as np
from numpy.typing import NDArray

from pdcd.errors import DeviceLost
from pdcd.panels.frames import Frames
from pdcd.panels.map import PanelView
from pdcd.panels.patterns import BIT_PLANES
from pdcd.presenter.messages import Rect
from pdcd.presenter.viewport import UNITS, Viewport

_GL_DITHER = 0x0BD0


class PanelWindows:
    """Both panels in one window over the whole X screen ("span"), or each in its own ("windows").

    Only a window that covers the whole screen is shown by page flips. With two windows, only the
    mask's swap waits for the vblank: if both waited, the rate would be halved.
    """

    def __init__(
        self,
        layout: str,
        screen_px: tuple[int, int],
        places: tuple[Rect, Rect],
        views: tuple[PanelView, PanelView],
        plane_order: str | None,
    ) -> None:
        self.planes = BIT_PLANES if plane_order else 1
        self._handles: list[Any] = []
        self._contexts: list[moderngl.Context] = []
        self._panels_of: list[list[Viewport]] = []
        """The viewports of each context."""
        if layout == "span":
            self._open(Rect(0, 0, *screen_px), 1)
            for n, (place, view) in enumerate(zip(places, views, strict=True)):
                # GL counts rows from the bottom.
                corner = place.x, screen_px[1] - place.y - place.height
                viewport = Viewport(self._contexts[0], view, corner, n * UNITS, plane_order)
                self._panels_of[0].append(viewport)
        else:
            for n, (place, view) in enumerate(zip(places, views, strict=True)):
                self._open(place, n)
                self._panels_of[n].append(Viewport(self._contexts[n], view, (0, 0), 0, plane_order))
        self._several = len(self._handles) > 1
        self._sync = _x_sync(_x_display())

    @property
    def timed_window(self) -> int:
        """X window whose vblank sets the pace: the only one, or the mask's."""
        return int(glfw.get_x11_window(self._handles[-1]))

    @property
    def renderer(self) -> str:
        """Name of the renderer."""
        return str(self._contexts[0].info["GL_RENDERER"])

    def load(self, frames: Frames) -> None:
        """Take over the patterns of both panels, and wait until the card is ready to draw them."""
        for number, panels in enumerate(self._panels_of):
            self._use(number)
            for panel in panels:
                panel.load(frames)
                panel.warm_up()
        self.draw_black()  # so that no swap can show the white refresh
        self.finish()
        self.check()

    def prepare(self, primal: NDArray[np.int32], dual: NDArray[np.int32]) -> None:
        """Make refreshes ready: (refreshes, planes) rows of the frames each, -1 for black."""
        for panel, rows in zip(chain(*self._panels_of), (primal, dual), strict=True):
            panel.prepare(rows)

    def draw(self, number: int) -> None:
        """Draw one of these refreshes on both panels; nothing is shown yet."""
        for context_number, context in enumerate(self._contexts):
            self._use(context_number)
            panels = self._panels_of[context_number]
            # Both first stages, then both second ones: the target changes only once.
            for panel in panels:
                panel.draw_pieces(number)
            context.screen.use()
            context.screen.clear()
            for panel in panels:
                panel.draw(number)

    def draw_black(self) -> None:
        """Draw black on both panels."""
        for number, context in enumerate(self._contexts):
            self._use(number)
            context.screen.clear()

    def finish(self) -> None:
        """Wait until the graphics card has finished drawing."""
        for number, context in enumerate(self._contexts):
            if self._several:
                glfw.make_context_current(self._handles[number])
            context.finish()

    def swap(self) -> None:
        """Swap the buffers: show what was drawn."""
        for handle in self._handles:
            if self._several:
                glfw.make_context_current(handle)
            glfw.swap_buffers(handle)

    def black(self) -> None:
        """Both panels black on return, as far as the X server can tell."""
        self.draw_black()
        self.finish()
        self.swap()
        self.settle()

    def settle(self) -> None:
        """Wait until the server has taken the swapped buffers."""
        self.finish()
        self._sync()

    def check(self) -> None:
        """Raise DeviceLost after a GL error, such as a lost context."""
        for number, context in enumerate(self._contexts):
            self._use(number)
            error = context.error
            if error != "GL_NO_ERROR":
                raise DeviceLost(
                    f"the graphics card reports {error}",
                    device="display",
                    hint="see the kernel's log; the next job opens the windows again",
                )

    def close(self) -> None:
        """Close the windows: the screen's black shows."""
        for handle in self._handles:
            glfw.destroy_window(handle)
        self._handles = []

    def _use(self, number: int) -> None:
        if self._several:
            glfw.make_context_current(self._handles[number])

    def _open(self, place: Rect, interval: int) -> None:
        hints = {
            glfw.DECORATED: False,
            glfw.RESIZABLE: False,
            glfw.AUTO_ICONIFY: False,
            glfw.FOCUSED: False,
            glfw.FOCUS_ON_SHOW: False,
            glfw.VISIBLE: False,
            glfw.CONTEXT_VERSION_MAJOR: 3,
            glfw.CONTEXT_VERSION_MINOR: 3,
            glfw.OPENGL_PROFILE: glfw.OPENGL_CORE_PROFILE,
            glfw.DEPTH_BITS: 0,
            glfw.STENCIL_BITS: 0,
            glfw.SAMPLES: 0,
            glfw.SRGB_CAPABLE: False,
            glfw.DOUBLEBUFFER: True,
            glfw.POSITION_X: place.x,
            glfw.POSITION_Y: place.y,
        }
        for hint, value in hints.items():
            glfw.window_hint(hint, value)
        handle = glfw.create_window(place.width, place.height, "pdcd", None, None)
        self._handles.append(handle)
        glfw.set_input_mode(handle, glfw.CURSOR, glfw.CURSOR_HIDDEN)
        glfw.make_context_current(handle)
        glfw.swap_interval(interval)
        context = moderngl.create_context(require=330)
        context.disable_direct(_GL_DITHER)
        self._contexts.append(context)
        self._panels_of.append([])
        # Two black frames, so that neither buffer holds anything else when the window appears.
        for _ in range(2):
            context.screen.clear()
            glfw.swap_buffers(handle)
        glfw.show_window(handle)
        context.screen.clear()
        glfw.swap_buffers(handle)
        glfw.poll_events()
        found = (*glfw.get_window_pos(handle), *glfw.get_framebuffer_size(handle))
        if found != (place.x, place.y, place.width, place.height):
            raise DeviceLost(
                f"a window of {place} came out as {found}",
                device="display",
                hint="no window manager may run on the panels' X server",
            )


def _x_display() -> int:
    """The library's own connection to the X server, a Display pointer."""
    get: Any = glfw.get_x11_display
    return int(get())


def _x_sync(display: int) -> Any:
    """A function that returns when the X server has done everything asked on this connection."""
    library = ctypes.CDLL("libX11.so.6")
    library.XSync.argtypes = [ctypes.c_void_p, ctypes.c_int]
    return lambda: library.XSync(display, 0)
