"""A single click of the shutter, step by step: does the line work, and how long does it take?

Where the same driver is also the camera, the camera is armed first and its photo is fetched
afterwards: without that some bodies refuse to open, or keep the photo for the next capture.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Protocol, runtime_checkable

from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.bench.devices import (
    CameraInfo,
    CameraSettings,
    Clock,
    DriverContext,
    Finding,
    PhotoFrame,
    Readout,
    Shutter,
    fault,
)
from pdcd.bench.exposure_time import tell_exposure_time, with_open_time
from pdcd.bench.registry import load_driver
from pdcd.bench.tables import Config
from pdcd.errors import PdcdError

_DEVICE = "shutter"
_NO_SETTINGS = CameraSettings(iso=0, f_number=None)
"""Settings for a click without a camera, where only the times matter."""


@runtime_checkable
class Looks(Protocol):
    """A shutter that can report on its device without opening it. Drivers need not offer this."""

    def look(self) -> Iterator[Finding]:
        """Yield findings; nothing moves. Raises PdcdError."""
        ...


def examine_shutter(config: Config, *, click: bool, seconds: float = 1.0) -> Iterator[Finding]:
    """Yield findings; nothing moves, and no port is opened, unless `click` is true.

    seconds : how long the shutter is held open after the time by which it is surely open.

    The shutter is closed when this ends, also by an exception or when the caller stops half-way. A
    failure is not raised: it is the last finding.
    """
    clock: Clock = VirtualClock() if config.rig.clock == "virtual" else RealClock()
    context = DriverContext(config=config, clock=clock)
    try:
        chosen = load_driver("shutter", config.trigger.driver)
        shutter: Shutter = chosen.create(context)
        yield Finding("driver", "good", f"{config.trigger.driver}, {chosen.maturity}")
        if isinstance(shutter, Looks):
            yield from shutter.look()
        readout: Readout | None = None
        if config.camera.driver == config.trigger.driver:
            readout = load_driver("readout", config.camera.driver).create(context)
        if click:
            yield from _click(config, clock, shutter, readout, seconds)
        else:
            yield Finding("click", "unknown", "not tried: it opens the shutter", "give --click")
    except PdcdError as err:
        yield fault("trigger", err, _DEVICE)


def _click(
    config: Config, clock: Clock, shutter: Shutter, readout: Readout | None, seconds: float
) -> Iterator[Finding]:
    try:
        begun_ns = clock.now_ns()
        for what, found in shutter.connect().items():
            yield Finding(what, "good", found)
        if readout is not None:
            camera = readout.connect()
            yield Finding("camera", "good", camera.model)
            readout.arm(with_open_time(_settings(config, camera), config, seconds))
        yield Finding("made ready", "good", f"closed, after {_ms(clock, begun_ns)}")
        tell_exposure_time(shutter, with_open_time(_NO_SETTINGS, config, seconds))
        begun_ns = clock.now_ns()
        open_ns = shutter.open()
        yield Finding("open", "good", f"surely open {_ms(clock, begun_ns)} after the order")
        clock.sleep_until_ns(open_ns + round(seconds * 1e9))
        begun_ns = clock.now_ns()
        shutter.close()
        yield Finding("close", "good", f"surely closed {_ms(clock, begun_ns)} after the order")
        if readout is not None:
            yield _photo(config, clock, readout)
    finally:
        closed: PdcdError | None = None
        try:
            shutter.disconnect()
        except PdcdError as err:
            closed = err
        if readout is not None:
            with suppress(PdcdError):
                readout.disconnect()
        if closed is not None:
            raise closed


def _settings(config: Config, camera: CameraInfo) -> CameraSettings:
    """The configured ISO and aperture, or those that gather the least light."""
    f_number = config.camera.f_number
    if not camera.f_numbers:
        chosen = None
    else:
        chosen = max(camera.f_numbers) if f_number == "auto" else f_number
    return CameraSettings(config.camera.iso or min(camera.isos), chosen)


def _photo(config: Config, clock: Clock, readout: Readout) -> Finding:
    """Fetch the photo, and throw it away."""
    begun_ns = clock.now_ns()
    with tempfile.TemporaryDirectory(prefix="pdcd-click-") as folder:
        photo = readout.fetch(Path(folder), "click", config.camera.fetch_timeout_s)
    size = photo.samples.nbytes if isinstance(photo, PhotoFrame) else photo.size_bytes
    return Finding("photo", "good", f"{size} bytes, after {_ms(clock, begun_ns)}")


def _ms(clock: Clock, since_ns: int) -> str:
    return f"{(clock.now_ns() - since_ns) * 1e-6:.1f} ms"
