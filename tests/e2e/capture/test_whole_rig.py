"""The bench of cable release and EOS body, through the daemon, beside the bench of mocks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import CameraConfig, TriggerConfig
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from tests import bench_rig, whole_rig
from tests.taken import capture_on

REQUEST = CaptureRequest(goal="indirect", codes=16, black_level="none")


def images(result: CaptureResult) -> dict[str, NDArray[Any]]:
    assert result.state == "done" and result.folder is not None, result.error
    with np.load(Path(result.folder) / "probe.npz") as data:
        return {name: np.asarray(data[name]) for name in data.files}


@pytest.mark.parametrize("cable", [whole_rig.BLIND, whole_rig.CABLE], ids=["blind", "contact"])
def test_the_answer_is_that_of_the_mocks(tmp_path: Path, cable: TriggerConfig) -> None:
    """To the last bit; with the flash contact as well as whole nanoseconds allow.

    On a virtual clock both benches show the same refreshes for the same times. Only the contact,
    which is looked at once a millisecond, moves all of them against the grid of 1/60 s: a refresh
    then begins up to 1 ns elsewhere, of 16 666 667.
    """
    (tmp_path / "mock").mkdir()
    (tmp_path / "rig").mkdir()
    mocks = CameraConfig(noise="none", f_number=8.0)
    expected = images(capture_on(bench_rig.config(tmp_path / "mock", camera=mocks), REQUEST))
    config = bench_rig.config(tmp_path / "rig", **whole_rig.tables(trigger=cable))
    with whole_rig.served(config) as rig:
        with rig.client() as client:
            result = client.capture(REQUEST)
        found = images(result)
        photos = len(read_manifest(Path(str(result.folder))).run.shots)
        assert rig.body.shutter.opened == photos == sum(rig.line.levels("rts"))
        assert not rig.body.shutter.is_open and rig.body.store.in_ram == 0
    assert not rig.body.session_open and rig.line.opened == 1
    assert found.keys() == expected.keys()
    for name in expected:
        if cable is whole_rig.BLIND or found[name].dtype.kind != "f":
            np.testing.assert_array_equal(found[name], expected[name], err_msg=name)
        else:
            # Exact codes: what is left of their error is that of sums of squares, some 1e-9.
            atol = 1e-8 if name == "sigma_code" else 1e-12
            np.testing.assert_allclose(
                found[name], expected[name], rtol=1e-6, atol=atol, err_msg=name
            )


def test_the_manifest_names_every_device(tmp_path: Path) -> None:
    with whole_rig.served(bench_rig.config(tmp_path, **whole_rig.tables())) as rig:
        with rig.client() as client:
            result = client.capture(CaptureRequest(goal="white", codes=4))
    manifest = read_manifest(Path(str(result.folder)))
    assert manifest.drivers["camera"]["model"] == "Canon EOS 450D"
    assert manifest.drivers["shutter"]["model"] == "serial shutter"
    assert manifest.drivers["shutter"]["feedback"] == "cts"
    assert {drv["name"] for drv in manifest.drivers["drivers"].values()} == {
        "mock",
        "serial",
        "ptp",
    }


def test_a_cable_that_is_pulled_out_fails_the_job_and_no_other(tmp_path: Path) -> None:
    with whole_rig.served(bench_rig.config(tmp_path, **whole_rig.tables())) as rig:
        listener, rig.line.on_edge = rig.line.on_edge, lambda _: None
        with rig.client() as client:
            result = client.capture(REQUEST)
            assert result.state == "failed" and result.error is not None
            assert result.error["kind"] == "exposure" and "CTS" in str(result.error)
            assert rig.body.shutter.opened == 0
            rig.line.on_edge = listener
            assert client.capture(REQUEST).state == "done"


@pytest.mark.parametrize("measured", [None, (4.8e6, 8.6e6, 5.6e6)])
def test_a_real_camera_of_unknown_responsivity_is_remarked_on(
    tmp_path: Path, measured: tuple[float, float, float] | None
) -> None:
    camera = msgspec.structs.replace(whole_rig.BODY, responsivity_e=measured)
    scene = msgspec.structs.replace(bench_rig.matrix_scene(tmp_path), grid=bench_rig.GRID)
    config = bench_rig.config(tmp_path, **whole_rig.tables(camera=camera, scene=scene))
    with whole_rig.served(config) as rig, rig.client() as client:
        rig.engine._rig._context.shared.scene = None  # as on a bench that nobody simulates
        result = client.capture(msgspec.structs.replace(REQUEST, white=False))
    assert result.state == "done", result.error
    warnings = read_manifest(Path(str(result.folder))).warnings
    assert any("responsivity_e" in warning for warning in warnings) is (measured is None)
