"""Two virtual DMDs on the outputs of a real X server: what their mirrors show of its pixels, plane
by plane, and a capture with them."""

from __future__ import annotations

import csv
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.virtual_dlpc900 import VirtualDmdBus
from pdcd.bench import registry
from pdcd.bench.devices import DriverContext
from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config, DisplayConfig
from pdcd.capture.engine import Engine
from pdcd.protocol.request import CaptureRequest
from tests import bench_rig, x11_rig, xserver
from tests.dlpc_video_rig import (
    BOTH_350,
    DLPC,
    KINDS,
    REFRESH_HZ,
    SIZES,
    Kind,
    cut_rows,
    is_dark,
    join_channels,
    make_video_display,
    make_video_dmds,
    read_played,
)
from tests.panel_pixels import planned, random_frames
from tests.xserver import XServer

pytestmark = pytest.mark.whole

PICTURE_S = 1 / REFRESH_HZ


def make_config(folder: Path, server: XServer, order: str = "GRB") -> Config:
    options = x11_rig.options(server, dlpc=DLPC)
    display = DisplayConfig(
        driver="dlpc-video",
        options=options,
        planes_per_refresh=24,
        plane_order=order,  # type: ignore[arg-type]
    )
    return x11_rig.config(folder, server, display=display)


@pytest.fixture
def x_server(kind: Kind, request: pytest.FixtureRequest) -> Iterator[XServer]:
    """Outputs of as many pixels as the devices have mirrors."""
    if kind == "dlpc900":
        yield request.getfixturevalue("x_quarter")
        return
    with xserver.run(SIZES[kind], SIZES[kind]) as server:
        yield server


@pytest.mark.parametrize(
    ("kind", "window", "order", "rows"),
    [
        ("dlpc900", "whole", "GRB", 72),
        ("dlpc900", "quarter", "BRG", 72),
        ("dlpc350", "quarter", "GRB", 24),
    ],
)
def test_mirrors_show_each_row_of_the_schedule_in_its_plane(
    tmp_path: Path, x_server: XServer, kind: Kind, window: str, order: str, rows: int
) -> None:
    """Pictures as the server has them, a word a pixel, by way of the table that the devices took:
    each row of the frames in its turn, and 0 wrong pixels."""
    config = make_config(tmp_path, x_server, order)
    sizes = config.projector.size_px, config.mask.size_px
    dmds = make_video_dmds(sizes, kinds=(kind, kind), video_planes=order)
    frames = random_frames((12, 16), window, rows)
    views, wrong, planes = panels_of(config), 0, 0
    display = make_video_display(config, dmds)
    planes_us = display.connect().identity["planes"]  # by the rate as it was measured
    plane_ns = 1000 * int(planes_us.split()[2])
    assert 660_000 < plane_ns <= 688_000
    try:
        for first in range(0, rows, 24):
            display.show(cut_rows(frames, first, 24))
            *shown, rest = x11_rig.panels(x_server)
            assert rest == 0
            for device, rgb, view in zip(dmds, shown, (views.projector, views.mask), strict=True):
                at_ns = device.clock.now_ns()
                device.drive_video(join_channels(rgb), at_ns)
                time.sleep(PICTURE_S)
                played = read_played(device, at_ns, at_ns + 24 * plane_ns)
                assert [ns - at_ns for ns, _ in played] == [plane_ns * n for n in range(24)]
                for n, (_, plane) in enumerate(played):
                    assert plane is not None
                    wrong += int(np.count_nonzero(plane != (planned(frames, first + n, view) > 0)))
                    planes += 1
        display.black()
        *shown, _ = x11_rig.panels(x_server)
        for device, rgb in zip(dmds, shown, strict=True):
            device.drive_video(join_channels(rgb), device.clock.now_ns())
            assert is_dark(device)
    finally:
        display.disconnect()
    assert (planes, wrong) == (2 * rows, 0)


class VideoUsb:
    """A USB with both devices on it, for the registry."""

    maturity = "experimental"

    @classmethod
    def create(cls, context: DriverContext) -> object:
        sizes = context.config.projector.size_px, context.config.mask.size_px
        kinds = BOTH_350 if sizes[0] == SIZES["dlpc350"] else KINDS
        return VirtualDmdBus(*make_video_dmds(sizes, kinds=kinds))


@pytest.mark.parametrize("kind", ["dlpc900", "dlpc350"])
def test_a_capture_with_it(
    tmp_path: Path, x_server: XServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = {**registry.DRIVERS, ("usb", "given"): f"{__name__}:VideoUsb"}
    monkeypatch.setattr(registry, "DRIVERS", known)
    request = CaptureRequest(goal="indirect", codes=64, pilot=0, parts=1, guards=False, white=False)
    engine = Engine(make_config(tmp_path, x_server))
    engine.start()
    try:
        result = bench_rig.capture(engine, request)
    finally:
        engine.stop()
    assert result.state == "done", result.error
    folder = Path(str(result.folder))
    with (folder / "frames.csv").open() as log:
        rows = list(csv.DictReader(log))
    codes = [int(row["code"]) for row in rows]  # a missed refresh shows a picture's 24 once more
    assert len(rows) == 64 + 24 * sum(int(row["missed"]) for row in rows)
    assert sorted(set(codes)) == list(range(64)) and codes[:24] == list(range(24))
    assert {row["dark_ns"] for row in rows[:23]} == {"0"}
    assert any("planes" in warning for warning in result.warnings)  # of outputs out of step
    assert bench_rig.cells_error(folder) < 0.1
