"""Options of the PTP drivers by themselves, and downloads: read twice, kept whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from drivers.ptp import files
from drivers.ptp.codes import Operation, Property
from drivers.ptp.events import ObjectAdded
from drivers.ptp.options import PtpOptions
from drivers.ptp.readout import PtpReadout
from drivers.ptp.shutter import PtpShutter
from drivers.virtual_camera import BULB_BODY, CameraModel
from pdcd.bench.devices import CameraSettings
from pdcd.errors import ConfigError, DeviceLost, ExposureError
from pdcd.sensor.profile import load_profile
from tests.ptp_rig import PHOTO_B, SETTINGS, PtpRig


def read(**given: Any) -> PtpOptions:
    return msgspec.convert(given, PtpOptions)


def test_what_is_not_said_is_the_only_canon_read_twice() -> None:
    made = read()
    assert (made.usb, made.id, made.serial, made.release) == ("libusb", None, None, "auto")
    assert (made.destination, made.read_twice, made.usb_id) == ("ram", True, None)
    with pytest.raises(AttributeError):
        made.serial = "1"  # type: ignore[misc]
    with pytest.raises(TypeError):
        PtpOptions("virtual")  # type: ignore[call-arg]
    with pytest.raises(msgspec.ValidationError, match="port"):
        read(port="usb")


@pytest.mark.parametrize(
    ("given", "numbers"), [("04a9:3145", (0x04A9, 0x3145)), ("FFFF:0010", (0xFFFF, 0x10))]
)
def test_a_usb_id_is_two_numbers_of_four_digits(given: str, numbers: tuple[int, int]) -> None:
    assert read(id=given).usb_id == numbers
    for wrong in ("4a9:3145", "04a9:31455", "04a93145", "04g9:3145"):
        with pytest.raises(msgspec.ValidationError, match="id"):
            read(id=wrong)


@pytest.fixture
def rig() -> Iterator[PtpRig]:
    rig = PtpRig()
    rig.connect()
    yield rig
    rig.disconnect_quietly()


def waiting(rig: PtpRig) -> ObjectAdded:
    """Expose; the photo that waits in the camera."""
    rig.expose()
    rig.wait(1.0)
    rig.camera.poll()
    return rig.camera.files.popleft()


def reads(rig: PtpRig) -> list[tuple[int, ...]]:
    """Where, and how much, is asked for of files from now on."""
    asked: list[tuple[int, ...]] = []
    transact = rig.body.transact

    def heard(code: int, parameters: tuple[int, ...] = (), data: bytes = b"") -> Any:
        if code in (Operation.GET_PARTIAL_OBJECT, Operation.EOS_GET_PARTIAL_OBJECT):
            asked.append(parameters[1:3])
        return transact(code, parameters, data)

    rig.body.transact = heard  # type: ignore[method-assign]
    return asked


@pytest.mark.parametrize("twice", [True, False])
def test_a_photo_is_read_in_blocks_of_a_mib_and_twice_unless_told(
    rig: PtpRig, tmp_path: Path, twice: bool
) -> None:
    photo = waiting(rig)
    asked = reads(rig)
    raw = files.store_photo(rig.camera, photo, tmp_path / "a.cr2", twice=twice)
    assert asked == [(0, 1 << 20), (1 << 20, PHOTO_B - (1 << 20))] * (2 if twice else 1)
    assert raw is not None and rig.is_photo_of(raw, rig.body.shutter.exposures[-1])
    assert [path.name for path in tmp_path.iterdir()] == ["a.cr2"]
    assert not rig.body.store.files  # its memory is free again


def test_every_block_of_a_photo_is_a_sign_of_life(rig: PtpRig, tmp_path: Path) -> None:
    """On a slow bus all of them take longer than the daemon's watchdog waits."""
    photo = waiting(rig)
    asked = reads(rig)
    lived: list[int] = []
    rig.camera.tell_alive = lambda: lived.append(len(asked))
    files.store_photo(rig.camera, photo, tmp_path / "a.cr2")
    assert lived == [0, 1, 2, 3]


def test_a_second_reading_that_differs_is_no_photo(
    rig: PtpRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photo = waiting(rig)
    digests = iter(["a", "b"])
    monkeypatch.setattr(files, "_copy", lambda *_: next(digests))
    with pytest.raises(ExposureError, match="a second reading differs"):
        files.store_photo(rig.camera, photo, tmp_path / "a.cr2")
    assert not list(tmp_path.iterdir())
    assert rig.body.store.files  # nothing was said to be complete


def test_a_photo_whose_session_ended_meanwhile_is_refused(rig: PtpRig, tmp_path: Path) -> None:
    photo = waiting(rig)
    order = rig.camera.order

    def renewing(code: Operation, *params: int, **more: Any) -> Any:
        rig.camera.session.renewed += 1
        return order(code, *params, **more)

    rig.camera.order = renewing  # type: ignore[method-assign]
    with pytest.raises(ExposureError, match="the connection was lost meanwhile"):
        files.store_photo(rig.camera, photo, tmp_path / "a.cr2")


def test_a_readout_says_what_the_camera_says(rig: PtpRig) -> None:
    info = rig.readout.connect()
    config = rig.context.config.camera
    assert (info.model, info.profile) == ("Canon EOS 450D", config.profile)
    assert info.isos == (100, 200, 400, 800, 1600)
    assert info.f_numbers[0] == 5.6 and info.f_numbers[-1] == 32.0
    assert info.frame_quads is None  # a body that is not there has films of any size
    real = PtpReadout(rig.camera, rig.clock, config)
    rig.camera.options = msgspec.structs.replace(rig.camera.options, usb="libusb")
    assert real.connect().frame_quads == load_profile(config.profile).frame_quads


def test_a_photo_that_waits_is_thrown_away_before_the_next_exposure(rig: PtpRig) -> None:
    rig.expose()
    rig.wait(1.0)
    before_ns = rig.clock.now_ns()
    rig.readout.arm(SETTINGS)
    assert rig.clock.now_ns() - before_ns < 10**9  # it was there, and nothing is waited for
    assert not rig.body.store.files and not rig.camera.bulb.owed


def test_arming_sets_what_is_asked_for(rig: PtpRig) -> None:
    rig.readout.arm(CameraSettings(400, 11.0))
    settings = rig.body.settings
    assert (settings.iso, settings.f_number, settings.bulb) == (400, 11.0, True)
    rig.readout.arm(CameraSettings(100, None))
    assert (settings.iso, settings.f_number) == (100, 11.0)  # the lens is left alone
    assert settings[Property.CAPTURE_DESTINATION] == 4


def test_a_lost_camera_is_let_go_of_and_its_guard_not_waited_for(rig: PtpRig) -> None:
    rig.readout.arm(SETTINGS)
    rig.shutter.open()
    rig.body.unplug()
    with pytest.raises(DeviceLost):
        rig.shutter.disconnect()
    with pytest.raises(DeviceLost, match="no camera was found"):  # it may be exposing still
        rig.readout.disconnect()
    assert not rig.camera.session.is_open
    assert PtpShutter.maturity == "experimental"


def test_an_aperture_that_cannot_be_set_from_here_is_left_out() -> None:
    rig = PtpRig(model=CameraModel(BULB_BODY.info, apertures=()))
    rig.connect()
    with pytest.raises(ConfigError, match=r"f/8 is not offered \(it cannot be set from here"):
        rig.readout.arm(SETTINGS)
    rig.readout.arm(CameraSettings(100, None))
    rig.disconnect_quietly()
