"""Whole captures with two DMDs in the place of the mock panels: the same pictures."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import numpy as np
import pytest

import pdcd
from pdcd.bench import registry
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import Config, DisplayConfig, PanelConfig
from pdcd.capture.engine import Engine
from pdcd.protocol.request import CaptureRequest
from tests import bench_rig
from tests.dlpc900_pair import LEAST_US, make_dmds
from tests.dlpc900_rig import ROW_US, SIZE, Dlpc900Rig, ScriptedUsb
from tests.taken import take

GRID = (6, 8)


class ScriptedUsbDriver:
    """The USB of `tests.dlpc900_rig` as a driver of that role."""

    maturity = "experimental"
    devices: Dlpc900Rig

    @classmethod
    def create(cls, context: DriverContext) -> ScriptedUsb:
        cls.devices = Dlpc900Rig(clock=context.clock)
        if context.config.display.options["start"] == "chain":
            cls.devices.dmds[0].wired = cls.devices.dmds[1]
        return cls.devices.usb


def bench(folder: Path, display: DisplayConfig) -> Config:
    panels: dict[str, Any] = {
        "projector": PanelConfig(size_px=SIZE, refresh_hz=1e6 / ROW_US),
        "mask": PanelConfig(size_px=SIZE, refresh_hz=1e6 / ROW_US, skew_s=3e-6),
    }
    folder.mkdir()
    return bench_rig.config(folder, grid=GRID, display=display, **panels)


def photograph(config: Config) -> pdcd.Run:
    engine = Engine(config)
    engine.start()
    shutter = engine._rig.shutter
    opens = shutter.open

    def open_and_trigger() -> int:
        """The camera's output goes up as soon as it exposes."""
        at_ns = opens()
        for dmd in ScriptedUsbDriver.devices.dmds:
            dmd.trigger()
        return at_ns

    if config.display.options.get("start") == "trigger":
        shutter.open = open_and_trigger  # type: ignore[method-assign]
    try:
        result = bench_rig.capture(engine, CaptureRequest(goal="indirect", codes=16, guards="auto"))
    finally:
        engine.stop()
    assert result.state == "done" and result.folder is not None
    return pdcd.open(result.folder)


@pytest.mark.parametrize("start", ["chain", "trigger"])
def test_a_capture_is_that_of_the_mock_panels(
    start: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = ModuleType("scripted_usb")
    vars(module)["ScriptedUsbDriver"] = ScriptedUsbDriver
    monkeypatch.setitem(sys.modules, "scripted_usb", module)
    drivers = {**registry.DRIVERS, ("usb", "scripted"): "scripted_usb:ScriptedUsbDriver"}
    monkeypatch.setattr(registry, "DRIVERS", drivers)
    options = {"projector": "A", "mask": "B", "usb": "scripted", "start": start}
    dmds = DisplayConfig(driver="dlpc900", row_times=True, options=options)
    found = photograph(bench(tmp_path / "dmds", dmds))
    wanted = photograph(bench(tmp_path / "mock", DisplayConfig(row_times=True)))
    np.testing.assert_allclose(found.image, wanted.image, atol=1e-9)
    rows = [
        [line.split(",")[-1] for line in (run.folder / "frames.csv").read_text().splitlines()]
        for run in (found, wanted)
    ]
    assert rows[0] == rows[1] and "3000" in rows[0], "a dark time as long as the mask is late"
    assert all(dmd.black and not dmd.waits for dmd in ScriptedUsbDriver.devices.dmds)


@pytest.mark.whole
@pytest.mark.parametrize("guards", ["auto", "both"])
def test_a_capture_of_128_codes_on_virtual_dmds_is_that_of_the_mock_panels(
    guards: Any, tmp_path: Path
) -> None:
    """What their mirrors showed, against what the mock's panels are told to, on the same scene."""
    panel = PanelConfig(size_px=(192, 144), refresh_hz=1e6 / LEAST_US)
    images = []
    for name, display in (("dmds", make_dmds()), ("mock", DisplayConfig(row_times=True))):
        (tmp_path / name).mkdir()
        config = bench_rig.config(
            tmp_path / name,
            grid=(12, 16),
            display=display,
            projector=panel,
            mask=msgspec.structs.replace(panel, skew_s=2e-6),
        )
        images.append(take(config, codes=128, guards=guards).image)
    assert np.abs(images[1]).max() > 0.0
    np.testing.assert_allclose(images[0], images[1], rtol=0.0, atol=1e-9 * images[1].max())
