"""Windows of both panels, and GL that draws one code cell as one rectangle.

All patterns of a shot lie in one integer texture, bits or bytes as they come. A refresh is one
uniform and one instanced draw for each panel: the vertex shader looks a cell's value up and places
its rectangle on whole pixels; a dark cell draws nothing. No arithmetic is left to the pixels, and
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
from pdcd.frames.bitplanes import PLANES
from pdcd.frames.cells import check_fit, panel_edges
from pdcd.frames.frames import WHITE, Frames
from pdcd.frames.patterns import grey_bytes
from pdcd.presenter.messages import Rect

VERTEX_SHADER = """
uniform usampler2D patterns;  // four bytes a texel, first byte lowest
uniform isampler2D edges;     // first and past-the-last pixel of each cell: see cells.panel_edges
uniform ivec2 size_px;
uniform int cols;
uniform bool grey;
uniform ivec4 frame[PACKED ? 7 : 1];  // first bytes of patterns, -1 for none; last: the sub-shift
uniform ivec3 colours;        // bits by which the planes of red, green and blue lie in a picture
flat out vec3 colour;

int byte_at(int at) {
    int wide = textureSize(patterns, 0).x;
    uint texel = texelFetch(patterns, ivec2((at >> 2) % wide, (at >> 2) / wide), 0).r;
    return int((texel >> (8 * (at & 3))) & 255u);
}

int bit_of(int first, int cell) {
    return first < 0 ? 0 : (byte_at(first + (cell >> 3)) >> (7 - (cell & 7))) & 1;
}

void main() {
    int cell = gl_InstanceID, shift;
    if (PACKED) {
        int picture = 0;
        for (int j = 0; j < 24; j++) picture |= bit_of(frame[j >> 2][j & 3], cell) << j;
        colour = vec3((ivec3(picture) >> colours) & 255) / 255.0;
        shift = frame[PACKED ? 6 : 0].x;
    } else {
        int first = frame[0].x;
        colour = vec3(grey ? float(byte_at(first + cell)) / 255.0 : float(bit_of(first, cell)));
        shift = frame[0].y;
    }
    ivec2 x = texelFetch(edges, ivec2(cell % cols, shift & 1), 0).rg;
    ivec2 y = texelFetch(edges, ivec2(cell / cols, 2 + (shift >> 1)), 0).rg;
    ivec2 corner = ivec2((gl_VertexID & 1) == 0 ? x.r : x.g, (gl_VertexID & 2) == 0 ? y.r : y.g);
    vec2 place = 2.0 * vec2(corner) / vec2(size_px) - 1.0;
    bool dark = colour == vec3(0.0);
    gl_Position = dark ? vec4(2.0, 2.0, 2.0, 1.0) : vec4(place.x, -place.y, 0.0, 1.0);
}
"""

FRAGMENT_SHADER = """
#version 330 core
flat in vec3 colour;
out vec3 shown;
void main() { shown = colour; }
"""

Command = tuple[tuple[float, float, float] | None, tuple[bytes, ...]]
"""What a panel shows in one refresh: the colour it is cleared to, if not black, and the uniform of
each draw over it."""

GL_DITHER = 0x0BD0
TEXTURE_WIDTH = 4096
"""Texels in a row of the pattern texture."""


class Viewport:
    """One panel's part of a window, and its patterns on the graphics card.

    plane_order : colours of the bit planes, where a refresh shows the 24 rows of a picture, each
        as one bit; None where it shows one row.
    """

    def __init__(
        self, context: moderngl.Context, place: Rect, window_height: int, plane_order: str | None
    ) -> None:
        self._context = context
        self._size_px = (place.width, place.height)
        # GL counts rows from the bottom.
        below = window_height - place.y - place.height
        self._viewport = (place.x, below, place.width, place.height)
        self._order = plane_order
        packed = "true" if plane_order else "false"
        self._program = context.program(
            f"#version 330 core\nconst bool PACKED = {packed};\n{VERTEX_SHADER}", FRAGMENT_SHADER
        )
        self._program["size_px"] = self._size_px
        self._program["patterns"], self._program["edges"] = 0, 1
        if plane_order:
            self._program["colours"] = tuple(8 * plane_order.index(c) for c in "RGB")
        self._vertices = context.vertex_array(self._program, [])
        self._uniform: Any = self._program["frame"]
        self._textures: list[moderngl.Texture] = []
        self._first_byte = self._shift = np.zeros(1, dtype=np.int32)
        self._white = np.zeros(1, dtype=np.bool_)
        self._commands: list[Command] = []
        self._cells = 0

    def load(self, frames: Frames, *, mask: bool) -> None:
        """Take over one panel's patterns and rows. Raises ConfigError when they do not fit."""
        name = "mask" if mask else "projector"
        check_fit(frames, self._size_px, mask=mask)
        patterns = frames.dual_patterns if mask else frames.primal_patterns
        index = frames.dual_index if mask else frames.primal_index
        grey = patterns.dtype != np.uint8
        levels = grey_bytes(patterns) if grey else patterns
        self._upload(levels, panel_edges(frames, self._size_px, mask=mask), name)
        self._program["cols"] = frames.lattice[1]
        if not self._order:
            self._program["grey"] = grey
        self._cells = frames.lattice[0] * frames.lattice[1]
        # One more, black, so that row -1 is black.
        self._first_byte = np.append(np.where(index >= 0, index * patterns.shape[1], -1), -1)
        self._first_byte = self._first_byte.astype(np.int32)
        self._shift = np.append(frames.shift, 0).astype(np.int32)
        self._white = np.append(index == WHITE, False)

    def prepare(self, rows: NDArray[np.int32]) -> None:
        """Make the commands of some refreshes, (refreshes, planes) rows of the frames."""
        if self._order:
            self._commands = [self._packed(planes) for planes in rows]
            return
        plain: dict[int, Command] = {}
        for row in set(rows[:, 0].tolist()):
            place = [self._first_byte[row], self._shift[row], 0, 0]
            draws = (np.array(place, dtype=np.int32).tobytes(),) if place[0] >= 0 else ()
            plain[row] = ((1.0, 1.0, 1.0) if self._white[row] else None, draws)
        self._commands = [plain[row] for row in rows[:, 0].tolist()]

    def _packed(self, rows: NDArray[np.int32]) -> Command:
        """The command of one picture: a draw for each sub-shift, since that moves all cells."""
        first, shift, white = self._first_byte[rows], self._shift[rows], self._white[rows]
        lit = int(np.sum(white * (1 << np.arange(PLANES))))
        order = self._order or ""
        red, green, blue = ((lit >> 8 * order.index(c) & 255) / 255.0 for c in "RGB")
        draws = []
        for which in np.unique(shift[first >= 0]):
            block = np.full(28, which, dtype=np.int32)
            block[:PLANES] = np.where(shift == which, first, -1)
            draws.append(block.tobytes())
        return (red, green, blue) if lit else None, tuple(draws)

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

    def draw(self, number: int) -> None:
        """Draw one of the refreshes made ready over a black window."""
        clear, draws = self._commands[number]
        if clear is not None:
            self._context.screen.clear(*clear, viewport=self._viewport)
        if draws:
            self._context.viewport = self._viewport
            for unit, texture in enumerate(self._textures):
                texture.use(unit)
        for uniform in draws:
            self._uniform.write(uniform)
            self._vertices.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self._cells)


class Windows:
    """Both panels in one window over the whole X screen ("span"), or each in its own ("windows").

    Only a window that covers the whole screen is shown by page flips. With two windows the mask's
    swap waits for the vblank and the projector's does not, or they would halve the rate.
    """

    def __init__(
        self,
        layout: str,
        screen_px: tuple[int, int],
        places: tuple[Rect, Rect],
        plane_order: str | None,
    ) -> None:
        self.planes = PLANES if plane_order else 1
        self._handles: list[Any] = []
        self._contexts: list[moderngl.Context] = []
        self.panels: list[Viewport] = []
        if layout == "span":
            whole = Rect(0, 0, *screen_px)
            self._open(whole, 1)
            for place in places:
                self.panels.append(Viewport(self._contexts[0], place, whole.height, plane_order))
        else:
            for place, interval in zip(places, (0, 1), strict=True):
                self._open(place, interval)
                own = Rect(0, 0, place.width, place.height)
                self.panels.append(Viewport(self._contexts[-1], own, place.height, plane_order))
        self._several = len(self._handles) > 1
        self._sync = _x_sync(_x_display())

    @property
    def timed_window(self) -> int:
        """X window whose vblank sets the pace: the only one, or the mask's."""
        return int(glfw.get_x11_window(self._handles[-1]))

    @property
    def glx_handles(self) -> tuple[int, int]:
        """Display and GLX drawable of that window."""
        return _x_display(), int(glfw.get_glx_window(self._handles[-1]))

    @property
    def renderer(self) -> str:
        """Name of what draws."""
        return str(self._contexts[0].info["GL_RENDERER"])

    def load(self, frames: Frames) -> None:
        """Take over the patterns of both panels, and wait until the card has them."""
        for number, panel in enumerate(self.panels):
            self._use(number)
            panel.load(frames, mask=number == 1)
        self.finish()
        self.check()

    def prepare(self, primal: NDArray[np.int32], dual: NDArray[np.int32]) -> None:
        """Make refreshes ready: (refreshes, planes) rows of the frames each, -1 for black."""
        for panel, rows in zip(self.panels, (primal, dual), strict=True):
            panel.prepare(rows)

    def draw(self, number: int) -> None:
        """Draw one of these refreshes on both panels; nothing is shown yet."""
        if not self._several:
            self._contexts[0].screen.clear()
        for panel_number, panel in enumerate(self.panels):
            if self._several:
                self._use(panel_number)
                self._contexts[panel_number].screen.clear()
            panel.draw(number)

    def draw_black(self) -> None:
        """Draw black on both panels."""
        for number, context in enumerate(self._contexts):
            self._use(number)
            context.screen.clear()

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
        self.draw_black()
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
        # Draws of one picture's bit planes add up; single ones are over black.
        context.enable(moderngl.BLEND)
        context.blend_func = moderngl.ONE, moderngl.ONE
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


def _x_display() -> int:
    """The library's own connection to the X server, a Display pointer."""
    get: Any = glfw.get_x11_display
    return int(get())


def _x_sync(display: int) -> Any:
    """A call that returns when the X server has done all it was asked on this connection."""
    library = ctypes.CDLL("libX11.so.6")
    library.XSync.argtypes = [ctypes.c_void_p, ctypes.c_int]
    return lambda: library.XSync(display, 0)
