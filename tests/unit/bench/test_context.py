"""What drivers of one rig share by their context."""

from __future__ import annotations

import pytest

from drivers.virtual_camera import VirtualUsb
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError, DriverUnavailable


class Camera:
    """Used by two drivers."""


class OtherCamera(Camera):
    """Another class, so another instance."""


def context() -> DriverContext:
    return DriverContext(Config(), VirtualClock())


def test_two_drivers_of_a_rig_get_one_camera() -> None:
    rig = context()
    camera = rig.the(Camera, Camera)
    assert rig.the(Camera, lambda: pytest.fail("made twice")) is camera
    assert rig.the(OtherCamera, OtherCamera) is not camera


def test_what_could_not_be_made_is_tried_again() -> None:
    def fail() -> Camera:
        raise ConfigError("no such camera")

    rig = context()
    with pytest.raises(ConfigError, match="no such camera"):
        rig.the(Camera, fail)
    assert isinstance(rig.the(Camera, Camera), Camera)


def test_the_usb_is_what_the_first_driver_names() -> None:
    rig = context()
    assert rig.usb_backend() is None and rig.usb_backend("libusb") is None
    virtual = rig.usb_backend("virtual")
    assert isinstance(virtual, VirtualUsb)
    assert rig.usb_backend("virtual") is virtual
    assert rig.usb_backend() is virtual, "all devices of a rig are on one USB"
    assert rig.shared.usb_backend is virtual


def test_a_usb_that_nobody_brings() -> None:
    with pytest.raises(DriverUnavailable, match=r"'acme'.*virtual"):
        context().usb_backend("acme")
