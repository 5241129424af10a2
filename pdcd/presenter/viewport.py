"""One panel's part of a window, drawn in two stages, each an exact copy by whole numbers.

The largest parts of the field that are always lit as one are its *pieces*: cells, halves of cells,
or windows. All patterns of a shot lie in one integer texture, as bits or bytes. A refresh first
draws what each piece shows into a small picture, one pixel a piece. Then every pixel of the panel
is copied from that picture; a table, made once for each geometry (`pdcd.panels.atoms`), says from
where. So a pixel costs two look-ups, upright or under a map that bends, and neither depends on how
a card rounds.

Panels show 8 bits: grey levels are rounded to 255ths. The panel's response to a level is not
corrected here.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.panels.atoms import find_atoms
from pdcd.panels.draw import check_fit
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.map import PanelView
from pdcd.panels.patterns import BIT_PLANES, to_grey_bytes
from pdcd.panels.windows import ATOMS, find_window_kind, number_strips

_COVER = """#version 330 core
void main() {  // one triangle over the whole viewport
    gl_Position = vec4(4 * (gl_VertexID & 1) - 1, 4 * (gl_VertexID >> 1) - 1, 0.0, 1.0);
}
"""

_PIECES = """
// What each piece shows. Pixel (x, y) is piece (x - 1, y - 1); the first ones are beside the field.
const int CELLS = 0, HALVES = 1, WINDOWS = 2, STRIPS = 4, NONE = -1, WHITE = -2;
uniform usampler2D patterns;  // four bytes a texel, first byte lowest
uniform int kind;             // of the pieces: cells, pixels, halves (projector), windows (mask)
uniform int cols;
uniform bool grey;
uniform ivec4 frame[2 * GROUPS];  // first bytes of patterns, NONE or WHITE; then sub-shifts
uniform ivec3 colours;        // bits by which the planes of red, green and blue lie in a picture
out vec4 shown;

int byte_at(int at) {
    int wide = textureSize(patterns, 0).x;
    uint texel = texelFetch(patterns, ivec2((at >> 2) % wide, (at >> 2) / wide), 0).r;
    return int((texel >> (8 * (at & 3))) & 255u);
}

int level(int first, int shift, ivec2 piece) {
    if (first == NONE || piece.x < 0 || piece.y < 0) return 0;
    if (first == WHITE) return 255;
    ivec2 moved = ivec2(shift & 1, shift >> 1), place = piece;
    if (kind == HALVES) place = (piece + moved) >> 1;
    if (kind == WINDOWS) {
        if ((piece.x & 1) == moved.x || (piece.y & 1) == moved.y) return 0;
        place = piece >> 1;
    }
    if (kind == STRIPS) {  // along an axis: open when moved, always, in place, always
        ivec2 strip = piece & 3;
        place = piece >> 2;
        if (moved.x == 0 ? strip.x == 0 : strip.x == 2) return 0;
        if (moved.y == 0 ? strip.y == 0 : strip.y == 2) return 0;
        place += moved * ivec2(strip.x == 3, strip.y == 3);
    }
    int cell = place.y * cols + place.x;
    if (grey) return byte_at(first + cell);
    return 255 * ((byte_at(first + (cell >> 3)) >> (7 - (cell & 7))) & 1);
}

void main() {
    ivec2 piece = ivec2(gl_FragCoord.xy) - 1;
    if (GROUPS == 1) {
        shown = vec4(float(level(frame[0].x, frame[1].x, piece)) / 255.0);
    } else {
        int picture = 0;
        for (int j = 0; j < 4 * GROUPS; j++) {
            int first = frame[j >> 2][j & 3], shift = frame[GROUPS + (j >> 2)][j & 3];
            picture |= (level(first, shift, piece) & 1) << j;
        }
        shown = vec4((ivec3(picture) >> colours) & 255, 0) / 255.0;
    }
}
"""

_PANEL = """
uniform usampler2D table;  // which pixel of the pieces each pixel of the panel shows
uniform sampler2D pieces;
out vec4 shown;
void main() {
    ivec2 at = ivec2(texelFetch(table, ivec2(gl_FragCoord.xy) - CORNER, 0).rg);
    shown = texelFetch(pieces, at, 0);
}
"""

CELLS, HALVES, WINDOWS, PIXELS, STRIPS = range(5)
UNITS = 3
"""Texture units of a panel."""
TEXTURE_WIDTH = 4096
"""Texels in a row of the pattern texture."""


class Viewport:
    """One panel's part of a window, and its patterns on the graphics card.

    unit : the first of the panel's own three texture units of the context.
    plane_order : colours of the bit planes, where a refresh shows the 24 rows of a picture, each
        as one bit; None where a refresh shows one row.
    """

    def __init__(
        self,
        context: moderngl.Context,
        panel: PanelView,
        corner: tuple[int, int],
        unit: int,
        plane_order: str | None,
    ) -> None:
        self._context = context
        self._panel = panel
        self._viewport = (*corner, *panel.size_px)
        self._units = {name: unit + n for n, name in enumerate(("patterns", "table", "pieces"))}
        self._textures: dict[str, moderngl.Texture] = {}
        self._room = BIT_PLANES if plane_order else 4  # shaders take whole numbers in fours
        # Constants cost nothing, while uniforms are read for every pixel.
        version = "#version 330 core\n#define"
        groups, where = f"GROUPS {self._room // 4}", f"CORNER ivec2({corner[0]}, {corner[1]})"
        self._first = context.program(_COVER, f"{version} {groups}\n{_PIECES}")
        self._second = context.program(_COVER, f"{version} {where}\n{_PANEL}")
        self._first["patterns"] = self._units["patterns"]
        self._second["table"], self._second["pieces"] = unit + 1, unit + 2
        if plane_order:
            self._first["colours"] = tuple(8 * plane_order.index(c) for c in "RGB")
        self._draw_pieces = context.vertex_array(self._first, [])
        self._draw_panel = context.vertex_array(self._second, [])
        self._uniform: Any = self._first["frame"]
        self._canvas: moderngl.Framebuffer | None = None
        self._geometry: tuple[tuple[int, int], int, str] | None = None
        self._first_byte = np.full(1, BLACK, dtype=np.int32)
        self._shift = np.zeros(1, dtype=np.int32)
        self._commands: list[bytes | None] = []
        self._drawn: bytes | None = None
        """What the pieces show now."""

    def load(self, frames: Frames) -> None:
        """Take over the panel's patterns and rows. Raises ConfigError when they do not fit."""
        mask = self._panel.mask
        self._drawn = None
        check_fit(frames, self._panel)
        patterns = frames.dual_patterns if mask else frames.primal_patterns
        index = frames.dual_index if mask else frames.primal_index
        grey = patterns.dtype != np.uint8
        self._upload(to_grey_bytes(patterns) if grey else patterns)
        width, height = self._panel.size_px
        grid, cols, kind = frames.grid, frames.lattice[1], CELLS
        if frames.of_pixels:  # every pixel is a cell, wherever the panel lies
            grid, cols, kind = (height, width), width, PIXELS
        elif find_window_kind(frames.window).shifted:
            kind = HALVES
            if mask:
                kind = WINDOWS if frames.window == "quarter" else STRIPS
        if self._geometry != (grid, kind, frames.window):
            self._place(grid, kind, frames.window)
        self._first["kind"], self._first["cols"] = kind, cols
        self._first["grey"] = grey
        # One more row, black, so that row -1 is black.
        first = np.where(index >= 0, index * patterns.shape[1], index)
        self._first_byte = np.append(first, BLACK).astype(np.int32)
        self._shift = np.append(frames.shift, 0).astype(np.int32)

    def prepare(self, rows: NDArray[np.int32]) -> None:
        """Make the commands of some refreshes, (refreshes, planes) rows of the frames."""
        kinds, which = np.unique(rows, axis=0, return_inverse=True)
        commands = self._blocks(self._first_byte[kinds], self._shift[kinds])
        self._commands = [commands[n] for n in which.ravel().tolist()]

    def warm_up(self) -> None:
        """Draw a white refresh, so that the first one of a pass does not wait for a compiler."""
        white = np.full((1, 1), WHITE, dtype=np.int32)
        self._commands = self._blocks(white, np.zeros_like(white))
        self.draw_pieces(0)
        self._context.screen.use()
        self.draw(0)
        self._commands = []

    def draw_pieces(self, number: int) -> None:
        """Draw the first stage of one of the prepared refreshes."""
        command, canvas = self._commands[number], self._canvas
        # A code lasts several refreshes: its pieces stay as they are.
        if command is not None and command != self._drawn and canvas is not None:
            canvas.use()
            self._uniform.write(command)
            self._draw_pieces.render(moderngl.TRIANGLES, vertices=3)
            self._drawn = command

    def draw(self, number: int) -> None:
        """Draw the second stage of the same refresh into the current window, which is black."""
        if self._commands[number] is not None:
            self._context.viewport = self._viewport
            self._draw_panel.render(moderngl.TRIANGLES, vertices=3)

    def _blocks(self, first: NDArray[np.int32], shift: NDArray[np.int32]) -> list[bytes | None]:
        """Uniforms of refreshes, from the first bytes and sub-shifts (refreshes, planes) of their
        patterns; None for a black refresh."""
        count, planes = first.shape
        blocks = np.full((count, 2, self._room), BLACK, dtype=np.int32)
        blocks[:, 0, :planes], blocks[:, 1, :planes] = first, shift
        black = (first == BLACK).all(axis=1).tolist()
        return [None if b else block.tobytes() for b, block in zip(black, blocks, strict=True)]

    def _upload(self, levels: NDArray[Any]) -> None:
        """Put patterns into a texture, in place of the previous ones."""
        texels = max(1, -(-levels.size // 4))
        rows = -(-texels // TEXTURE_WIDTH)
        limit = self._largest
        if rows > limit:
            raise ConfigError(
                f"{levels.nbytes} bytes of patterns exceed the graphics card's textures "
                f"({TEXTURE_WIDTH * limit * 4} bytes)",
                device=self._panel.role,
                hint="use fewer codes in one photo (more parts), or a coarser grid",
            )
        stream = np.zeros(rows * TEXTURE_WIDTH * 4, dtype=np.uint8)
        stream[: levels.size] = levels.reshape(-1)
        self._texture("patterns", stream.view(np.uint32).reshape(rows, TEXTURE_WIDTH, 1))

    def _place(self, grid: tuple[int, int], kind: int, window: str) -> None:
        """Make the table of a geometry, and the small picture that pixels are copied from."""
        self._geometry = None
        rows, cols = (1 + count_pieces(cells, kind) for cells in grid)
        largest = max(rows, cols, *self._panel.size_px)
        if largest > self._largest:
            raise ConfigError(
                f"{largest} pixels or pieces along an axis exceed the graphics card's textures "
                f"({self._largest})",
                device=self._panel.role,
                hint="use a coarser grid",
            )
        self._texture("table", build_pixel_table(self._panel, grid, kind, window)[::-1])
        pieces = self._texture("pieces", np.zeros((rows, cols, 4), dtype=np.uint8), "f1")
        if self._canvas is not None:
            self._canvas.release()
        self._canvas = self._context.framebuffer([pieces])
        self._geometry = grid, kind, window

    def _texture(self, name: str, data: NDArray[Any], dtype: str = "") -> moderngl.Texture:
        """Put data (h, w, channels) on a texture unit of the panel, in place of the previous data:
        as whole numbers, unless `dtype` says otherwise."""
        if name in self._textures:
            self._textures.pop(name).release()
        height, width, channels = data.shape
        dtype = dtype or f"u{data.itemsize}"
        data = np.ascontiguousarray(data)
        made = self._context.texture((width, height), channels, data, dtype=dtype, alignment=1)
        made.filter = (moderngl.NEAREST, moderngl.NEAREST)
        made.use(self._units[name])
        self._textures[name] = made
        return made

    @property
    def _largest(self) -> int:
        """Most texels of a texture along an axis."""
        return int(self._context.info["GL_MAX_TEXTURE_SIZE"])


def count_pieces(cells: int, kind: int) -> int:
    """Number of pieces along an axis."""
    windows_ = {WINDOWS: 2 * cells + 1, STRIPS: 4 * cells + 1}
    return {CELLS: cells, HALVES: 2 * cells, PIXELS: cells, **windows_}[kind]


def build_pixel_table(
    panel: PanelView, grid: tuple[int, int], kind: int, window: str
) -> NDArray[Any]:
    """The pixel of the small picture that each pixel of a panel copies, (height, width, 2): across
    and down, 0 beside the field; uint8 where that is enough, else uint16."""
    if kind == PIXELS:
        number = np.stack(np.meshgrid(*(np.arange(1, n + 1) for n in panel.size_px)), axis=-1)
    elif kind == STRIPS:
        atom = find_atoms(panel, grid, ATOMS)
        number = np.where(atom < 0, 0, number_strips(window, atom) + 1)
    else:
        atom = find_atoms(panel, grid)
        piece = {CELLS: atom >> 2, HALVES: atom >> 1, WINDOWS: (atom + 1) >> 1}[kind]
        number = np.where(atom < 0, 0, piece + 1)
    largest = max(count_pieces(cells, kind) for cells in grid)
    return number.astype(np.uint8 if largest <= np.iinfo(np.uint8).max else np.uint16)
