"""Drivers of another package that do more than they must: samples in memory, times told, no
colours."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import pdcd
from pdcd.bench.config import load_config
from pdcd.capture.engine import Engine
from pdcd.errors import ConfigError
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.manifest import MANIFEST
from pdcd.runs.verify import read_sound_manifest
from pdcd.sensor.raw import read_raw
from tests import bench_rig
from tests.e2e.drivers.test_stranger_bench import config as strangers_config
from tests.places import ROOT

config = strangers_config


@pytest.fixture(autouse=True)
def second_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tests" / "data" / "stranger_samples"))


def engine_of(file: Path, camera: str, **rig: Any) -> Engine:
    found = load_config(file)
    replace = msgspec.structs.replace
    return Engine.from_config(
        replace(
            found,
            camera=replace(found.camera, driver=camera),
            trigger=replace(found.trigger, driver="stranger-timed"),
            rig=replace(found.rig, **rig),
        )
    )


@pytest.fixture
def engine(config: Path) -> Iterator[Engine]:
    made = engine_of(config, "stranger-samples")
    made.start()
    yield made
    made.stop()


def test_samples_in_memory_become_a_run_like_any_other(engine: Engine) -> None:
    result = bench_rig.capture(engine, CaptureRequest(goal="direct", codes=64))
    assert result.state == "done", result.error
    folder = Path(str(result.folder))
    read_sound_manifest(folder, ())
    run = pdcd.open(folder)
    steps = np.repeat([0.2, 0.4, 0.6, 0.8], 2)[None, :, None]
    assert np.abs(run.image / steps - 1.0).max() < 0.02
    files = sorted((folder / "raw").iterdir())
    assert files and {file.suffix for file in files} == {".dng"}
    for file in files:
        frame = read_raw(file)
        assert (frame.pattern, frame.iso, frame.model) == ("GBRG", 100, "Stranger One")
        assert b'"PixelFormat": "BayerGB12"' in file.read_bytes()
        assert file.name in (folder / MANIFEST).read_text()


def test_camera_and_shutter_are_told_how_long_each_exposure_will_be(engine: Engine) -> None:
    result = bench_rig.capture(engine, CaptureRequest(goal="white"))
    assert result.state == "done", result.error
    rig = engine._rig
    armed, told = rig.readout.armed, rig.shutter.told  # type: ignore[attr-defined]
    assert [(s.exposure_s, s.longest_s) for s in armed] == list(told) and told
    (shot,) = json.loads((Path(str(result.folder)) / MANIFEST).read_text())["run"]["shots"]
    lasted_s = (shot["close_ns"] - shot["open_ns"]) * 1e-9
    exposure_s, longest_s = max(told)  # the others are looks at the room, and at what leaks
    assert exposure_s == pytest.approx(lasted_s, abs=0.02)
    assert 2.0 * exposure_s < longest_s < 2.0 * exposure_s + 31.0


def test_further_passes_are_in_the_time_that_an_exposure_may_take(config: Path) -> None:
    longest = {}
    for on_miss in ("abort", "balance"):
        made = engine_of(config, "stranger-samples", on_miss=on_miss, retries=3)
        made.start()
        bench_rig.capture(made, CaptureRequest(goal="white"))
        exposure_s, longest[on_miss] = made._rig.shutter.told[0]  # type: ignore[attr-defined]
        made.stop()
    settles_s = 2.0 * load_config(config).rig.settle_s
    shown_s = exposure_s - settles_s
    assert longest["abort"] == pytest.approx(2.0 * shown_s + settles_s + 30.0)
    assert longest["balance"] == pytest.approx(8.0 * shown_s + settles_s + 30.0)


def test_a_sensor_without_colours_makes_runs_of_one_colour(config: Path) -> None:
    made = engine_of(config, "stranger-grey")
    made.start()
    result = bench_rig.capture(made, CaptureRequest(goal="direct", codes=64))
    made.stop()
    assert result.state == "done", result.error
    run = pdcd.open(Path(str(result.folder)))
    steps = np.repeat([0.2, 0.4, 0.6, 0.8], 2)[None, :, None]
    assert run.image.shape == (*run.grid, 1)
    assert np.abs(run.image / steps - 1.0).max() < 0.02


def test_a_mosaic_that_cannot_be_read_is_refused_before_there_is_light(config: Path) -> None:
    made = engine_of(config, "stranger-white")
    with pytest.raises(ConfigError, match="a mosaic RGBW"):
        made.start()
    with pytest.raises(ConfigError, match="a mosaic RGBW"):
        made._rig.look_at_camera()
    assert made._rig.shutter.told == ()  # type: ignore[attr-defined]
