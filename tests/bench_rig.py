"""Small mock rigs for tests: a matrix scene written to disk, and ready-made configurations."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any
from unittest import mock

import msgspec
import numpy as np
from numpy.typing import NDArray

import pdcd
from drivers.mock import MockBench
from pdcd.bench.tables import (
    CameraConfig,
    Config,
    DisplayConfig,
    FaultsConfig,
    LimitsConfig,
    PanelConfig,
    RigConfig,
    SceneConfig,
    ScheduleConfig,
    ServerConfig,
)
from pdcd.calibration.sensor.body import format_profile
from pdcd.capture.engine import Engine
from pdcd.capture.rig import Rig
from pdcd.codes.make import Codes
from pdcd.files.opening import ArrayLimits
from pdcd.files.reading import read_contents
from pdcd.panels.patterns import Patterns, pack_bits
from pdcd.pictures.darkroom import Darkroom
from pdcd.planning.given import FileSource, read_request_arrays
from pdcd.probing.wanted import MatchPart, UniformPart, WantedMatrix
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from pdcd.sensor.profile import load_profile
from tests.places import DATA

Floats = NDArray[np.float64]

GRID = (3, 4)


def transport(grid: tuple[int, int] = GRID, seed: int = 0) -> Floats:
    """A random transport matrix with a strong diagonal, (N, N)."""
    n = grid[0] * grid[1]
    rng = np.random.default_rng(seed)
    return np.asarray(0.05 * rng.random((n, n)) + np.diag(0.3 + 0.4 * rng.random(n)))


def pairs(codes: Codes) -> tuple[Patterns, Patterns]:
    """Patterns of projector and mask, as `build_frames` takes them."""
    return pack_bits(codes.primal), pack_bits(codes.dual)


def uniform(grid: tuple[int, int], diagonal: float, off: float) -> WantedMatrix:
    """The wanted matrix ``diagonal * I + off * (1 - I)``."""
    n = grid[0] * grid[1]
    same = MatchPart(np.arange(n))
    return WantedMatrix(grid, ((off, UniformPart(n)), (diagonal - off, same)))


def matrix_scene(folder: Path, grid: tuple[int, int] = GRID, ambient: float = 0.0) -> SceneConfig:
    path = folder / "scene.npz"
    np.savez(path, transport=transport(grid), grid=np.array(grid))
    return SceneConfig(kind="matrix", path=str(path), ambient=ambient)


def bright_scene(
    folder: Path, grid: tuple[int, int], ambient: float = 0.0, indirect: float = 0.3
) -> SceneConfig:
    """Cells of random brightness up to the edges, with so much indirect light for the direct."""
    rng = np.random.default_rng(5)
    cells = grid[0] * grid[1]
    transport = indirect * rng.uniform(0.5, 1.0, (cells, cells)) / cells
    transport += np.diag(rng.uniform(0.5, 1.0, cells))
    np.savez(folder / "scene.npz", transport=transport, grid=np.array(grid))
    return SceneConfig(kind="matrix", path=str(folder / "scene.npz"), ambient=ambient)


def scene_of(name: str, grid: tuple[int, int] | None = (24, 32)) -> SceneConfig:
    """A path-traced scene of tests/data, which has 24 x 32 cells, or a preset on others."""
    path = DATA / f"{name}.npz"
    if path.exists():
        return SceneConfig(kind="matrix", path=str(path))
    return SceneConfig(kind=name, grid=grid)


def write_grey_profile(folder: Path) -> str:
    """The profile of a sensor without colours whose samples are those of "modern"; its path."""
    path = folder / "grey.toml"
    path.write_text(format_profile(msgspec.structs.replace(load_profile("modern"), mono=True)))
    return str(path)


DEFECTS = {
    "projector": PanelConfig(
        size_px=(1024, 768), rise_s=0.001, fall_s=0.003, contrast=500.0, jitter_s=2e-4, skew_s=1e-3
    ),
    "mask": PanelConfig(
        size_px=(1600, 1200),
        refresh_hz=59.7,
        phase_s=0.004,
        rise_s=0.009,
        fall_s=0.005,
        contrast=300.0,
        jitter_s=3e-4,
        skew_s=-2e-3,
    ),
    "display": DisplayConfig(
        faults=FaultsConfig(late={"5": 2}, dropped=(8,), stale_mask=(13,), stale_projector=(17,))
    ),
}


def config(folder: Path, *, grid: tuple[int, int] = GRID, **tables: Any) -> Config:
    """The mock bench without noise, on a matrix scene, with its state below `folder`."""
    given = {
        "scene": matrix_scene(folder, grid),
        "camera": CameraConfig(noise="none"),
        "schedule": ScheduleConfig(codes=8),
        "limits": LimitsConfig(min_free_bytes=0),
        "server": ServerConfig(state_dir=str(folder / "state")),
        **tables,
    }
    return Config(**given)


def fitting(grid: tuple[int, int]) -> dict[str, PanelConfig]:
    """Panels whose pixels end where such cells end, so that both draw all borders alike."""
    rows, cols = grid
    replace, bare = msgspec.structs.replace, Config()
    return {
        "projector": replace(bare.projector, size_px=(96 * cols, 96 * rows)),
        "mask": replace(bare.mask, size_px=(144 * cols, 144 * rows)),
    }


def with_defects(folder: Path, **tables: Any) -> Config:
    """Everything wrong at once, misses tolerated."""
    given = {**DEFECTS, "rig": RigConfig(on_miss="flag"), **tables}
    return config(folder, **given)


def bench_of(engine: Engine) -> MockBench:
    """The virtual bench behind an engine."""
    return bench_of_rig(engine._rig)


def bench_of_rig(rig: Rig) -> MockBench:
    """The virtual bench of a rig."""
    return MockBench.of(rig._context)


def are_panels_black(bench: MockBench) -> bool:
    """Whether both panels are told to be black."""
    return bench.black_since_ns is not None


def from_path(path: Path) -> FileSource:
    """The content of a file, as a request brings it."""

    def content(limits: ArrayLimits) -> bytes:
        with path.open("rb") as file:
            return read_contents(file.fileno(), limits)

    return FileSource(content, path.name)


def capture(
    engine: Engine,
    request: CaptureRequest,
    job: str = "job",
    files: Mapping[str, Path] = MappingProxyType({}),
) -> CaptureResult:
    """Run one job with nobody listening; `files` are those of the request, by field."""
    sources = {name: from_path(path) for name, path in files.items()}
    asked, given = read_request_arrays(request, sources, engine.grid)
    return engine.capture(asked, given, job=job, emit=lambda _: None, cancelled=lambda: False)


def cells_error(folder: Path, *, taken_out: bool = True) -> float:
    """RMS error of a run's answer over its truth, both over the cells; as it is, or with all the
    direct light that got into it."""
    all_kept = mock.patch("pdcd.pictures.to_quads.LEAST_DIRECT", math.inf)
    with contextlib.nullcontext() if taken_out else all_kept:
        image = Darkroom(folder, read_manifest(folder).run).decoded().cell_means.image
    truth = pdcd.open(folder).truth
    assert truth is not None
    return float(np.sqrt(np.mean((image - truth) ** 2) / np.mean(truth**2)))
