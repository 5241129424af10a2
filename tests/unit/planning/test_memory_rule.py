"""Captures that cannot be decoded within the memory limit, counted by hand."""

from __future__ import annotations

import tracemalloc
from typing import Any

import msgspec
import pytest

from pdcd.bench.tables import CameraConfig, Config, LimitsConfig
from pdcd.errors import RequestError
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing
from pdcd.planning.make import make_plan
from pdcd.planning.memory import MemoryLimitError, check_memory, count_frame_quads
from pdcd.protocol.request import CaptureRequest

GRID = (3, 4)
CAMERA = CameraConfig(frame_quads=(10, 10))


def request_of(**fields: Any) -> CaptureRequest:
    return msgspec.convert({"goal": "indirect", "window": "whole", **fields}, CaptureRequest)


@pytest.mark.parametrize(
    ("fields", "codes", "files"),
    [
        # The white photo is one code.
        ({"codes": 8}, 8 + 1, 2),
        # No shot keeps more than a matrix of all 12 cells.
        ({"codes": 64}, 12 + 1, 2),
        ({"codes": 16, "parts": 2}, 2 * 8 + 1, 3),
        ({"codes": 8, "black_level": "ambient"}, 2 * (8 + 1), 4),
        ({"codes": 48, "pilot": 32}, 12 + 32 + 1, 34),
        ({"goal": "direct", "method": "multi-image", "codes": 16}, 16, 16),
        ({"goal": "white"}, 1, 1),
    ],
)
def test_codes_cells_and_raw_files_are_held_against_the_limit(
    fields: dict[str, Any], codes: int, files: int
) -> None:
    needed = 16 * codes * 12 + 9 * files * 100
    config = Config(camera=CAMERA, limits=LimitsConfig(work_bytes=needed))
    plan = make_plan(request_of(**fields), config, GRID)
    assert plan.summary().raw_files == files
    with pytest.raises(MemoryLimitError):
        check_memory(plan.recipe, plan.how, config, 0.99)
    tight = Config(camera=CAMERA, limits=LimitsConfig(work_bytes=needed - 1))
    with pytest.raises(MemoryLimitError, match=f"{files} RAW files on a grid of 3 x 4") as caught:
        make_plan(request_of(**fields), tight, GRID)
    assert isinstance(caught.value, RequestError) and "limits.work_bytes" in str(caught.value.hint)


def test_what_can_never_fit_is_refused_before_codes_are_made() -> None:
    config = Config(
        camera=CameraConfig(driver="gphoto2"), limits=LimitsConfig(max_exposure_s=3600.0)
    )
    request = request_of(goal="direct", method="multi-image", codes=256, white=False)
    tracemalloc.start()
    try:
        with pytest.raises(MemoryLimitError, match="limit is 4096 MiB"):
            make_plan(request, config, (96, 128))
        assert tracemalloc.get_traced_memory()[1] < 2**22
    finally:
        tracemalloc.stop()


def test_quads_are_those_of_the_camera_as_far_as_it_is_known() -> None:
    typed = Config(camera=CameraConfig(frame_quads=(100, 50)))
    assert count_frame_quads(typed, GRID) == 5000
    per_cell = Config(camera=CameraConfig(quads_per_cell=3))
    assert count_frame_quads(per_cell, GRID) == 9 * 12
    mapped = CameraConfig(driver="gphoto2", place=Placing(map=Map.filling((70, 30))))
    assert count_frame_quads(Config(camera=mapped), GRID) == 2100
    assert count_frame_quads(Config(camera=CameraConfig(driver="gphoto2")), GRID) == 3_100_000
