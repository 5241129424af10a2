"""Whole captures with the camera on GigE Vision: photos are the mock camera's, every sample, and
what goes wrong on the way costs an exposure or the job, and never a wrong picture."""

from __future__ import annotations

import pytest

pytest.importorskip("drivers.virtual_genicam.bench", reason="Aravis IS MISSING (libaravis-0.8-0)")

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from drivers.genicam.camera import GenicamCamera
from drivers.virtual_genicam.bench import HostedCamera
from drivers.virtual_genicam.camera import VirtualGenicamCamera
from pdcd.bench.tables import CameraConfig, DisplayConfig, FaultsConfig, TriggerConfig
from pdcd.capture.engine import Engine
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.sensor.raw import read_raw
from pdcd.words import KeepRawName
from tests import bench_rig
from tests.genicam_rig import needs_aravis, turn

pytestmark = [needs_aravis, pytest.mark.whole]

REQUEST = CaptureRequest(goal="indirect", codes=16)


@pytest.fixture(autouse=True)
def _alone() -> Iterator[None]:
    with turn():
        yield


def engine_of(
    folder: Path,
    driver: str,
    options: dict[str, Any],
    profile: str = "modern",
    keep: KeepRawName = "all",
    **tables: Any,
) -> Engine:
    folder.mkdir()
    camera = CameraConfig(
        driver=driver, noise="none", f_number=8.0, options=options, profile=profile, keep=keep
    )
    engine = Engine(
        bench_rig.config(
            folder,
            camera=camera,
            trigger=TriggerConfig(driver=driver, lag_s=0.001, jitter_s=0.0),
            **tables,
        )
    )
    engine.start()
    return engine


def virtual_of(engine: Engine) -> VirtualGenicamCamera:
    camera = GenicamCamera.of(engine._rig._context)
    assert isinstance(camera, HostedCamera)
    return camera.virtual


def take(engine: Engine, job: str = "job") -> CaptureResult:
    try:
        return bench_rig.capture(engine, REQUEST, job)
    finally:
        engine.stop()


def photos(result: CaptureResult) -> dict[str, Any]:
    assert result.folder is not None
    return {path.name: read_raw(path) for path in sorted((Path(result.folder) / "raw").iterdir())}


@pytest.mark.parametrize(
    ("profile", "names"),
    [
        ("modern", ("BayerRG16", "BayerBG16", "BayerGR16", "BayerGB16")),
        ("mono", ("Mono12p", "Mono16")),
    ],
)
def test_photos_are_those_of_the_mock_camera(
    profile: str, names: tuple[str, ...], tmp_path: Path
) -> None:
    expected = photos(take(engine_of(tmp_path / "mock", "mock", {}, profile)))
    assert {"white.dng", "coded.dng"} <= set(expected)
    for name in names:
        engine = engine_of(tmp_path / name, "virtual-genicam", {"pixel_format": name}, profile)
        result = take(engine)
        assert result.state == "done", result.error
        found = photos(result)
        assert set(found) == set(expected)
        for photo, frame in found.items():
            assert np.array_equal(frame.samples, expected[photo].samples)
            assert frame.white == expected[photo].white
            assert np.array_equal(frame.black, expected[photo].black)
            # Longer by the margin, in which panels were black.
            assert frame.exposure_s > expected[photo].exposure_s


def test_photos_that_are_not_kept_need_no_file(tmp_path: Path) -> None:
    """Nothing is written but the run, and of that nothing has a photo in it."""
    written: list[str] = []
    hears = [True]

    def hear(event: str, words: tuple[Any, ...]) -> None:
        # A hook stays for good: it must cost nothing afterwards.
        if hears and event == "open" and isinstance(words[0], str | bytes | int):
            mode, flags = words[1] or "", words[2] or 0
            if set(mode) & set("wax+") or flags & (os.O_WRONLY | os.O_RDWR):
                written.append(os.fsdecode(words[0]) if not isinstance(words[0], int) else "")

    engine = engine_of(tmp_path / "none", "virtual-genicam", {}, keep="none")
    sys.addaudithook(hear)
    result = take(engine)
    hears.clear()
    assert result.state == "done" and result.folder is not None, result.error
    names = {Path(path).name for path in written if path}
    assert {"frames.csv", "probe.npz", "indirect.tif"} <= names
    assert not [name for name in names if name.endswith((".dng", ".raw"))]
    assert list((Path(result.folder) / "raw").iterdir()) == []
    known = {path.name for path in Path(result.folder).rglob("*")}
    assert {name.removesuffix(".new").removesuffix(".tmp") for name in names} <= known, names


def test_a_photo_that_was_lost_is_taken_again(tmp_path: Path) -> None:
    engine = engine_of(tmp_path / "lost", "virtual-genicam", {})
    virtual = virtual_of(engine)
    send = virtual._send
    lost: list[bool] = []

    def losing(*words: Any) -> None:
        if len(lost) % 2 == 1:  # the first frame looks for black
            lost.append(False)
            send(*words)
            return
        lost.append(True)
        if len(lost) == 1:
            send(*words)

    virtual._send = losing  # type: ignore[assignment,method-assign]
    camera = GenicamCamera.of(engine._rig._context)
    camera.options = msgspec.structs.replace(camera.options, wait_s=0.5)  # for what never comes
    result = take(engine)
    assert result.state == "done", result.error
    assert lost.count(True) > 2
    expected = photos(take(engine_of(tmp_path / "mock", "mock", {})))
    found = photos(result)
    for name in ("white.dng", "coded.dng"):
        assert np.array_equal(found[name].samples, expected[name].samples)


def test_panels_that_are_late_cost_an_exposure(tmp_path: Path) -> None:
    late = DisplayConfig(faults=FaultsConfig(late={"3": 60}, exposures=1))
    engine = engine_of(tmp_path / "late", "virtual-genicam", {}, display=late)
    result = take(engine)
    assert result.state == "done", result.error
    assert any("the panels were done" in line for line in result.warnings)


def test_a_camera_that_dies_ends_the_job_and_panels_are_black(tmp_path: Path) -> None:
    engine = engine_of(tmp_path / "dead", "virtual-genicam", {})
    virtual = virtual_of(engine)
    virtual.faults.killed_after_s = 0.2
    try:
        result = bench_rig.capture(engine, REQUEST, "first")
        assert result.state == "failed" and result.error is not None
        assert result.error["kind"] == "device_lost"
        bench = bench_rig.bench_of(engine)
        assert bench_rig.are_panels_black(bench)
        again = bench_rig.capture(engine, REQUEST, "second")
        assert again.state == "done", again.error
    finally:
        engine.stop()
