"""Windows of both panels, and GL that draws one code cell as one rectangle.

All patterns of a shot lie in one integer texture, bits or bytes as they come. A refresh is one
uniform and one instanced draw for each panel: the vertex shader looks a cell's value up and places
its rectangle on whole pixels; a dark cell draws nothing. So no arithmetic is left to the pixels, and
cells that do not divide the panel are as exact as those that do.

Panels show 8 bits: grey levels are rounded to 255ths. Their response to a level is the panel's
own affair: nothing is corrected here.
"""

from __future__ import annotations

import ctypes
from typing import Any

import glfw
import moderngl
import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError, DeviceLost
from pdcd.interfaces import WHITE, Frames
from pdcd.presenter.cells import panel_edges
from pdcd.presenter.messages import Rect

VERTEX_SHADER = """
#version 330 core
uniform usampler2D patterns;  // four bytes a texel, first byte lowest
uniform isampler2D edges;     // first and past-the-last pixel of each cell: see cells.panel_edges
uniform ivec2 size_px;
uniform int cols;
uniform bool grey;
uniform ivec2 frame;          // first byte of the pattern, sub-shift
flat out float level;

void main() {
    int cell = gl_InstanceID;
    int at = frame.x + (grey ? cell : cell >> 3);
    int wide = textureSize(patterns, 0).x;
    uint texel = texelFetch(patterns, ivec2((at >> 2) % wide, (at >> 2) / wide), 0).r;
    uint byte = (texel >> (8 * (at & 3))) & 255u;
    level = grey ? float(byte) / 255.0 : float((byte >> (7 - (cell & 7))) & 1u);
    ivec2 x = texelFetch(edges, ivec2(cell % cols, frame.y & 1), 0).rg;
    ivec2 y = texelFetch(edges, ivec2(cell / cols, 2 + (frame.y >> 1)), 0).rg;
    ivec2 corner = ivec2((gl_VertexID & 1) == 0 ? x.r : x.g, (gl_VertexID & 2) == 0 ? y.r : y.g);
    vec2 place = 2.0 * vec2(corner) / vec2(size_px) - 1.0;
    gl_Position = level > 0.0 ? vec4(place.x, -place.y, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
}
"""

FRAGMENT_SHADER = """
#version 330 core
flat in float level;
out vec3 colour;
void main() { colour = vec3(level); }
"""

GL_DITHER = 0x0BD0
TEXTURE_WIDTH = 4096
"""Texels in a row of the pattern texture."""
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "software")


class Panel:
    """One panel's part of a window, and its patterns on the graphics card."""

    def __init__(self, context: moderngl.Context, place: Rect, window_height: int) -> None:
        self._context = context
        self._size_px = (place.width, place.height)
        # GL counts rows from the bottom.
        below = window_height - place.y - place.height
        self._viewport = (place.x, below, place.width, place.height)
        self._program = context.program(VERTEX_SHADER, FRAGMENT_SHADER)
        self._program["size_px"] = self._size_px
        self._program["patterns"], self._program["edges"] = 0, 1
        self._vertices = context.vertex_array(self._program, [])
        self._frame = self._program["frame"]
        self._textures: list[moderngl.Texture] = []
        self._uniforms: list[bytes | None] = []
        self._whites: list[bool] = []
        self._cells = 0

    def load(self, frames: Frames, *, mask: bool) -> None:
        """Take over one panel's patterns and rows. Raises ConfigError when they do not fit."""
        name = "mask" if mask else "projector"
        width, height = self._size_px
        if frames.grid[0] > height or frames.grid[1] > width:
            raise ConfigError(
                f"{frames.grid[0]} x {frames.grid[1]} cells do not fit {height} x {width} px",
                device=name,
                hint="use a coarser grid",
            )
        patterns = frames.dual_patterns if mask else frames.primal_patterns
        index = frames.dual_index if mask else frames.primal_index
        grey = patterns.dtype != np.uint8
        levels = np.rint(patterns * 255.0).astype(np.uint8) if grey else patterns
        self._upload(levels, panel_edges(frames, self._size_px, mask=mask), name)
        self._program["cols"] = frames.lattice[1]
        self._program["grey"] = grey
        self._cells = frames.lattice[0] * frames.lattice[1]
        stride = patterns.shape[1]
        self._uniforms = [
            np.array([i * stride, s], dtype=np.int32).tobytes() if i >= 0 else None
            for i, s in zip(index.tolist(), frames.shift.tolist(), strict=True)
        ]
        self._whites = [i == WHITE for i in index.tolist()]

    def _upload(self, levels: NDArray[Any], edges: NDArray[np.int32], name: str) -> None:
        """Put patterns and cell edges into textures, in place of those before."""
        for old in self._textures:
            old.release()
        self._textures = []
        texels = max(1, -(-levels.size // 4))
        rows = -(-texels // TEXTURE_WIDTH)
        limit = int(self._context.info["GL_MAX_TEXTURE_SIZE"])
        if rows > limit or edges.shape[1] > limit:
            raise ConfigError(
                f"{levels.nbytes} bytes of patterns exceed the graphics card's textures "
                f"({TEXTURE_WIDTH * limit * 4} bytes)",
                device=name,
                hint="use fewer codes in one photo (--parts), or a coarser grid",
            )
        stream = np.zeros(rows * TEXTURE_WIDTH * 4, dtype=np.uint8)
        stream[: levels.size] = levels.reshape(-1)
        context = self._context
        for data, size, parts, kind in (
            (stream, (TEXTURE_WIDTH, rows), 1, "u4"),
            (edges, (edges.shape[1], edges.shape[0]), 2, "i4"),
        ):
            texture = context.texture(size, parts, np.ascontiguousarray(data), dtype=kind)
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._textures.append(texture)

    def draw(self, row: int) -> None:
        """Draw one row over a black window; -1 is black."""
        if row < 0:
            return
        uniform = self._uniforms[row]
        if uniform is not None:
            self._context.viewport = self._viewport
            for unit, texture in enumerate(self._textures):
                texture.use(unit)
            self._frame.write(uniform)
            self._vertices.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self._cells)
        elif self._whites[row]:
            self._context.screen.clear(1.0, 1.0, 1.0, viewport=self._viewport)


class Windows:
    """Both panels in one window over the whole X screen ("span"), or each in its own ("windows").

    Only a window that covers the whole screen is shown by page flips. With two windows the mask's
    swap waits for the vblank and the projector's does not, or they would halve the rate.
    """

    def __init__(self, layout: str, screen_px: tuple[int, int], places: tuple[Rect, Rect]) -> None:
        self._handles: list[Any] = []
        self._contexts: list[moderngl.Context] = []
        self.panels: list[Panel] = []
        if layout == "span":
            whole = Rect(0, 0, *screen_px)
            self._open(whole, 1)
            for place in places:
                self.panels.append(Panel(self._contexts[0], place, whole.height))
        else:
            for place, interval in zip(places, (0, 1), strict=True):
                self._open(place, interval)
                own = Rect(0, 0, place.width, place.height)
                self.panels.append(Panel(self._contexts[-1], own, place.height))
        self._several = len(self._handles) > 1
        self._sync = _x_sync(glfw.get_x11_display())

    @property
    def timed_window(self) -> int:
        """X window whose vblank sets the pace: the only one, or the mask's."""
        return int(glfw.get_x11_window(self._handles[-1]))

    @property
    def glx_handles(self) -> tuple[int, int]:
        """Display and GLX drawable of that window."""
        return int(glfw.get_x11_display()), int(glfw.get_glx_window(self._handles[-1]))

    @property
    def renderer(self) -> str:
        """Name of what draws."""
        return str(self._contexts[0].info["GL_RENDERER"])

    @property
    def software(self) -> bool:
        """Whether the processor does the drawing."""
        return any(name in self.renderer.lower() for name in SOFTWARE_RENDERERS)

    def load(self, frames: Frames) -> None:
        """Take over the patterns of both panels, and wait until the card has them."""
        for number, panel in enumerate(self.panels):
            self._use(number)
            panel.load(frames, mask=number == 1)
        self.finish()
        self.check()

    def draw(self, primal: int, dual: int) -> None:
        """Draw one row of each panel; nothing is shown yet."""
        if not self._several:
            self._contexts[0].screen.clear()
        for number, panel in enumerate(self.panels):
            if self._several:
                self._use(number)
                self._contexts[number].screen.clear()
            panel.draw(dual if number else primal)

    def finish(self) -> None:
        """Wait until everything drawn is drawn."""
        for number, context in enumerate(self._contexts):
            if self._several:
                glfw.make_context_current(self._handles[number])
            context.finish()

    def swap(self) -> None:
        """Show what was drawn."""
        for handle in self._handles:
            if self._several:
                glfw.make_context_current(handle)
            glfw.swap_buffers(handle)

    def black(self) -> None:
        """Both panels black on return, as far as the X server can tell."""
        self.draw(-1, -1)
        self.finish()
        self.swap()
        self.settle()

    def settle(self) -> None:
        """Wait until the server has taken what was swapped."""
        self.finish()
        self._sync()

    def check(self) -> None:
        """Raise DeviceLost after a GL error, a lost context among them."""
        for number, context in enumerate(self._contexts):
            self._use(number)
            error = context.error
            if error != "GL_NO_ERROR":
                raise DeviceLost(
                    f"the graphics card reports {error}",
                    device="display",
                    hint="see the kernel's log; the windows are opened anew by the next job",
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
        context.disable(moderngl.BLEND)
        context.disable_direct(GL_DITHER)
        self._contexts.append(context)
        # Two frames, so that neither buffer holds anything else when the window appears.
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


def _x_sync(display: int) -> Any:
    """A call that returns when the X server has done all it was asked on this connection."""
    library = ctypes.CDLL("libX11.so.6")
    library.XSync.argtypes = [ctypes.c_void_p, ctypes.c_int]
    return lambda: library.XSync(display, 0)
