"""The photo made of the X screen's own pixels: right ones, and every way to be wrong.

A hand-made exposure on a flat scene: cell C is lit and seen for one refresh, so a right photo has
that refresh's length at C and nothing elsewhere, and each fault changes it by a share of the cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from Xlib import X

from drivers.mock.bench import MockBench
from pdcd.bench.tables import RigConfig, SceneConfig
from pdcd.capture.rig import Rig
from pdcd.errors import SyncError
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.schedule import build_frames
from pdcd.presenter.xconnection import close_x_connection, open_x_connection
from tests import lateness, x11_rig
from tests.xserver import QUARTER, XServer, hurry, run

pytestmark = pytest.mark.whole

GRID = (6, 8)

CELL = 20
"""Row 2, column 4: projector pixels 128..159 by 64..95, mask pixels 200..249 by 100..149."""

PROJECTOR_PX, MASK_PX = QUARTER

N = GRID[0] * GRID[1]

TRIES = 5


def one_code(lit: list[int], seen: list[int], grid: tuple[int, int] = GRID) -> Frames:
    """A code between two guards: black mask, code, black mask."""
    patterns = []
    for cells in (lit, seen):
        levels = np.zeros((1, grid[0] * grid[1]), dtype=bool)
        levels[0, cells] = True
        patterns.append(np.packbits(levels, axis=1))
    return build_frames((patterns[0], patterns[1]), grid, window="whole", schedule="full", passes=1)


@contextmanager
def rig_on(
    folder: Path,
    server: XServer,
    transport: NDArray[np.float64],
    on_miss: Literal["abort", "balance", "flag"] = "flag",
    **more: Any,
) -> Iterator[Rig]:
    scene = folder / "flat.npz"
    np.savez(scene, transport=transport, grid=np.array(GRID))
    config = x11_rig.config(
        folder,
        server,
        grid=GRID,
        more={"grab_px": [[0, 0], [PROJECTOR_PX[0], 0]], **more},
        scene=SceneConfig(kind="matrix", path=str(scene)),
        rig=RigConfig(clock="real", on_miss=on_miss),
    )
    rig = Rig(config)
    rig.connect()
    try:
        yield rig
    finally:
        rig.disconnect()


def expose(rig: Rig, frames: Frames) -> tuple[MockBench, FrameLog]:
    """One exposure, without the camera's file."""
    bench = MockBench.of(rig._context)
    rig.display.load(frames)
    rig.shutter.open()
    log = rig.display.play(lambda *_: None, lambda: False)
    rig._context.shared.played = (frames, log)
    rig.shutter.close()
    return bench, log


def expose_evenly(rig: Rig, frames: Frames) -> tuple[MockBench, FrameLog]:
    """The first of a few exposures in which every code was seen as long; skips where the machine
    itself was late meanwhile."""
    with lateness.watched() as machine:
        for _ in range(TRIES):
            with suppress(SyncError):
                return expose(rig, frames)
            rig.shutter.close()
    told = f"codes were unequal in all of {TRIES} exposures"
    machine.quiet_or_skip(told)
    pytest.fail(f"{told} on a machine that was in time")


def lit_s(log: FrameLog, row: int) -> float:
    """How long a row was on the panels; they begin together here."""
    ends = [*log.dual_ns[1:].tolist(), int(log.end_ns[1])]
    return float((ends[row] - log.dual_ns[row]) * 1e-9)


def open_row(frames: Frames) -> int:
    (row,) = np.flatnonzero(~frames.guard)
    return int(row)


def photo(rig: Rig, frames: Frames) -> tuple[NDArray[np.float64], float]:
    """Grey photo (N,) and how long the code was shown."""
    bench, log = expose(rig, frames)
    return bench.photo()[:, 0], lit_s(log, open_row(frames))


def at(**cells: float) -> NDArray[np.float64]:
    """A photo that is black but for some cells, c20=..."""
    wanted = np.zeros(N)
    for name, value in cells.items():
        wanted[int(name[1:])] = value
    return wanted


@contextmanager
def patch(server: XServer, x: int, y: int, width: int, height: int, level: int) -> Iterator[None]:
    """A patch of another program's over whatever is shown, in one grey level."""
    display = open_x_connection(server.display)
    window = display.screen().root.create_window(
        x, y, width, height, 0, X.CopyFromParent,
        background_pixel=level * 0x010101, override_redirect=1,
    )  # fmt: skip
    window.map()
    # The presenter's window may rise when it is shown: keep on top.
    window.configure(stack_mode=X.Above)
    display.sync()
    try:
        yield
    finally:
        window.destroy()
        close_x_connection(display)


@pytest.mark.parametrize("layout", ["span", "windows"])
def test_right_pixels_make_the_photo_of_the_frame_log(
    tmp_path: Path, x_quarter: XServer, layout: str
) -> None:
    rng = np.random.default_rng(5)
    transport = rng.random((N, N))
    lit, seen = (rng.permutation(N)[: N // 2].tolist() for _ in range(2))
    with rig_on(tmp_path, x_quarter, transport, layout=layout) as rig:
        bench, log = expose(rig, one_code(lit, seen))
        pixels = bench.photo()
        shown, rig._context.shared.pixels = rig._context.shared.pixels, None
        assert shown is not None
        np.testing.assert_allclose(pixels, bench.photo(), rtol=1e-12)
    assert len(shown) == len(log)
    assert pixels.max() > 0.01


def test_a_right_photo_and_wrong_pixels(tmp_path: Path, x_quarter: XServer) -> None:
    frames = one_code([CELL], [CELL])
    with rig_on(tmp_path, x_quarter, np.eye(N)) as rig:
        right, code_s = photo(rig, frames)
        np.testing.assert_allclose(right, at(c20=code_s), atol=1e-15)
        # 3 x 2 dark pixels of the 32 x 32 of the projector's cell.
        with patch(x_quarter, 130, 70, 3, 2, 0):
            found, code_s = photo(rig, frames)
        np.testing.assert_allclose(found, at(c20=code_s * (1 - 6 / 1024)), atol=1e-15)
        # One dark pixel of the 50 x 50 of the mask's cell.
        with patch(x_quarter, PROJECTOR_PX[0] + 210, 110, 1, 1, 0):
            found, code_s = photo(rig, frames)
        np.testing.assert_allclose(found, at(c20=code_s * (1 - 1 / 2500)), atol=1e-15)


@pytest.mark.long
def test_a_pixel_that_stays_open_leaks_in_the_guards(tmp_path: Path, x_quarter: XServer) -> None:
    """2 x 2 of the mask's 2500 pixels are open by a third (85 of 255) all the time."""
    frames = one_code([CELL], [])
    with (
        rig_on(tmp_path, x_quarter, np.eye(N)) as rig,
        patch(x_quarter, PROJECTOR_PX[0] + 220, 120, 2, 2, 85),
    ):
        bench, log = expose(rig, frames)
        lit_rows = np.flatnonzero(frames.primal_index >= 0)
        lit_together_s = sum(lit_s(log, int(row)) for row in lit_rows)
        found = bench.photo()[:, 0]
    np.testing.assert_allclose(found, at(c20=lit_together_s * 4 / 2500 / 3), atol=1e-15)


@pytest.mark.long
def test_a_mirrored_window(tmp_path: Path, x_quarter: XServer) -> None:
    """What the projector's window shows is mirrored left to right: column 4 becomes column 3."""
    frames = one_code([CELL], [CELL - 1, CELL])
    levels = np.unpackbits(frames.primal_patterns.astype(np.uint8), axis=1, count=N)
    mirrored = levels.reshape(-1, *GRID)[:, :, ::-1].reshape(-1, N)
    wrong = replace(frames, primal_patterns=np.packbits(mirrored, axis=1))
    with rig_on(tmp_path, x_quarter, np.eye(N)) as rig:
        found, code_s = photo(rig, wrong)
    np.testing.assert_allclose(found, at(c19=code_s), atol=1e-15)


@pytest.fixture(scope="module")
def large() -> Iterator[XServer]:
    """One large screen, on which windows can be put anywhere."""
    with run((PROJECTOR_PX[0] + 8, PROJECTOR_PX[1] + 8), MASK_PX, kinds=("xvfb",)) as server:
        hurry(server)
        yield replace(server, projector_px=PROJECTOR_PX)


@pytest.mark.parametrize(
    ("right", "down", "kept"),
    [(0, 0, 1.0), (2, 1, 30 * 31 / 1024)],
)
def test_a_shifted_window(
    tmp_path: Path, large: XServer, right: int, down: int, kept: float
) -> None:
    """The projector's window lies some pixels off; the rest of the cell still meets the mask's."""
    spot = [[right, down], [PROJECTOR_PX[0] + 8, 0]]
    seen = [[0, 0], [PROJECTOR_PX[0] + 8, 0]]
    more: dict[str, Any] = {"positions_px": spot, "grab_px": seen}
    with rig_on(tmp_path, large, np.eye(N), **more) as rig:
        found, code_s = photo(rig, one_code([CELL], [CELL]))
    np.testing.assert_allclose(found, at(c20=code_s * kept), atol=1e-15)


@pytest.mark.long
def test_swapped_panels(tmp_path: Path) -> None:
    """Two panels of one size with their names exchanged: the mask's code lights the scene."""
    with run(PROJECTOR_PX, PROJECTOR_PX) as server:
        hurry(server)
        # Light goes on to the next cell: 10 is to be lit, 11 to be seen.
        transport, frames = np.eye(N, k=-1), one_code([10], [11])
        exchanged: dict[str, Any] = {"projector": server.mask, "mask": server.projector}
        if server.kind == "xvfb":
            exchanged = {"positions_px": [[PROJECTOR_PX[0], 0], [0, 0]]}
        with rig_on(tmp_path, server, transport) as rig:
            found, code_s = photo(rig, frames)
            np.testing.assert_allclose(found, at(c11=code_s), atol=1e-15)
        with rig_on(tmp_path, server, transport, **exchanged) as rig:
            # Now 11 is lit and shines on 12, and only 10 is seen.
            found, code_s = photo(rig, frames)
            np.testing.assert_allclose(found, np.zeros(N), atol=1e-15)
            found, code_s = photo(rig, one_code([12], [11]))
            np.testing.assert_allclose(found, at(c12=code_s), atol=1e-15)


@pytest.mark.long
def test_pictures_of_several_passes_join_as_their_logs_do(
    tmp_path: Path, x_quarter: XServer
) -> None:
    """Policy balance: a stalled code gets the others a further pass, and the photo has both.

    Codes that stay unequal, as where a busy machine loses refreshes of its own, are no photo: it is
    taken again.
    """
    rng = np.random.default_rng(8)
    patterns = [np.packbits(rng.random((4, N)) < 0.5, axis=1) for _ in range(2)]
    frames = build_frames(
        (patterns[0], patterns[1]), GRID, window="whole", schedule="full", passes=1
    )
    row = open_row(one_code([0], [0]))
    stalls: dict[str, Any] = {"stalls_ms": {str(row): 30.0}}
    with rig_on(tmp_path, x_quarter, rng.random((N, N)), "balance", **stalls) as rig:
        bench, log = expose_evenly(rig, frames)
        pixels = bench.photo()
        rig._context.shared.pixels = None
        np.testing.assert_allclose(pixels, bench.photo(), rtol=1e-12)
    assert len(log) > len(frames)
