"""Photos of a stream before two virtual DMDs, as the mock bench makes them of what these showed.

Each photo keeps what its driver logged, what the mirrors really did and when, the light of that
before noise, and the samples.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.mock import MockBench
from drivers.virtual_dlpc900 import MASK_SERIAL, PROJECTOR_SERIAL
from drivers.virtual_genicam.simulator import VIRTUAL_ADDRESS
from pdcd.api.run import Run, open_run
from pdcd.bench.config import from_config_tables
from pdcd.bench.devices import DisplayInfo, RawFile
from pdcd.bench.tables import Config
from pdcd.capture.engine import Engine
from pdcd.panels.frames import FrameLog, Frames
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decoded_run import DecodedRun
from pdcd.pictures.to_cells import average_with_errors
from pdcd.planning.stream_set import make_set_request
from pdcd.protocol.result import make_job_id
from pdcd.protocol.stream import StreamedPicture, StreamRequest
from pdcd.recipes.parts import list_parts
from pdcd.runs.recording import StreamListener
from pdcd.sensor.raw import read_raw
from pdcd.virtual.scene.scene import Scene
from tests.taken import started

SIZES = {
    "whole": ((640, 480), (48, 64)),
    "small": ((160, 120), (12, 16)),
    "cells": ((16, 12), (12, 16)),
}
"""Pixels (columns, rows) and cells (rows, columns): small frames are for counting many
pictures, and one pixel a cell for sums by hand."""
ROW_HZ, PANEL_CELL_PX = 8000.0, 4
MASK_SKEW_S, _JITTER_S = 2e-6, 2e-7
"""By how much the mask is late, and times of each DMD differ from exposure to exposure."""
RING = 64


@dataclass(frozen=True, eq=False)
class MirrorTimes:
    """What mirrors showed, and when, in nanoseconds as the shutter was open from 0 on."""

    frames: Frames
    log: FrameLog
    close_ns: int


@dataclass(frozen=True, eq=False)
class RecordedPhoto:
    """One photo. frames, log : as the display was given and told, by the same time. light : before
    noise, (rows, cols, 3) scene units times seconds."""

    name: str
    frames: Frames
    log: FrameLog
    mirrors: MirrorTimes
    light: NDArray[np.float64]
    samples: NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class RecordedStream:
    """All photos in the order in which they were taken. truth : what pictures show in truth, over
    cells. rms_error : of a capture of the same codes, decoded by those of one photo, over that.
    """

    photos: list[RecordedPhoto]
    display: DisplayInfo
    black_dn: int
    truth: NDArray[np.floating]
    rms_error: float


def make_config(folder: Path, size: str, *, served: bool, margin_s: float = 0.02) -> Config:
    """A bench of two virtual DMDs and a camera without colours: the mock's on a clock that does not
    wait, or one over GigE Vision in real time."""
    quads, grid = SIZES[size]
    panel = {
        "refresh_hz": ROW_HZ,
        "size_px": [PANEL_CELL_PX * grid[1], PANEL_CELL_PX * grid[0]],
        "jitter_s": _JITTER_S,
    }
    camera: dict[str, Any] = {"profile": "mono", "f_number": 1.0}
    if quads != grid[::-1]:
        camera["frame_quads"] = list(quads)
    dmds = {"usb": "virtual-dlpc900", "projector": PROJECTOR_SERIAL, "mask": MASK_SERIAL}
    tables: dict[str, Any] = {
        "projector": panel,
        "mask": panel | {"skew_s": MASK_SKEW_S},
        "display": {"driver": "dlpc900", "row_times": True, "options": dmds},
        "trigger": {"lag_s": 0.0, "jitter_s": 0.0},
        "scene": {"kind": "open-book", "grid": list(grid)},
        "schedule": {"grid": list(grid)},
        "rig": {"settle_s": 0.0, "clock": "virtual"},
        "camera": camera,
        "limits": {"min_free_bytes": 0},
        "server": {"state_dir": str(folder)},
    }
    if served:
        options = {
            "camera": VIRTUAL_ADDRESS, "resend": False, "wait_s": 20.0, "margin_s": margin_s,
            "margin": 0.0, "packet_bytes": 9000,
        }  # fmt: skip
        camera |= {"driver": "genicam", "options": options}
        tables["trigger"]["driver"] = "genicam"
        tables["rig"]["clock"] = "real"
    return from_config_tables(tables, "the bench")


def make_request(codes: int, rate_hz: float = 1000.0) -> StreamRequest:
    """Indirect light, each code for the time of three rows."""
    return StreamRequest(
        goal="indirect",
        codes=codes,
        window="whole",
        rate_hz=rate_hz,
        exposure_s=3.0 * codes / ROW_HZ,
    )


@contextmanager
def mock_engine(size: str) -> Iterator[Engine]:
    """An engine with the mock's camera."""
    with tempfile.TemporaryDirectory() as folder:
        with started(make_config(Path(folder), size, served=False)) as engine:
            yield engine


def record_stream(request: StreamRequest, size: str) -> RecordedStream:
    """Take the first set of photos and `RING` after it."""
    with mock_engine(size) as engine:
        recorder = _Recorder(engine)
        listener = StreamListener(recorder.tell, recorder.enough)
        result = engine.stream(request, job=make_job_id(), listener=listener)
        if not recorder.enough():
            raise SystemExit(f"no stream was recorded: {result.error}")
        display, black_dn = engine._rig.display_info, engine._profile.black_dn
        recorder.end()
        truth, rms_error = _take_capture(engine, request)
    assert display is not None
    return RecordedStream(recorder.photos, display, black_dn, truth, rms_error)


def decode_parts(run: Run, parts: set[int]) -> DecodedRun:
    """What a run of these parts alone would show, of the photos that it has."""
    record, recipe = run.manifest.run, Darkroom(run.folder, run.manifest.run).recipe
    wanted = {shot.name for shot in recipe.shots if not shot.part or shot.part in parts}
    shots = tuple(shot for shot in record.shots if shot.name in wanted)
    return Darkroom(run.folder, msgspec.structs.replace(record, shots=shots)).decoded()


def _take_capture(engine: Engine, request: StreamRequest) -> tuple[NDArray[np.floating], float]:
    """What a capture of the same codes shows in truth, and the RMS error over that of what it
    shows by the codes of one photo of the stream."""
    asked = msgspec.structs.replace(make_set_request(request), keep_raw="all")
    result = engine.capture(asked, job=make_job_id(), emit=lambda _: None, cancelled=lambda: False)
    assert result.folder is not None, result
    run = open_run(Path(result.folder))
    truth = run.truth
    assert truth is not None
    alone = []
    for part in list_parts(Darkroom(run.folder, run.manifest.run).recipe):
        decoded = decode_parts(run, {part})
        alone.append(average_with_errors(decoded.answer, decoded.cells).image)
    return truth, find_rms(np.stack(alone) - truth) / find_rms(truth)


def find_rms(values: NDArray[np.floating]) -> float:
    """Of what is known."""
    return float(np.sqrt(np.nanmean(np.square(values))))


class _Recorder:
    """Looks at the exposures of an engine."""

    def __init__(self, engine: Engine) -> None:
        self.photos: list[RecordedPhoto] = []
        self._rig = rig = engine._rig
        self._bench = MockBench.of(rig.context)
        self._before = 0
        self._name = ""
        self._light: NDArray[np.float64] = np.zeros(0)
        self._samples: NDArray[np.uint16] = np.zeros(0, np.uint16)
        self._mirrors: MirrorTimes | None = None
        self._real = rig.expose, rig.readout.fetch, self._bench.quads
        rig.expose = self._expose  # type: ignore[method-assign]
        rig.readout.fetch = self._fetch  # type: ignore[method-assign,assignment]
        self._bench.quads = self._quads  # type: ignore[method-assign]

    def end(self) -> None:
        """Look no more."""
        rig = self._rig
        rig.expose, rig.readout.fetch = self._real[:2]  # type: ignore[method-assign]
        self._bench.quads = self._real[2]  # type: ignore[method-assign]

    def tell(self, streamed: StreamedPicture) -> None:
        """A picture came."""
        assert streamed.arrays, streamed.frame.spoilt
        self._before = self._before or len(self.photos)

    def enough(self) -> bool:
        """Whether the ring is full."""
        return bool(self._before) and len(self.photos) >= self._before + RING

    def _quads(self) -> NDArray[np.float64]:
        open_ns, close_ns = self._bench.exposed_ns()
        frames, log = self._bench._played()
        self._mirrors = MirrorTimes(frames, shift_log(log, -open_ns), close_ns - open_ns)
        self._light = self._real[2]()
        return self._light

    def _fetch(self, *args: Any) -> Any:
        raw = self._real[1](*args)
        assert isinstance(raw, RawFile)
        self._samples = np.asarray(read_raw(raw.path).samples[0], np.uint16)
        return raw

    def _expose(self, frames: Frames, settings: Any, folder: Path, name: str, **more: Any) -> Any:
        done = self._real[0](frames, settings, folder, name, **more)
        assert self._mirrors is not None
        log = shift_log(done.log, -done.open_ns)
        self.photos.append(
            RecordedPhoto(name, frames, log, self._mirrors, self._light, self._samples)
        )
        return done


def shift_log(log: FrameLog, by_ns: int) -> FrameLog:
    """The log of a display that began so much later."""
    return replace(
        log,
        primal_ns=log.primal_ns + by_ns,
        dual_ns=log.dual_ns + by_ns,
        end_ns=log.end_ns + by_ns,
    )


class MirrorLight:
    """The mock bench, of mirrors as they moved: light before noise."""

    def __init__(self, size: str) -> None:
        with mock_engine(size) as engine:
            rig = engine._rig
            self._bench = MockBench.of(rig.context)
            self._sensor = rig.readout._sensor  # type: ignore[attr-defined]
            self._iso = self._sensor.profile.isos[0]

    @property
    def scene(self) -> Scene:
        """What is photographed."""
        return self._bench.scene

    def see(self, mirrors: MirrorTimes) -> NDArray[np.float64]:
        """Light of one exposure, as of `RecordedPhoto`."""
        bench = self._bench
        bench.panels, bench.unsettled = None, ""
        bench.frames, bench.log = mirrors.frames, mirrors.log
        bench.open_ns, bench.close_ns = 0, mirrors.close_ns
        return bench.quads()

    def expose(self, light: NDArray[np.float64], exposure_s: float) -> NDArray[np.uint16]:
        """What the sensor makes of it, with noise of its own."""
        self._bench.quads = lambda: light  # type: ignore[method-assign]
        self._bench.open_ns, self._bench.close_ns = 0, round(1e9 * exposure_s)
        try:
            ((samples, _),) = self._sensor.photos(self._iso, 1.0, 1)
        finally:
            del self._bench.quads
        return np.asarray(samples, np.uint16)
