"""How soon a picture is there once the shutter of a machine-vision camera has closed."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from drivers.virtual_genicam.bench import BenchLight
from drivers.virtual_genicam.camera import VirtualExposure
from pdcd.bench.tables import CameraConfig, RigConfig, SceneConfig, TriggerConfig
from pdcd.protocol.events import DecodingProgress, DecodingStarted, Event, ShutterClosed
from pdcd.protocol.request import CaptureRequest
from tests import bench_rig
from tests.bench.measure import alone
from tests.bench.photo import SCENE
from tests.bench.tables import Aim, Section, Table, seconds
from tests.genicam_rig import turn
from tests.taken import started

DRIVER = "virtual-genicam"
FRAME_PX = (1440, 1080)
GRID = (48, 64)
CODES = 128
REPEATS, QUICK_REPEATS = 7, 3
LIMIT_S = 0.5
DIM = 114.0
"""A stop at which white does not fill the small well of the sensor."""


def run(*, quick: bool, folder: Path) -> Section:
    """Measure in a process of its own."""
    repeats = QUICK_REPEATS if quick else REPEATS
    found = alone("machine_vision:measure", repeats=repeats)
    width, height = FRAME_PX
    table = Table(
        f"White and indirect light, {CODES} codes, {width} x {height} pixels of Mono12p",
        ("from the last shutter close on", "time"),
    )
    for what, key in (
        ("the mock bench works out what the sensor sees", "mock_s"),
        ("its frame comes by packets, is unpacked and held as a DNG", "frame_s"),
        ("pictures with error bars are made of both photos", "decode_s"),
        ("sum", "sum_s"),
    ):
        table.add(what, seconds(found[key]))
    return Section(
        title="From the shutter to the picture",
        text=(
            f"The driver `{DRIVER}` with `keep = 'none'` before the scene `{SCENE}`, in one "
            "process: frames come over GigE Vision on the loopback, and no photo is written to "
            "disk. Exposures take no time on the virtual clock. The first line is no camera's, and "
            f"without drawn noise. Medians of {repeats} captures after the first one."
        ),
        tables=[table],
        aims=[Aim("last shutter close to the picture, the mock's light included", "s",
                  found["sum_s"], LIMIT_S)],
    )  # fmt: skip


def measure(repeats: int) -> dict[str, float]:
    """Seconds of each part."""
    rows: list[dict[str, float]] = []
    rendered: list[float] = []
    make = BenchLight.make_samples

    def timed(film: BenchLight, exposure: VirtualExposure) -> Any:
        begun_s = time.perf_counter()
        samples = make(film, exposure)
        rendered.append(time.perf_counter() - begun_s)
        return samples

    BenchLight.make_samples = timed  # type: ignore[assignment,method-assign]
    request = CaptureRequest(
        goal="indirect", codes=CODES, pilot=0, parts=1, black_level="none", keep_raw="none"
    )
    tables: dict[str, Any] = {
        "camera": CameraConfig(
            driver=DRIVER, profile="mono", noise="none", f_number=DIM, frame_quads=FRAME_PX
        ),
        "trigger": TriggerConfig(driver=DRIVER, lag_s=0.001, jitter_s=0.0),
        "rig": RigConfig(look_at_panels=False),
        "scene": SceneConfig(kind=SCENE, grid=GRID),
    }
    with (
        tempfile.TemporaryDirectory() as place,
        turn(),
        started(bench_rig.config(Path(place), **tables)) as engine,
    ):
        for number in range(repeats + 1):
            at: dict[type[Event], float] = {}  # when each kind of event was last heard
            result = engine.capture(
                request,
                job=f"job-{number}",
                emit=lambda event, at=at: at.__setitem__(type(event), time.perf_counter()),  # type: ignore[misc]
                cancelled=lambda: False,
            )
            if result.error is not None:
                raise RuntimeError(f"{result.error}")
            closed_s, started_s = at[ShutterClosed], at[DecodingStarted]
            rows.append(
                {
                    "mock_s": rendered[-1],
                    "frame_s": started_s - closed_s - rendered[-1],
                    "decode_s": at[DecodingProgress] - started_s,
                    "sum_s": at[DecodingProgress] - closed_s,
                }
            )
    return {key: median(row[key] for row in rows[1:]) for key in rows[0]}
