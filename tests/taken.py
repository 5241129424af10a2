"""Finished captures and calibrations of engines in this process, and what lies in their folders."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.calibration import Calibration, FigureRecord, StepRecord, read_calibration
from pdcd.bench.tables import Config
from pdcd.capture.engine import Engine
from pdcd.pictures.decode import decode_folder
from pdcd.pictures.written.picture_files import read_tiff
from pdcd.protocol.events import Event
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult, Quality, make_job_id
from pdcd.runs.folder import read_manifest
from pdcd.runs.record import Manifest
from tests import bench_rig

NO_FILES: Mapping[str, Path] = MappingProxyType({})


@dataclass(frozen=True)
class Taken:
    """A capture that was finished, and the engine that took it."""

    result: CaptureResult
    engine: Engine

    @property
    def folder(self) -> Path:
        return Path(str(self.result.folder))

    @property
    def summary(self) -> dict[str, Any]:
        return dict(self.result.summary)

    @property
    def warnings(self) -> tuple[str, ...]:
        return self.result.warnings

    @property
    def error(self) -> float:
        """RMS error of the quads over the RMS of the true picture."""
        return float(self.summary["rms_error_quads"])

    @property
    def quality(self) -> Quality:
        found = self.summary["quality"]
        assert isinstance(found, Quality)
        return found

    @cached_property
    def manifest(self) -> Manifest:
        return read_manifest(self.folder)

    @cached_property
    def probe(self) -> dict[str, NDArray[Any]]:
        """Arrays of probe.npz, (rows, cols, 3) each."""
        with np.load(self.folder / "probe.npz", allow_pickle=False) as data:
            return dict(data)

    @property
    def image(self) -> NDArray[Any]:
        return self.probe["image"]

    def picture(self, name: str) -> NDArray[np.float32]:
        """A TIFF, (height, width, 3)."""
        return read_tiff(self.folder / "linear" / f"{name}.tif")

    def decodes_the_same(self) -> bool:
        return decode_folder(self.folder).identical


@dataclass
class Calibrated:
    """A calibration as it ended, and its record where there is one."""

    result: CaptureResult
    heard: list[Event]

    @property
    def record(self) -> Calibration:
        assert self.result.error is None, self.result.error
        assert self.result.folder is not None
        return read_calibration(Path(self.result.folder))[0]

    @property
    def folder(self) -> Path:
        assert self.result.folder is not None
        return Path(self.result.folder)

    @property
    def error(self) -> str:
        assert self.result.error is not None
        return str(self.result.error["message"])

    def step(self, name: str) -> StepRecord:
        return next(step for step in self.record.steps if step.name == name)

    def figures(self, name: str) -> dict[str, FigureRecord]:
        return {figure.name: figure for figure in self.step(name).figures}

    def value(self, figure: str) -> float:
        """Value of a figure, whatever step it is of."""
        values = [f.value for step in self.record.steps for f in step.figures if f.name == figure]
        assert len(values) == 1 and values[0] is not None, figure
        return values[0]


@contextmanager
def started(config: Config) -> Iterator[Engine]:
    """An engine whose rig is open, and safe in the end."""
    engine = Engine.from_config(config)
    try:
        engine.start()
        yield engine
    finally:
        engine.stop()


def capture_on(
    config: Config, request: CaptureRequest, files: Mapping[str, Path] = NO_FILES
) -> CaptureResult:
    """How a capture ends by an engine of its own."""
    with started(config) as engine:
        return bench_rig.capture(engine, request, files=files)


def attempt(config: Config, files: Mapping[str, Path] = NO_FILES, **fields: Any) -> CaptureResult:
    """The same, of indirect light unless `fields` name another goal."""
    return capture_on(config, request_of(**fields), files)


def calibrate(engine: Engine, *steps: Any, **request: Any) -> Calibrated:
    """These steps; without any, all of a whole calibration."""
    heard: list[Event] = []
    result = engine.calibrate(
        CalibrateRequest(steps=steps, **request),
        job=make_job_id(),
        emit=heard.append,
        cancelled=lambda: False,
    )
    return Calibrated(result, heard)


def calibrate_once(config: Config, *steps: Any, **request: Any) -> Calibrated:
    """The same by an engine of its own."""
    with started(config) as engine:
        return calibrate(engine, *steps, **request)


def take(config: Config, files: Mapping[str, Path] = NO_FILES, **fields: Any) -> Taken:
    """A finished capture by an engine of its own."""
    with started(config) as engine:
        return take_with(engine, "job", files, **fields)


def take_with(
    engine: Engine, job: str = "job", files: Mapping[str, Path] = NO_FILES, **fields: Any
) -> Taken:
    """A finished capture by an engine that has started."""
    result = bench_rig.capture(engine, request_of(**fields), job, files)
    assert result.error is None and result.folder is not None, result.error
    return Taken(result, engine)


def request_of(**fields: Any) -> CaptureRequest:
    """Of indirect light unless `fields` name another goal."""
    return msgspec.convert({"goal": "indirect", **fields}, CaptureRequest)


def relative_rms(found: NDArray[Any], truth: NDArray[Any]) -> float:
    """RMS of what differs over the RMS of the truth."""
    return float(np.sqrt(np.mean((found - truth) ** 2) / np.mean((0 * found + truth) ** 2)))
