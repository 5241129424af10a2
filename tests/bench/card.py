"""Does this machine's graphics card draw every pixel as planned, and how fast? No screen is needed.

`python -m tests.bench.card` from the root. Both panels are drawn by the presenter's own shaders
into a picture of the card's memory (EGL), upright and bent, in all windows, black-and-white and
grey, and compared with `pdcd.panels.draw.draw`. It cannot tell what a window, a compositor or a
cable makes of them.
"""

from __future__ import annotations

import sys
import time
from itertools import product
from typing import Literal

import moderngl
import numpy as np

from pdcd.panels.draw import draw
from pdcd.panels.map import PanelView
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.presenter.viewport import Viewport
from tests.panel_pixels import random_frames

Role = Literal["projector", "mask"]

SIZES: dict[Role, tuple[int, int]] = {"projector": (1024, 768), "mask": (1600, 1200)}
BENT = {
    "projector": Placing(flip="horizontal", turn_deg=-5.0, scale=1.2, radial=(0.06, -0.02)),
    "mask": Placing(turn_deg=184.0, scale=1.3, tangential=(0.004, -0.003)),
}
ROWS = 8
TIMED = 200


def main() -> int:
    """Print how many values were compared, how many were wrong, and milliseconds a refresh."""
    # The stubs take each of the backend's settings for a table of them.
    context = moderngl.create_context(standalone=True, backend="egl", require=330)  # type: ignore[arg-type]
    info = context.info
    compared = wrong = 0
    grids, windows = ((48, 64), (90, 160)), ("whole", "quarter")
    for grid, window, bent, grey in product(grids, windows, (False, True), (False, True)):
        for role in SIZES:
            found = _compare(context, _view(role, bent), grid, window, grey)
            compared, wrong = compared + found[0], wrong + found[1]
    sys.stdout.write(
        f"{info['GL_RENDERER']}, {info['GL_VERSION']}: {wrong} of {compared} values wrong, "
        f"{1e3 * _refresh_s(context):.2f} ms a refresh of both panels\n"
    )
    return int(wrong > 0)


def _view(role: Role, bent: bool) -> PanelView:
    place = BENT[role] if bent else Placing()
    return PanelView(role, make_placed_map(place, SIZES[role], SIZES["projector"], role))


def _compare(
    context: moderngl.Context, view: PanelView, grid: tuple[int, int], window: str, grey: bool
) -> tuple[int, int]:
    """Values of one panel that were compared, and how many of them were wrong."""
    frames = random_frames(grid, window, ROWS, grey=grey)
    port = Viewport(context, view, (0, 0), 0, None)
    port.load(frames)
    port.prepare(np.arange(ROWS, dtype=np.int32)[:, None])
    width, height = view.size_px
    picture = context.framebuffer([context.texture((width, height), 4)])
    wrong = 0
    for row in range(ROWS):
        port.draw_pieces(row)
        picture.use()
        context.clear()
        port.draw(row)
        values = np.frombuffer(picture.read(components=3), np.uint8).reshape(height, width, 3)
        wrong += int(np.count_nonzero(values[::-1] != draw(frames, view, row)[..., None]))
    picture.release()
    return 3 * ROWS * width * height, wrong


def _refresh_s(context: moderngl.Context) -> float:
    """Median time to draw both panels of a refresh, quarter windows, bent, until it is done."""
    frames = random_frames((48, 64), "quarter", TIMED)
    ports = []
    for number, role in enumerate(SIZES):
        corner = (number * SIZES["projector"][0], 0)
        ports.append(Viewport(context, _view(role, True), corner, 3 * number, None))
        ports[-1].load(frames)
        ports[-1].prepare(np.arange(TIMED, dtype=np.int32)[:, None])
    picture = context.framebuffer([context.texture((2624, 1200), 4)])
    seconds = []
    for row in range(TIMED):
        begun_s = time.perf_counter()
        for port in ports:
            port.draw_pieces(row)
        picture.use()
        context.clear()
        for port in ports:
            port.draw(row)
        context.finish()
        seconds.append(time.perf_counter() - begun_s)
    return float(np.median(seconds))


if __name__ == "__main__":
    sys.exit(main())
