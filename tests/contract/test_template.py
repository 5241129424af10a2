"""Template and examples of docs/new-driver.md, as they are printed there: the template under the
contract of its role."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench import registry
from pdcd.bench.tables import PanelConfig, TriggerConfig
from pdcd.capture.rig import Rig
from pdcd.errors import ConfigError, DeviceLost
from pdcd.panels.placing import Placing
from pdcd.sensor.dng import write_photo_frame
from pdcd.sensor.raw import read_raw
from pdcd.testing import ShutterContract
from tests import bench_rig
from tests.fake_serial import FakeLine, fake_line
from tests.panel_pixels import planned, random_frames, upright
from tests.places import ROOT

PAGE = ROOT / "docs" / "new-driver.md"
OPTIONS = {"port": "line://box"}


def blocks() -> list[str]:
    """All code in Python on the page."""
    return re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)


@pytest.fixture
def driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The last block of Python on the page, known as `serial-box`."""
    code = blocks()[-1]
    (tmp_path / "template_serial_box.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    known = {**registry.DRIVERS, ("shutter", "serial-box"): "template_serial_box:SerialBox"}
    monkeypatch.setattr(registry, "DRIVERS", known)
    yield
    sys.modules.pop("template_serial_box", None)


def make(folder: Path, **options: object) -> Rig:
    trigger = TriggerConfig(driver="serial-box", options={**OPTIONS, **options})
    return Rig(bench_rig.config(folder, trigger=trigger))


def the_line() -> FakeLine:
    from tests.fake_serial.lines import LINES

    return LINES["box"]


class TestTemplate(ShutterContract):
    """And what is the template's own."""

    @pytest.fixture
    def rig(self, tmp_path: Path, driver: None) -> Iterator[Rig]:
        rig = make(tmp_path)
        with fake_line("box", rig.clock) as line:
            rig.shutter.connect()
            yield rig
            line.unplugged = False
            rig.shutter.disconnect()

    def test_the_bytes_of_an_exposure(self, rig: Rig) -> None:
        rig.shutter.open()
        rig.shutter.close()
        rig.shutter.disconnect()
        assert the_line().received == [b"0", b"1", b"0", b"0"]

    def test_a_box_that_is_pulled_out(self, rig: Rig) -> None:
        the_line().unplugged = True
        with pytest.raises(DeviceLost, match="does not answer"):
            rig.shutter.open()

    def test_a_wrong_option(self, driver: None, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match="bauds"):
            make(tmp_path, bauds=1)

    def test_a_port_that_is_not_there(self, driver: None, tmp_path: Path) -> None:
        with pytest.raises(DeviceLost, match="cannot open"):
            make(tmp_path, port="/dev/pdcd-none").shutter.connect()


def test_a_display_of_ones_own_needs_nothing_but_draw(tmp_path: Path) -> None:
    """The example gives each panel its own pixels, where the configuration has placed it."""
    (code,) = (block for block in blocks() if "def pictures(" in block)
    names: dict[str, Any] = {}
    exec(compile(code, str(PAGE), "exec", dont_inherit=True), names)
    turned = PanelConfig(size_px=(40, 30), place=Placing(turn_deg=180.0))
    config = bench_rig.config(tmp_path, projector=turned, mask=PanelConfig(size_px=(60, 45)))
    frames = random_frames((5, 4), "quarter", 8)
    projector, mask = names["pictures"](Rig(config)._context, frames, 1)
    upright_px = planned(frames, 1, upright((40, 30), mask=False))
    np.testing.assert_array_equal(projector, upright_px[::-1, ::-1])
    np.testing.assert_array_equal(mask, planned(frames, 1, upright((60, 45), mask=True)))


def test_samples_as_the_page_hands_them_over_become_a_file(tmp_path: Path) -> None:
    (code,) = (block for block in blocks() if "def photo(" in block)
    names: dict[str, Any] = {}
    exec(compile(code, str(PAGE), "exec", dont_inherit=True), names)
    samples = np.arange(24 * 32, dtype=np.uint16).reshape(24, 32)
    photo = names["photo"](samples, 6.0, 0.25)
    frame = read_raw(write_photo_frame(photo, tmp_path / "photo.dng", "Acme", "7").path)
    assert (frame.pattern, frame.iso, frame.exposure_s, frame.model) == ("BGGR", 200, 0.25, "Acme")
    np.testing.assert_array_equal(frame.samples[3], samples[::2, ::2])  # blue comes first
