"""Packets that are lost, and a camera that dies at any moment: a few here, all of them long."""

from __future__ import annotations

import pytest

pytest.importorskip("drivers.virtual_genicam.bench", reason="Aravis IS MISSING (libaravis-0.8-0)")

import secrets
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.genicam.camera import GenicamCamera
from drivers.genicam.device import GenicamDevice
from drivers.virtual_genicam.camera import CameraFaults
from drivers.virtual_genicam.simulator import VIRTUAL_ADDRESS
from pdcd.bench.clock import VirtualClock
from pdcd.driver import DeviceLost
from tests import bench_rig
from tests.genicam_rig import client, needs_aravis, turn
from tests.genicam_trials import (
    REQUEST,
    find_virtual,
    make_engine,
    read_photos,
    run_trials,
)

pytestmark = needs_aravis


def photograph_by_mock(folder: Path) -> dict[str, NDArray[Any]]:
    engine = make_engine(folder / "mock", "mock")
    try:
        return read_photos(bench_rig.capture(engine, REQUEST))
    finally:
        engine.stop()


@pytest.mark.whole
@pytest.mark.parametrize(
    ("kills", "captures"),
    [(2, 1), pytest.param(50, 20, marks=[pytest.mark.long, pytest.mark.timeout(3600)])],
)
def test_no_photo_is_wrong_whatever_happens(kills: int, captures: int, tmp_path: Path) -> None:
    trials = run_trials(tmp_path, kills=kills, captures=captures, seed=secrets.randbelow(2**31))
    assert sum(sum(ended.values()) for ended in trials.ended.values()) >= 2 * kills + 3 * captures


@pytest.mark.whole
def test_a_camera_that_is_restarted_while_it_is_armed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with turn():
        engine = make_engine(tmp_path, "virtual-genicam")
        virtual, set_exposure, restarts = find_virtual(engine), GenicamDevice.set_exposure, [True]

        def restarting(device: GenicamDevice, exposure_s: float) -> float:
            if restarts:
                restarts.pop()
                virtual.stop()
                virtual.start()
            return set_exposure(device, exposure_s)

        monkeypatch.setattr(GenicamDevice, "set_exposure", restarting)
        try:
            result = bench_rig.capture(engine, REQUEST)
            assert result.state == "done", result.error
            assert not restarts and bench_rig.are_panels_black(bench_rig.bench_of(engine))
        finally:
            engine.stop()


@pytest.mark.parametrize("faults", [CameraFaults(swapped=True), CameraFaults(left=2)])
def test_samples_that_come_otherwise_are_the_same_photos(
    faults: CameraFaults, tmp_path: Path
) -> None:
    """Bytes the wrong way round, of which a dark frame of one value tells nothing; and 14 bits that
    lie on the left of 16."""
    expected = photograph_by_mock(tmp_path)
    with turn():
        engine = make_engine(tmp_path / "camera", "virtual-genicam", pixel_format="BayerRG16")
        find_virtual(engine).faults = faults
        try:
            result = bench_rig.capture(engine, REQUEST)
        finally:
            engine.stop()
    assert result.state == "done", result.error
    found = read_photos(result)
    assert set(found) == set(expected)
    for name, samples in found.items():
        assert np.array_equal(samples, expected[name] << faults.left)


@pytest.mark.whole
def test_other_programs_in_the_midst_of_a_capture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that would have the camera is told that it is held, and one that triggers it, too, makes
    no second frame."""
    expected = photograph_by_mock(tmp_path)
    with turn():
        engine = make_engine(tmp_path / "camera", "virtual-genicam")
        virtual, begin = find_virtual(engine), GenicamCamera.begin
        refused: list[str] = []

        def disturbed(camera: GenicamCamera) -> int:
            begun_ns = begin(camera)
            if not refused:
                with pytest.raises(DeviceLost) as told:
                    client(VirtualClock()).open("readout")
                refused.append(str(told.value))
            camera.device.trigger()
            return begun_ns

        monkeypatch.setattr(GenicamCamera, "begin", disturbed)
        try:
            result = bench_rig.capture(engine, REQUEST)
        finally:
            engine.stop()
    assert result.state == "done", result.error
    assert virtual.missed > 0
    assert VIRTUAL_ADDRESS in refused[0] and "held by another program" in refused[0]
    found = read_photos(result)
    assert set(found) == set(expected)
    for name, samples in found.items():
        assert np.array_equal(samples, expected[name])
