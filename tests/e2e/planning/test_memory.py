"""The foreseen memory against what is really taken, by goals, families and grids."""

from __future__ import annotations

import os
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, LimitsConfig, PanelConfig, SceneConfig
from pdcd.capture.engine import Engine
from pdcd.errors import PdcdError, RequestError
from pdcd.panels.placing import Placing
from pdcd.pictures.decode import decode_folder
from pdcd.planning import memory
from pdcd.planning.make import plan_with_prior
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import make_job_id
from pdcd.sensor import cells
from tests import bench_rig
from tests.sampled import sampled

GRID = (12, 16)
CELLS = GRID[0] * GRID[1]
RNG = np.random.default_rng(1)
LIGHT = RNG.random(GRID).tolist()
WARP = RNG.permutation(CELLS).reshape(GRID).tolist()


@contextmanager
def peak() -> Iterator[list[int]]:
    """Bytes of Python and numpy at their most within the body, above what there was before."""
    found: list[int] = []
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        yield found
        found.append(tracemalloc.get_traced_memory()[1] - before)
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize(
    "fields",
    [
        {"goal": "indirect", "family": "bernoulli"},
        {"goal": "indirect", "family": "balanced"},
        {"goal": "indirect", "family": "rademacher"},
        {"goal": "indirect", "family": "hadamard"},
        {"goal": "indirect", "illumination": LIGHT},
        {"goal": "fraction", "p": 0.25},
        {"goal": "short-range", "radius": 3},
        {"goal": "diagonal"},
        {"goal": "warped", "warp": WARP, "illumination": LIGHT},
        {"goal": "filtered", "kernel": RNG.standard_normal((23, 31)).tolist()},
        {"goal": "split", "period": 16},
        {"goal": "relit", "matrix": RNG.standard_normal((CELLS, CELLS)).tolist(), "codes": 256},
        {"goal": "direct", "method": "multi-image"},
    ],
    ids=lambda f: "-".join(str(v) for v in f.values() if isinstance(v, str)),
)  # fmt: skip
def test_planning_takes_what_was_foreseen(
    fields: dict[str, Any], window: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "BASE", 0)  # so that nothing hides behind it
    monkeypatch.setattr(memory, "decoding_bytes", lambda *args: 0)
    small = 2**19  # frames, logs and blocks of fixed size, at this number of codes
    request = msgspec.convert(
        {"codes": 512, "family": "bernoulli", "window": window, **fields}, CaptureRequest
    )
    config = Config(scene=SceneConfig(grid=GRID))
    plan_with_prior(request, config, GRID)  # what is kept for good is made before
    with peak() as taken:
        plan = plan_with_prior(request, config, GRID)
    assert taken[0] <= plan.memory_bytes + small
    assert plan.memory_bytes <= memory.SLACK * taken[0] + small


@pytest.mark.parametrize(
    "fields",
    [
        {"goal": "indirect", "codes": 32, "family": "bernoulli"},
        {"goal": "indirect", "codes": 12, "method": "multi-image"},
    ],
    ids=lambda f: f"{f['goal']}-{f['codes']}",
)
def test_a_capture_takes_no_more_than_its_plan_says(fields: dict[str, Any], tmp_path: Path) -> None:
    engine = Engine.from_config(bench_rig.config(tmp_path, scene=SceneConfig(grid=(6, 8))))
    engine.start()
    request = msgspec.convert({**fields, "white": False}, CaptureRequest)
    foreseen = engine.plan(request).memory_bytes
    with peak() as taken:
        result = bench_rig.capture(engine, request, job=make_job_id())
    engine.stop()
    assert result.state == "done", result.error
    assert taken[0] <= foreseen
    assert foreseen <= memory.SLACK * taken[0] + memory.BASE


SMALL, LARGE = (640, 480), (2136, 1424)
slow = pytest.mark.skipif(
    not os.environ.get("PDCD_TEST_SLOW"), reason="takes minutes: make test-slow"
)


@pytest.mark.parametrize(
    "frame",
    [SMALL, pytest.param(LARGE, marks=[slow, pytest.mark.timeout(900)])],
    ids=lambda f: f"{f[0]}x{f[1]}",
)
@pytest.mark.parametrize("place", sampled([Placing(turn_deg=2.0, scale=1.05), Placing()], 2))
def test_pictures_of_many_quads_take_what_was_foreseen(
    tmp_path: Path, frame: tuple[int, int], place: Placing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From RAW files to pictures: neither less, nor more than 1.4 times as much."""
    monkeypatch.setattr(memory, "BASE", 0)  # so that nothing hides behind it
    panel = PanelConfig(size_px=(256, 192))
    camera = CameraConfig(noise="none", f_number=8.0, frame_quads=frame, place=place)
    engine = Engine.from_config(
        bench_rig.config(tmp_path, grid=GRID, projector=panel, mask=panel, camera=camera)
    )
    engine.start()
    request = CaptureRequest(goal="indirect", codes=8, window="whole")
    foreseen = engine.plan(request).memory_bytes
    result = bench_rig.capture(engine, request)
    engine.stop()
    assert result.folder is not None, result.error
    for kept in (cells._footprint, cells._places, cells._lines, cells._single):
        kept.cache_clear()  # as in a process that has decoded nothing yet
    with peak() as taken:
        decode_folder(Path(result.folder))
    assert taken[0] <= foreseen <= 1.4 * taken[0]


def test_what_is_too_much_is_refused_before_it_is_taken() -> None:
    limits = LimitsConfig(memory_bytes=2**28, max_exposure_s=3600.0)
    config = Config(scene=SceneConfig(grid=(96, 128)), limits=limits)
    request = CaptureRequest(goal="diagonal", codes=4096)
    with peak() as taken, pytest.raises(RequestError, match="limit is 256 MiB") as caught:
        plan_with_prior(request, config, (96, 128))
    assert taken[0] < 2**22
    assert "96 x 128" in str(caught.value) and "limits.memory_bytes" in str(caught.value)


def test_half_of_the_machine_is_the_limit_unless_one_is_set() -> None:
    total = int(Path("/proc/meminfo").read_text(encoding="ascii").split()[1]) * 1024
    assert memory.memory_limit_bytes(Config()) == pytest.approx(total / 2, rel=0.01)
    assert memory.memory_limit_bytes(Config(limits=LimitsConfig(memory_bytes=2**30))) == 2**30


def test_a_search_leaves_out_what_takes_too_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = Engine.from_config(bench_rig.config(tmp_path))
    request = CaptureRequest(goal="indirect", seconds=30.0)
    assert engine.plan(request).codes > 12
    few = engine.plan(CaptureRequest(goal="indirect", codes=12)).memory_bytes
    monkeypatch.setattr(memory, "memory_limit_bytes", lambda config: few)
    found = engine.plan(request)
    assert found.codes <= 12 and found.memory_bytes <= few
    monkeypatch.setattr(memory, "memory_limit_bytes", lambda config: 0)
    with pytest.raises(PdcdError, match="of memory"):
        engine.plan(request)
