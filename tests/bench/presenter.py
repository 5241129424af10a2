"""The display process on an X server without hardware."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import Config, PanelConfig
from pdcd.panels.placing import Placing
from pdcd.presenter.client import DisplayProcess, make_open_request
from pdcd.presenter.timing import RefreshTiming, make_random_codes, measure_refreshes
from tests import x11_rig
from tests.bench.measure import REPEATS
from tests.bench.tables import Aim, Section, Table, grid_name, seconds
from tests.xserver import FULL, QUARTER, XServer, hurry, run

GRID = (48, 64)
COUNTS = (128, 4096, 65536)
HEADS = (
    "who",
    "frames",
    "a second",
    "processor time p50/p99/max",
    "drawing: first, p50, p99",
    "late p50/p99/max",
    "missed",
)
WARP = Placing(turn_deg=2.0, scale=1.1, radial=(0.03, -0.01), tangential=(0.002, -0.001))
"""Turned and distorted, and larger than the field."""
SLOWEST_HZ = 40.0
"""What full size must reach under such a map."""


def section(*, quick: bool, folder: Path) -> Section:
    """Measure; without an X server the section says so."""
    title = "The display process"
    try:
        tables, aims = _measure(quick=quick)
    except pytest.skip.Exception as err:
        return Section(title, f"Not measured: {err}", [])
    return Section(
        title=title,
        text=(
            "Xorg's dummy driver and software rendering: no vblank, no graphics card. Free "
            "running is as fast as it goes; paced is 60 Hz, by the server's made-up vblank. "
            "Processor time is that of the loop's thread from one frame to the next, with what "
            "waiting costs; late is from the vblank to the beginning of the drawing. Missed are "
            "vblanks without a new frame. Drawing is from its beginning until the frame is handed "
            "over, of the first refresh, and of all others. Warped is turned, distorted, and "
            "larger than the field."
        ),
        tables=tables,
        aims=aims,
    )


def _measure(*, quick: bool) -> tuple[list[Table], list[Aim]]:
    os.environ.update(LIBGL_ALWAYS_SOFTWARE="1", LP_NUM_THREADS="0")
    frames = 300 if quick else 3000
    few = frames // 5
    table = Table("Frames of random 64x48 codes", HEADS)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        with run(*FULL) as server:
            hurry(server)
            free, bent = (_with(c, time_source="free") for c in _configs(folder, server))
            _add(table, "full size, free running", measure_refreshes(free, few))
            warped = measure_refreshes(bent, few)
            _add(table, "full size, free running, warped", warped)
        with run(*QUARTER) as server:
            hurry(server)
            config, bent = _configs(folder, server)
            free, again = (_with(c, time_source="free") for c in (config, bent))
            _add(table, "a quarter, free running", measure_refreshes(free, frames))
            _add(table, "a quarter, free running, warped", measure_refreshes(again, few))
            paced = measure_refreshes(config, frames)
            _add(table, "a quarter, paced", paced)
            _add(table, "a quarter, paced, warped", measure_refreshes(bent, frames))
            uploads = _uploads(config)
    first = paced.first_draw_s / float(np.percentile(paced.draw_s, 99))
    aims = [
        Aim("refreshes missed on a quiet machine", "refreshes", float(paced.missed.sum()), 1.0),
        Aim("time of a frame, full size, warped", "s", 1.0 / _rate(warped), 1.0 / SLOWEST_HZ),
        Aim("drawing of refresh 0", "of the others' 99th percentile", first, 1.0),
    ]
    return [table, uploads], aims


def _configs(folder: Path, server: XServer) -> tuple[Config, Config]:
    """Panels that fill the field, and the same ones warped."""
    warped: dict[str, Any] = {
        "projector": PanelConfig(size_px=server.projector_px, place=WARP),
        "mask": PanelConfig(size_px=server.mask_px, place=WARP),
    }
    return (
        x11_rig.config(folder, server, grid=GRID),
        x11_rig.config(folder, server, grid=GRID, **warped),
    )


def _rate(found: RefreshTiming) -> float:
    """Frames a second."""
    return float(found.interval_s.size / found.interval_s.sum())


def _with(config: Config, **options: Any) -> Config:
    display = config.display
    display = msgspec.structs.replace(display, options={**display.options, **options})
    return msgspec.structs.replace(config, display=display)


def _add(table: Table, name: str, found: RefreshTiming) -> None:
    paced = found.ready.source != "free"
    table.add(
        name,
        str(found.interval_s.size),
        f"{_rate(found):.1f}",
        _spread(found.cpu_s),
        ", ".join(seconds(t) for t in (found.first_draw_s, *_quantiles(found.draw_s)[:2])),
        _spread(found.late_s) if paced else "",
        str(int(found.missed.sum())) if paced else "",
    )


def _quantiles(values_s: Sequence[float] | NDArray[np.float64]) -> list[float]:
    return [float(v) for v in np.percentile(values_s, (50, 99, 100))]


def _spread(values_s: Sequence[float] | NDArray[np.float64]) -> str:
    return " / ".join(seconds(v) for v in _quantiles(values_s))


def _uploads(config: Config) -> Table:
    """From the driver's call until the patterns of both panels are in textures."""
    table = Table("Time to hand over all patterns of a shot", ("codes", "cells", "MB", "time"))
    presenter = DisplayProcess(make_open_request(config))
    try:
        for count in COUNTS:
            few = make_random_codes(GRID)
            repeated = np.resize(few.primal_patterns, (count, few.primal_patterns.shape[1]))
            frames = type(few)(
                **{**vars(few), "primal_patterns": repeated, "dual_patterns": repeated}
            )
            took_s = []
            for _ in range(REPEATS):
                begun_s = time.perf_counter()
                presenter.load(frames)
                took_s.append(time.perf_counter() - begun_s)
            megabytes = f"{2e-6 * repeated.nbytes:.1f}"
            table.add(str(count), grid_name(GRID), megabytes, seconds(float(np.median(took_s))))
    finally:
        presenter.close()
    return table
