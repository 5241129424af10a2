"""Templates and examples of docs/new-driver.md, as they stand: each template under the contract of
its roles."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench import registry
from pdcd.bench.devices import CameraInfo, CameraSettings
from pdcd.bench.tables import DisplayConfig, PanelConfig, TriggerConfig
from pdcd.capture.rig import Rig
from pdcd.errors import ConfigError, DeviceLost, PhotoError
from pdcd.panels.placing import Placing
from pdcd.testing import DisplayContract, ReadoutContract, ShutterContract
from tests import bench_rig
from tests.fake_serial import FakeLine, fake_line
from tests.panel_pixels import planned, random_frames, upright
from tests.places import ROOT

PAGE = ROOT / "docs" / "new-driver.md"
OPTIONS = {"port": "line://box"}


def block(word: str) -> str:
    """The one block of Python on the page that has it."""
    found = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    (code,) = (code for code in found if word in code)
    return str(code)


def run_block(word: str) -> dict[str, Any]:
    """What that block defines."""
    names: dict[str, Any] = {"__name__": __name__}
    exec(compile(block(word), str(PAGE), "exec", dont_inherit=True), names)
    return names


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The templates, known as `serial-box`, `acme` and `acme-panels`; a library of Acme's with one
    camera and one pair of panels."""
    made = ("serial_box", "acme_camera", "acme_panels")
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "drivers"))
    acme = ModuleType("acme")
    acme.Device, acme.open_camera = AcmeDevice, AcmeDevice  # type: ignore[attr-defined]
    acme.Panels, acme.open_panels = AcmeController, AcmeController  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "acme", acme)
    known = {
        ("shutter", "serial-box"): "serial_box:SerialBox",
        ("shutter", "acme"): "acme_camera:AcmeShutter",
        ("readout", "acme"): "acme_camera:AcmeReadout",
        ("display", "acme-panels"): "acme_panels:AcmePanels",
    }
    monkeypatch.setattr(registry, "DRIVERS", {**registry.DRIVERS, **known})
    yield
    for module in made:
        sys.modules.pop(module, None)


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
    names = run_block("def pictures(")
    turned = PanelConfig(size_px=(40, 30), place=Placing(turn_deg=180.0))
    config = bench_rig.config(tmp_path, projector=turned, mask=PanelConfig(size_px=(60, 45)))
    frames = random_frames((5, 4), "quarter", 8)
    projector, mask = names["pictures"](Rig(config)._context, frames, 1)
    upright_px = planned(frames, 1, upright((40, 30), mask=False))
    np.testing.assert_array_equal(projector, upright_px[::-1, ::-1])
    np.testing.assert_array_equal(mask, planned(frames, 1, upright((60, 45), mask=True)))


class AcmeDevice:
    """What Acme's library knows of its one camera: every other sample of a row is lit."""

    def __init__(self, serial: str) -> None:
        if serial != "7":
            raise OSError("no such camera")
        self.frames: list[NDArray[np.uint16]] = []
        self.exposes = False
        self.gain = 0.0

    def set(self, feature: str, value: float) -> None:
        assert feature == "Gain"
        self.gain = value

    def start(self, seconds: float) -> None:
        self.exposes = True
        samples = np.full((24, 32), 64 + round(100 * seconds), np.uint16)
        samples[:, 1::2] = 64
        self.frames.append(samples)

    def stop(self) -> None:
        self.exposes = False
        self.frames.clear()

    def frame(self) -> NDArray[np.uint16] | None:
        return self.frames.pop() if self.frames else None

    def drop(self) -> None:
        self.frames.clear()

    def temperature(self) -> float:
        return 31.4

    def close(self) -> None:
        self.frames.clear()


@pytest.mark.usefixtures("driver")
class OfAcme:
    config: ClassVar[Mapping[str, Any] | Path | str] = {
        "trigger": {"driver": "acme", "options": {"serial": "7"}},
        "camera": {"driver": "acme", "f_number": 8.0},
    }


class TestCameraTemplateShutter(OfAcme, ShutterContract):
    """Exposures that the camera ends."""


class TestCameraTemplateReadout(OfAcme, ReadoutContract):
    """Samples in memory."""

    def test_samples_are_where_their_colours_say(
        self, rig: Rig, info: CameraInfo, tmp_path: Path
    ) -> None:
        self.expose(rig, info)
        frame = self.fetch(rig, info, tmp_path)
        lit = [bool(plane.any()) for plane in frame.planes]  # R, G1, G2, B of BGGR
        assert (frame.pattern, frame.model, lit) == (
            "BGGR",
            "Acme One",
            [False, True, False, True],
        )

    def test_panels_that_outlast_the_exposure(
        self, rig: Rig, info: CameraInfo, tmp_path: Path
    ) -> None:
        rig.readout.arm(CameraSettings(100, None))
        rig.shutter.expect_exposure(0.5, 30.0)  # type: ignore[attr-defined]
        opened = rig.shutter.open()
        rig.clock.sleep_until_ns(opened + 700_000_000)
        rig.shutter.close()
        with pytest.raises(PhotoError, match="panels were done"):
            rig.readout.fetch(tmp_path, "photo", 1.0)


class AcmeController:
    """What Acme's library knows of its one pair of panels; each picture takes a refresh."""

    sizes_px, refresh_hz = ((64, 48), (80, 60)), 120.0
    clock: ClassVar[Any] = None
    lit: ClassVar[bool] = False
    stalls: ClassVar[set[int]] = set()

    def __init__(self, serial: str) -> None:
        if serial != "3":
            raise OSError("no such controller")
        self.shown: list[tuple[NDArray[np.uint8], NDArray[np.uint8]]] = []

    def show(self, projector: NDArray[np.uint8], mask: NDArray[np.uint8]) -> None:
        AcmeController.lit = bool(projector.any() or mask.any())
        refreshes = 4 if len(self.shown) in self.stalls else 1
        self.shown.append((projector, mask))
        wait_ns = round(1e9 * refreshes / self.refresh_hz)
        self.clock.sleep_until_ns(self.clock.now_ns() + wait_ns)

    def show_black(self) -> None:
        AcmeController.lit = False

    def close(self) -> None:
        self.show_black()


class TestPanelsTemplate(DisplayContract):
    """And what is the template's own."""

    @pytest.fixture
    def rig(self, tmp_path: Path, driver: None) -> Iterator[Rig]:
        projector, mask = (PanelConfig(size_px=size) for size in AcmeController.sizes_px)
        display = DisplayConfig(driver="acme-panels", options={"serial": "3"})
        rig = Rig(bench_rig.config(tmp_path, display=display, projector=projector, mask=mask))
        AcmeController.clock, AcmeController.stalls = rig.clock, set()
        rig.display.connect()
        yield rig
        rig.display.disconnect()

    def find_lit(self, rig: Rig) -> bool:
        return AcmeController.lit

    def test_each_row_is_drawn_where_the_configuration_places_it(self, rig: Rig) -> None:
        frames = random_frames((5, 4), "quarter", 8)
        rig.display.load(frames)
        log = rig.display.play(lambda *_: None, lambda: False)
        shown = rig.display._device.shown  # type: ignore[attr-defined]
        assert len(shown) - 1 == len(frames) == len(log.missed)
        assert not np.any(shown[-1][0]) and not np.any(shown[-1][1])
        for row, pictures in enumerate(shown[:-1]):
            for picture, size_px, mask in zip(
                pictures, AcmeController.sizes_px, (False, True), strict=True
            ):
                wanted = planned(frames, row, upright(size_px, mask=mask))
                np.testing.assert_array_equal(picture, wanted)

    def test_a_late_picture_is_logged(self, rig: Rig) -> None:
        AcmeController.stalls = {3}
        frames = random_frames((5, 4), "quarter", 8)
        rig.display.load(frames)
        log = rig.display.play(lambda *_: None, lambda: False)
        assert log.missed[3] == 3 and not log.verified

    def test_panels_that_are_not_there(self, driver: None, tmp_path: Path) -> None:
        display = DisplayConfig(driver="acme-panels", options={"serial": "4"})
        with pytest.raises(DeviceLost, match="no panels 4"):
            Rig(bench_rig.config(tmp_path, display=display)).display.connect()


TestOnThePage = pytest.mark.usefixtures("driver")(run_block("class TestSerialBox")["TestSerialBox"])
