"""The shutter of a camera and its guardian: armed before it opens, disarmed once it is closed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import pytest

from drivers.ptp import shutter as shutter_module
from drivers.ptp.shutter import PtpShutter
from drivers.virtual_camera import BULB_BODY, CameraBody, FaultScript, PlainFilm, VirtualUsb
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext, SharedState
from pdcd.bench.tables import Config, TriggerConfig
from pdcd.errors import ConfigError, DeviceLost, ExposureError
from tests.virtual_eos import raw_of

SURE_NS = round((0.1 + 4 * 0.02) * 1e9)


class Bench:
    """A camera, its shutter, and a guardian that takes note of what it is told and when."""

    def __init__(self, **options: Any) -> None:
        self.clock = VirtualClock()
        self.body = CameraBody(self.clock, PlainFilm(raw_of), BULB_BODY, FaultScript())
        self.usb = VirtualUsb(self.body)
        self.told: list[Any] = []
        self.commands: list[tuple[str, ...]] = []
        self.refuses = False
        trigger = TriggerConfig(driver="ptp", lag_s=0.1, jitter_s=0.02, options=options)
        context = DriverContext(
            Config(trigger=trigger), self.clock, SharedState(usb_backend=self.usb)
        )
        self.shutter = PtpShutter.create(context)
        self.shutter._camera.alive_period_s = 3600.0

    def guard(self, command: tuple[str, ...], **more: Any) -> Any:
        bench = self
        self.unguarded = more["unguarded"]

        class Guard:
            def insist(self, word: str) -> None:
                bench.commands.append(command)
                bench.told.append(word)

            def arm(self, word: Callable[[], str]) -> None:
                if bench.refuses:
                    raise DeviceLost("no guardian")
                bench.told.append((word(), bench.body.shutter.is_open))

            def disarm(self) -> None:
                bench.told.append(("disarm", bench.body.shutter.is_open))

            def stop(self, *, wait: bool = True) -> None:
                bench.told.append(("stop", wait))

        return Guard()


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    bench = Bench()
    monkeypatch.setattr(shutter_module, "ShutterGuard", bench.guard)
    bench.shutter.connect()
    yield bench
    bench.shutter._camera.let_go("shutter")


def test_a_guardian_is_armed_before_the_shutter_opens_and_disarmed_after_it_closed(
    bench: Bench,
) -> None:
    bench.shutter.open()
    assert bench.body.shutter.is_open
    bench.shutter.close()
    assert bench.told == ["disarm", ("arm", False), ("disarm", False)]
    bench.shutter.disconnect()
    assert bench.told[3:] == [("disarm", False), ("stop", True)]
    assert not bench.body.session_open


def test_the_guardian_is_for_the_camera_that_was_found(bench: Bench) -> None:
    """By its serial number: another may be plugged in beside it."""
    ((*_, options),) = bench.commands
    assert msgspec.json.decode(options)["serial"] == BULB_BODY.info.serial
    bench.shutter.connect()
    assert bench.told == ["disarm", ("stop", True), "disarm"]  # the first one is let go


def test_times_are_those_by_which_it_surely_moved(bench: Bench) -> None:
    opened = bench.shutter.open()
    assert opened == bench.clock.now_ns()
    bench.clock.sleep_until_ns(opened + 10**9)
    before = bench.clock.now_ns()
    closed = bench.shutter.close()
    assert closed == bench.clock.now_ns() and closed - before >= SURE_NS
    assert bench.shutter.close() == closed == bench.clock.now_ns()  # nothing to wait for


def test_without_a_guardian_it_stays_closed(bench: Bench) -> None:
    bench.refuses = True
    with pytest.raises(DeviceLost):
        bench.shutter.open()
    assert bench.body.shutter.opened == 0


def test_a_shutter_that_did_not_open_needs_no_guardian(bench: Bench) -> None:
    def refuse() -> None:
        raise ExposureError("the dial stands at P")

    bench.shutter._camera.bulb.begin = refuse  # type: ignore[method-assign]
    with pytest.raises(ExposureError):
        bench.shutter.open()
    assert bench.told[1:] == [("arm", False), ("disarm", False)]


@pytest.mark.parametrize("last", ["close", "disconnect"])
def test_a_shutter_that_may_be_open_keeps_its_guardian_armed(bench: Bench, last: str) -> None:
    """The camera was unplugged: that one seeks it on, and nobody waits for it meanwhile."""
    bench.shutter.open()
    bench.body.unplug()
    with pytest.raises(DeviceLost):
        getattr(bench.shutter, last)()
    assert bench.told[2:] == ([] if last == "close" else [("stop", False)])


def test_a_camera_in_this_process_needs_none(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(usb="virtual")
    monkeypatch.setattr(shutter_module, "ShutterGuard", bench.guard)
    bench.shutter.connect()
    bench.shutter.open()
    bench.shutter.close()
    bench.shutter.disconnect()
    assert bench.told == [] and bench.body.shutter.opened == 1


def test_a_cable_release_is_another_driver() -> None:
    with pytest.raises(ConfigError, match=r"leaves the shutter to another driver"):
        Bench(release="external")
