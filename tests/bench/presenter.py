"""The display process on an X server without hardware, beside a plain script."""

from __future__ import annotations

import json
import os
import subprocess
import sys
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
from tests.xserver import FULL, QUARTER, XServer, run

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
ROUNDS = 5
"""Times that the loop and the script take turns where they are compared: a machine may slow down
from one minute to the next."""
LONG_INTERVAL = 1.5
"""Refreshes from which an interval counts as missed where nobody counts vblanks."""


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
            "Xorg's dummy driver and software rendering: no vblank, no graphics card. The plain "
            "script has one window for each output and uploads each pattern when it is due. Free "
            "running is as fast as it goes; paced is 60 Hz, by the server's made-up vblank, and by "
            "sleeping in the script. Processor time is that of the loop's thread from one frame to "
            "the next, with what waiting costs; late is from the vblank, or the time that was due, "
            "to the beginning of the drawing. Missed are vblanks without a new frame, in the "
            "script intervals of 1.5 refreshes or more. Drawing is from its beginning until the "
            "frame is handed over, of the first refresh, and of all others. Where both are "
            "measured they took turns. Warped is turned, distorted, and larger than the field."
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
            x11_rig.hurry(server)
            free, bent = (_with(c, time_source="free") for c in _configs(folder, server))
            fastest, script = _in_turn(free, server, few, 0.0)
            _add(table, "pdcd, full size, free running", fastest)
            _add_script(table, "plain script, full size, free running", script, 0.0)
            warped = measure_refreshes(bent, few)
            _add(table, "pdcd, full size, free running, warped", warped)
        with run(*QUARTER) as server:
            x11_rig.hurry(server)
            config, bent = _configs(folder, server)
            fastest, script = _in_turn(_with(config, time_source="free"), server, frames, 0.0)
            _add(table, "pdcd, a quarter, free running", fastest)
            script_hz = _add_script(table, "plain script, a quarter, free running", script, 0.0)
            again = measure_refreshes(_with(bent, time_source="free"), few)
            _add(table, "pdcd, a quarter, free running, warped", again)
            paced, script = _in_turn(config, server, frames, 60.0)
            _add(table, "pdcd, a quarter, paced", paced)
            _add_script(table, "plain script, a quarter, paced", script, 60.0)
            _add(table, "pdcd, a quarter, paced, warped", measure_refreshes(bent, frames))
            uploads = _uploads(config)
    ours_s, script_s = (float(np.median(s)) for s in (paced.cpu_s, script["cpu_s"]))
    first = paced.first_draw_s / float(np.percentile(paced.draw_s, 99))
    aims = [
        Aim("refreshes missed on a quiet machine", "refreshes", float(paced.missed.sum()), 1.0),
        Aim("loop's processor time, paced", "of the plain script's", ours_s / script_s, 1.0),
        Aim("time of a frame, a quarter", "of the plain script's", script_hz / _rate(fastest), 1.0),
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


def _in_turn(
    config: Config, server: XServer, frames: int, hz: float
) -> tuple[RefreshTiming, dict[str, NDArray[np.float64]]]:
    """The loop's timing, and what the script tells of itself; `ROUNDS` times, frames of all."""
    sizes = [str(n) for n in (*server.projector_px, *server.mask_px)]
    each = frames // ROUNDS
    words = [sys.executable, "-m", "tests.bench.plain_display", str(each), str(hz), *sizes]
    ours, its = [], []
    for _ in range(ROUNDS):
        ours.append(measure_refreshes(config, each))
        done = subprocess.run(words, env=server.env(), capture_output=True, text=True, check=True)
        its.append({name: np.array(told) for name, told in json.loads(done.stdout).items()})
        its[-1]["interval_s"] = np.diff(its[-1].pop("stamps_s"))
    interval_s, missed, late_s, draw_s, cpu_s = (
        np.concatenate([getattr(one, name) for one in ours])
        for name in ("interval_s", "missed", "late_s", "draw_s", "cpu_s")
    )
    first_s = max(one.first_draw_s for one in ours)
    pooled = RefreshTiming(ours[0].ready, interval_s, missed, late_s, draw_s, cpu_s, first_s)
    return pooled, {name: np.concatenate([one[name] for one in its]) for name in its[0]}


def _add_script(table: Table, name: str, found: dict[str, NDArray[np.float64]], hz: float) -> float:
    """A line of the table; frames a second."""
    intervals_s = found["interval_s"]
    missed = np.rint(intervals_s * hz) - 1
    rate_hz = float(intervals_s.size / intervals_s.sum())
    table.add(
        name,
        str(found["cpu_s"].size),
        f"{rate_hz:.1f}",
        _spread(found["cpu_s"]),
        "",
        _spread(found["late_s"]) if hz else "",
        str(int(missed[intervals_s * hz > LONG_INTERVAL].sum())) if hz else "",
    )
    return rate_hz


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
