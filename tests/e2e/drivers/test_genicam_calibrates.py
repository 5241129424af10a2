"""Calibrations and captures with the camera on GigE Vision, against the mock bench with the same
sensor and the same exposures: every sample of every photo is the same, and so is what follows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.mock.shutter import MockShutter
from pdcd.bench.calibration import Calibration, read_calibration
from pdcd.bench.config import load_config
from pdcd.bench.reading import format_toml
from pdcd.bench.tables import CameraConfig, Config, RigConfig, SceneConfig, TriggerConfig
from pdcd.calibration import steps
from pdcd.capture.engine import Engine
from pdcd.driver import CameraSettings, load_profile
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.sensor.raw import read_raw
from tests import bench_rig
from tests.e2e.calibration.steps_rig import make_config
from tests.e2e.calibration.test_timing import TAUS
from tests.e2e.calibration.test_whole import BENCH, STOPS
from tests.e2e.calibration.timing_rig import MASK_PX, PROJECTOR_PX, QUADS
from tests.genicam_rig import needs_aravis, turn
from tests.places import ROOT

pytestmark = [needs_aravis, pytest.mark.whole]

MARGIN_S, MARGIN = 0.1, 0.1
START_NS = 10_000_000_000
ORDERS = ("BayerRG16", "BayerGR16", "BayerGB16", "BayerBG16")
REQUESTS = (
    CaptureRequest(goal="white", codes=8),
    CaptureRequest(goal="indirect", codes=16),
    CaptureRequest(goal="direct", codes=16),
    CaptureRequest(goal="short-range", radius=1, codes=16),
)
OFF_AXIS = (CaptureRequest(goal="epipolar", codes=16),)


@pytest.fixture(autouse=True)
def _alone() -> Iterator[None]:
    with turn():
        yield


class TimedMockShutter(MockShutter):
    """Closes by a clock that was set before, as the camera does: as planned and a margin, in whole
    microseconds."""

    def expect_exposure(self, exposure_s: float, longest_s: float) -> None:
        self._planned_s = exposure_s

    def close(self) -> int:
        clock, bench = self._clock, self._bench
        if not bench.shutter_open or bench.open_ns is None:
            return clock.now_ns()
        exposure_s = self._planned_s
        if not bench.shared.moving:
            exposure_s += MARGIN_S + MARGIN * exposure_s
        over_ns = bench.open_ns + 1000 * int(1e6 * exposure_s)
        clock.sleep_until_ns(over_ns)
        bench.close_shutter(over_ns)
        return clock.now_ns()


@pytest.fixture(autouse=True)
def _timed_mock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mock camera has that shutter, and its photos are read out at once."""
    monkeypatch.setattr("drivers.mock.MockShutter", TimedMockShutter)
    monkeypatch.setattr("drivers.mock.camera._READOUT_S", 0.0)


def made(config: Config, driver: str, pixel_format: str = "BayerRG16") -> Config:
    """The bench with that camera. It knows black, and spends no time to look for it."""
    options: dict[str, Any] = {}
    if driver != "mock":
        options = {"pixel_format": pixel_format, "margin_s": MARGIN_S, "margin": MARGIN}
        options["black_dn"] = load_profile(config.camera.profile).black_dn
    state = f"{config.server.state_dir}-{driver}-{pixel_format}"
    return msgspec.structs.replace(
        config,
        camera=msgspec.structs.replace(config.camera, driver=driver, options=options),
        trigger=TriggerConfig(driver=driver, lag_s=0.0, jitter_s=0.0),
        server=msgspec.structs.replace(config.server, state_dir=state),
    )


def sort_greens(samples: NDArray[Any]) -> NDArray[Any]:
    """Planes R, G, G, B; which green comes first depends on the row that red is in."""
    return np.stack([samples[0], *np.sort(samples[1:3], axis=0), samples[3]])


def assert_same_photos(found: CaptureResult, expected: CaptureResult) -> int:
    """The same samples in both folders, and the same exposures; how many photos there are."""
    there, here = (Path(str(result.folder)) / "raw" for result in (found, expected))
    names = sorted(path.name for path in here.iterdir())
    assert names and names == sorted(path.name for path in there.iterdir())
    for name in names:
        one, other = read_raw(there / name), read_raw(here / name)
        assert np.array_equal(sort_greens(one.samples), sort_greens(other.samples)), name
        assert (one.white, one.iso) == (other.white, other.iso)
        assert np.array_equal(one.black, other.black)
        assert one.exposure_s == pytest.approx(other.exposure_s, abs=1e-4)
    return len(names)


def begin_alike(engine: Engine) -> None:
    """Have the first frame behind us, and begin at the same time with any camera."""
    engine.start()
    rig = engine._rig
    f_number = engine._config.camera.f_number
    assert not isinstance(f_number, str)
    rig.readout.arm(CameraSettings(100, f_number, exposure_s=0.1))
    rig.clock.sleep_until_ns(START_NS)


def calibrate(config: Config, wanted: tuple[str, ...]) -> CaptureResult:
    engine = Engine.from_config(config)
    begin_alike(engine)
    try:
        result = engine.calibrate(
            msgspec.convert({"steps": wanted}, CalibrateRequest),
            job=make_job_id(),
            emit=lambda event: None,
            cancelled=lambda: False,
        )
    finally:
        engine.stop()
    assert result.state == "done", result.error
    return result


def figures(record: Calibration) -> dict[str, tuple[object, object]]:
    """All but the stop, which a lens that is set by hand does not tell."""
    return {
        f"{step.name} {figure.name}": (figure.value, figure.sigma)
        for step in record.steps
        for figure in step.figures
        if figure.name != "f_number"
    }


def measured(record: Calibration) -> dict[str, tuple[object, object, object]]:
    """What the configuration gets of it, whenever it was measured."""
    return {name: (one.value, one.sigma, one.step) for name, one in record.measured.items()}


def assert_same_calibrations(config: Config, wanted: tuple[str, ...]) -> None:
    results = [calibrate(made(config, driver), wanted) for driver in ("virtual-genicam", "mock")]
    assert assert_same_photos(*results) > 5
    found, expected = (read_calibration(Path(str(result.folder)))[0] for result in results)
    assert [step.name for step in expected.steps] == ["meter", *wanted]
    assert_alike(figures(found), figures(expected))
    assert_alike(measured(found), measured(expected))
    assert found.verdict == expected.verdict


def assert_alike(
    found: Mapping[str, tuple[Any, ...]], expected: Mapping[str, tuple[Any, ...]]
) -> None:
    """The photos are the same to the bit; fits of them in another process are so but for
    rounding."""
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        for one, other in zip(found[name], values, strict=True):
            near = pytest.approx(other, rel=1e-4, abs=1e-9) if isinstance(other, float) else other
            assert one == near, name


def test_times_of_panels_and_of_an_exposure_amid_light_are_measured_alike(tmp_path: Path) -> None:
    config = make_config(
        tmp_path / "bench", TAUS.format(projector="", mask=""), projector_px=PROJECTOR_PX,
        mask_px=MASK_PX, quads=QUADS, placed=True, camera={"f_number": 25.4, "seed": 4},
        scene=SceneConfig(kind="card", grid=(12, 16)),
    )  # fmt: skip
    assert_same_calibrations(config, ("timing", "shutter"))


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_all_steps_find_the_same(tmp_path: Path) -> None:
    # The shutter of a camera that times its exposures has no lag.
    truth, _, trigger = (ROOT / "config" / "truth.toml").read_text().partition("[trigger]")
    assert trigger and "[" not in trigger
    (tmp_path / "truth.toml").write_text(truth)
    path = tmp_path / "bench.toml"
    camera = {**BENCH["camera"], "f_number": STOPS["modern"]}
    path.write_text(format_toml({**BENCH, "camera": camera, "bench": {"truth": "truth.toml"}}))
    assert_same_calibrations(
        load_config(path), tuple(name for name in steps.STEP_SCRIPTS if name not in steps.AT_WISH)
    )


def captured(config: Config, requests: tuple[CaptureRequest, ...]) -> list[CaptureResult]:
    engine = Engine(config)
    begin_alike(engine)
    try:
        taken = [
            bench_rig.capture(engine, request, f"job-{number}")
            for number, request in enumerate(requests)
        ]
    finally:
        engine.stop()
    assert [result.error for result in taken] == [None] * len(requests)
    return taken


@pytest.mark.parametrize("arrangement", ["coaxial", "off-axis"])
def test_every_goal_is_photographed_alike_in_every_order_of_colours(
    arrangement: Literal["coaxial", "off-axis"], tmp_path: Path
) -> None:
    scene = "off-axis-box" if arrangement == "off-axis" else "open-book"
    config = bench_rig.config(
        tmp_path,
        camera=CameraConfig(f_number=8.0),
        rig=RigConfig(arrangement=arrangement),
        scene=SceneConfig(kind=scene, grid=(6, 8)),
    )
    requests = OFF_AXIS if arrangement == "off-axis" else REQUESTS
    expected = captured(made(config, "mock"), requests)
    for order in ORDERS:
        found = captured(made(config, "virtual-genicam", order), requests)
        for one, other in zip(found, expected, strict=True):
            assert_same_photos(one, other)
            assert {**one.summary, "wall_s": 0.0} == {**other.summary, "wall_s": 0.0}
