"""Numbers of the configuration's tables at the edge of what they may be, and what follows."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from pdcd.bench.tables import (
    DEFAULT_GRID,
    Config,
    DisplayConfig,
    PanelConfig,
    SceneConfig,
    ScheduleConfig,
    TriggerConfig,
)
from pdcd.bench.truth import LARGEST_BLUR, BenchTruth


def table(path: str, value: object) -> dict[str, Any]:
    """The tables of a file with one key."""
    told: Any = value
    for name in reversed(path.split(".")):
        told = {name: told}
    if path.startswith(("projector.", "mask.")) and "size_px" not in path:
        told[path.split(".")[0]]["size_px"] = [1024, 768]
    return dict(told)


BOUNDS: list[tuple[str, object, object]] = [
    # key, the last value that it may have, and the next one
    ("rig.retries", 100, 101), ("rig.settle_s", 0.0, -1e-9), ("mask.size_px", [1, 1], [1, 0]),
    ("mask.refresh_hz", 1e-9, 0.0), ("mask.scan_bands", 16384, 16385), ("mask.gamma", 0.1, 0.09),
    ("mask.gamma", 10.0, 10.1), ("mask.lut", [0.0, 1.0], [0.0, 1.1]),
    ("mask.lut", [0.0] * 256, [0.0] * 257), ("mask.blur_px", 64.0, 64.1),
    ("display.mask_delay_refreshes", 60, 61), ("display.mask_delay_refreshes", -60, -61),
    ("display.planes_per_refresh", 24, 23), ("display.plane_starts", [0.999], [1.0]),
    ("display.faults.late", {"4": 1}, {"4": 0}), ("camera.quads_per_cell", 64, 65),
    ("camera.buckets", 2, 3), ("camera.frame_quads", [16384, 1], [16385, 1]),
    ("camera.responsivity_e", [1.0, 1.0, 1e-9], [1.0, 1.0, 0.0]),
    ("scene.grid", [1, 1], [0, 1]), ("schedule.grid", [1, 1], [1, 0]),
    ("schedule.codes", 65536, 65537), ("calibration.sha256", "f" * 64, "g" * 64),
    ("limits.connections", 1, 0), ("limits.work_bytes", 2**28, 2**28 - 1),
]  # fmt: skip


@pytest.mark.parametrize(("path", "last", "beyond"), BOUNDS)
def test_a_key_of_the_configuration_has_its_bounds(path: str, last: object, beyond: object) -> None:
    msgspec.convert(table(path, last), Config)
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(table(path, beyond), Config)


TRUE_BOUNDS: list[tuple[str, object, object]] = [
    ("mask.falloff", 1.0, 1.01), ("mask.dead_rows", [0], [-1]),
    ("camera.blur_quads", LARGEST_BLUR, 64.1), ("camera.samples", 64, 65),
    ("scene.blur_taps", 15, 16), ("sensor.gain", 1e-9, 0.0), ("sensor.prnu", 0.5, 0.51),
]  # fmt: skip


@pytest.mark.parametrize(("path", "last", "beyond"), TRUE_BOUNDS)
def test_a_key_of_the_truth_has_its_bounds(path: str, last: object, beyond: object) -> None:
    name, key = path.split(".")
    msgspec.convert({name: {key: last}}, BenchTruth)
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({name: {key: beyond}}, BenchTruth)


def test_bit_planes_of_a_refresh_are_even_unless_measured() -> None:
    one = DisplayConfig()
    assert (one.starts, one.plane_shares) == ((0.0,), (1.0,))
    many = DisplayConfig(planes_per_refresh=24)
    assert many.starts == tuple(plane / 24 for plane in range(24))
    assert many.plane_shares == pytest.approx([1.0 / 24] * 24)
    measured = DisplayConfig(planes_per_refresh=24, plane_starts=(0.1, 0.3, 0.9))
    assert measured.starts == (0.1, 0.3, 0.9)
    assert measured.plane_shares == pytest.approx((0.2, 0.6, 0.2))


def test_blades_have_obeyed_after_the_lag_and_four_jitters() -> None:
    assert TriggerConfig(lag_s=0.05, jitter_s=0.01).sure_ns == 90_000_000
    assert TriggerConfig(lag_s=0.0, jitter_s=1e-9 / 3.0).sure_ns == 1


def test_rows_are_counted_by_the_slower_panel_and_its_planes() -> None:
    fast, slow = (PanelConfig(size_px=(8, 8), refresh_hz=hz) for hz in (60.0, 50.0))
    planes = DisplayConfig(planes_per_refresh=24, mask_delay_refreshes=-2)
    assert Config(projector=fast, mask=slow).row_hz == 50.0
    assert Config(projector=slow, mask=fast, display=planes).row_hz == 1200.0
    assert Config(display=planes).mask_delay_rows == -48
    assert Config(display=DisplayConfig(mask_delay_refreshes=3)).mask_delay_rows == 3


def test_code_cells_are_those_of_the_schedule_then_of_the_scene_then_the_usual() -> None:
    typed, scene = ScheduleConfig(grid=(2, 3)), SceneConfig(grid=(4, 5))
    assert Config(schedule=typed, scene=scene).code_grid((6, 7)) == (2, 3)
    assert Config(scene=scene).code_grid((6, 7)) == (6, 7)
    assert Config(schedule=ScheduleConfig(grid="auto"), scene=scene).code_grid() == (4, 5)
    assert Config().code_grid() == DEFAULT_GRID
