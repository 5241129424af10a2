"""One camera with its settings as photos need them: found, opened, set up, and asked.

No maker's default is relied on: everything that could silently change samples is switched off, if
the camera has it.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
from collections.abc import Callable, Iterator
from functools import partial

from pdcd.driver import ConfigError, DeviceLost, PhotoError

from .aravis import AravisCamera, AravisError, FoundCamera, RawBuffer, list_cameras
from .counters import PulseCounters
from .features import (
    GAIN_FEATURES,
    PLAIN_ONES,
    PLAIN_SWITCHES,
    PLAIN_WORDS,
    START_SELECTORS,
    TIME_FEATURES,
)
from .levels import SampleLevels
from .options import ExposureName, GenicamOptions
from .pixels import BY_NAME, PixelFormat, choose_pixel_format

logger = logging.getLogger(__name__)

CAMERA_DEVICE = "camera"
_DOCTOR = "pdcd doctor camera says what was found"
_PLUG = "check power and cable; pdcd doctor camera says what answers"
_BUFFERS = 4
_LET_GO_S = 1.0
"""Longest wait for the release of a camera that is gone; Aravis takes ten seconds."""
_WORD_BITS = 16
_BASE_ISO = 100
_GAIN_TOLERANCE_DB, _FACTOR_TOLERANCE = 0.05, 0.01


@contextlib.contextmanager
def report_errors(doing: str) -> Iterator[None]:
    """Turn errors of the library into DeviceLost if the camera did not answer, and into ConfigError
    if it refused. `doing` says what it was asked for."""
    try:
        yield
    except AravisError as err:
        if err.lost:
            raise DeviceLost(
                f"the camera does not answer ({doing}): {err}", device=CAMERA_DEVICE, hint=_PLUG
            ) from err
        raise ConfigError(
            f"the camera refuses ({doing}): {err}", device=CAMERA_DEVICE, hint=_DOCTOR
        ) from err


def find_camera(wanted: str | None) -> str:
    """The identifier to open: an address as it is, or the one camera of that serial number or name.

    Raises DeviceLost if there is none, ConfigError if there are several to choose from.
    """
    if wanted is not None and wanted.count(".") == 3 and wanted.replace(".", "").isdigit():
        return wanted
    found = list_cameras()
    fitting = [c for c in found if wanted is None or wanted in (c.id, c.serial, c.address)]
    listed = ", ".join(describe_camera(camera) for camera in found) or "none"
    if not fitting:
        raise DeviceLost(
            f"no camera {wanted or ''} answers; found: {listed}".replace("  ", " "),
            device=CAMERA_DEVICE,
            hint="check power and cable, and on USB the rights (docs/genicam.md)",
        )
    if len(fitting) > 1:
        raise ConfigError(
            f"{len(fitting)} cameras answer: {listed}",
            device=CAMERA_DEVICE,
            hint="name one by its serial number as camera.options.camera",
        )
    return fitting[0].id


def describe_camera(camera: FoundCamera) -> str:
    """One line on a camera that announced itself."""
    at = f" at {camera.address}" if camera.protocol == "GigEVision" else ""
    return f"{camera.vendor} {camera.model} {camera.serial}{at} ({camera.protocol})"


class GenicamDevice:
    """An open camera, set up for triggered photos. Raises, as every method does, DeviceLost and
    ConfigError."""

    def __init__(self, options: GenicamOptions) -> None:
        """Open and set up; nothing is exposed. Takes a second more where no address is given."""
        self.options = options
        self.distrusted = False
        """Set once it did not answer: later it may seem to, but be in another state."""
        self.unset: list[str] = []
        """Features that the camera has but refused to switch off."""
        identifier = find_camera(options.camera)
        with report_errors("opening it"):
            self._camera = AravisCamera(identifier)
        try:
            self._check_ours(identifier)
            self._set_up()
        except BaseException as err:
            self.distrusted = isinstance(err, DeviceLost)
            self.close()
            raise

    @property
    def lost(self) -> bool:
        """Whether it once did not answer, or is no longer controlled from here."""
        return self.distrusted or not self._camera.ours

    def ask_ours(self) -> bool:
        """Whether it still knows that it is controlled from here; a restarted camera does not, and
        is not trusted any more."""
        with report_errors("who controls it"):
            self.distrusted = self.distrusted or not self._camera.ask_ours()
        return not self.distrusted

    @property
    def identity(self) -> dict[str, str]:
        """Maker, model, serial number and firmware, as far as it reports them."""
        names = {
            "vendor": ("DeviceVendorName",),
            "model": ("DeviceModelName",),
            "serial": ("DeviceSerialNumber", "DeviceID"),
            "firmware": ("DeviceFirmwareVersion", "DeviceVersion"),
        }
        found = {what: self._first_text(features) for what, features in names.items()}
        return {what: text for what, text in found.items() if text}

    @property
    def frame_quads(self) -> tuple[int, int]:
        """Width and height of its pictures in quads of its mosaic; in pixels if it has none."""
        side = 1 if self.pixel_format.cfa is None else 2
        return self.size[0] // side, self.size[1] // side

    @property
    def isos(self) -> tuple[int, ...]:
        """ISO numbers that its gain gives: 100 without gain, and doubled by every 6 dB."""
        return tuple(self._gains)

    def _check_ours(self, identifier: str) -> None:
        if not self._camera.ours:
            raise DeviceLost(
                f"the camera {identifier} is held by another program",
                device=CAMERA_DEVICE,
                hint="close the maker's viewer, or the daemon that has it",
            )

    def _set_up(self) -> None:
        camera, options = self._camera, self.options
        with report_errors("setting it up"):
            self._try("AcquisitionStop", camera.stop)  # whoever had it before may have left it on
            for feature, word in PLAIN_WORDS:
                self._try(feature, partial(camera.choose, feature, word))
            for feature in PLAIN_SWITCHES:
                self._try(feature, partial(camera.set_boolean, feature, False))
            for feature in PLAIN_ONES:
                self._try(feature, partial(camera.set_number, feature, 1.0))
        self.pixel_format = self._choose_format()
        with report_errors("setting the region"):
            self.size = self._set_region()
        with report_errors("its exposure and gain"):
            self._set_start("timed")
            self._time = self._needed(TIME_FEATURES, "an exposure time")
            self._bounds_us = camera.bounds(self._time)
            self.shortest_s, self.longest_s = (1e-6 * bound for bound in self._bounds_us)
            self._gain, self._gains = self._find_gains()
            if options.black_level is not None:
                camera.set_number("BlackLevel", options.black_level)
            self._tells_waiting = self._find_waiting()
            self._set_start(options.exposure)
        with report_errors("counting pulses"):
            lines = options.pulses
            self._counters = None if lines is None else PulseCounters(camera, lines)
        self.levels = SampleLevels(self.pixel_format, options.white_dn, told=self._find_white())
        with report_errors("its stream"):
            self.on_network = camera.on_network
            self.packet_bytes = 0
            if self.on_network:
                self.packet_bytes = camera.set_packet_size(options.packet_bytes)
            self.payload_bytes = camera.get_integer("PayloadSize")
            camera.open_stream(self.payload_bytes, _BUFFERS, resend=options.resend)
            camera.start()

    @property
    def white_known(self) -> bool:
        """Whether the white level is known before a saturated photo shows it."""
        levels = self.levels
        return not (levels.white is levels.told is None) or self.pixel_format.bits < _WORD_BITS

    def set_gain(self, iso: int) -> None:
        """Set the gain of an ISO number. Raises ConfigError, which lists the possible ones."""
        if iso not in self._gains:
            raise ConfigError(
                f"ISO {iso} is not offered",
                device=CAMERA_DEVICE,
                hint=f"take one of {', '.join(map(str, self._gains))}",
            )
        if self._gain is not None:
            with report_errors(f"ISO {iso}"):
                self._camera.set_number(self._gain, self._gains[iso])

    def set_exposure(self, exposure_s: float) -> float:
        """Set how long it exposes; returns the time that the camera set, s.

        Raises ConfigError for a time beyond its own limit."""
        if exposure_s > self.longest_s:
            raise ConfigError(
                f"an exposure of {exposure_s:.3g} s is beyond the camera's {self.longest_s:.3g} s",
                device=CAMERA_DEVICE,
                hint="show fewer codes in an exposure, or set camera.options.exposure = 'width'",
            )
        with report_errors(f"an exposure of {exposure_s:.3g} s"):
            # In its own unit: a microsecond to seconds and back may be a little less than before.
            low_us, high_us = self._bounds_us
            self._camera.set_number(self._time, min(max(1e6 * exposure_s, low_us), high_us))
            return 1e-6 * self._camera.get_number(self._time)

    def set_start(self, exposure: ExposureName) -> None:
        """Change how exposures begin and end; acquisition is started anew."""
        with report_errors(f"exposures that are {exposure}"):
            self._camera.stop()
            self._set_start(exposure)
            self._camera.start()

    def trigger(self) -> None:
        """Start an exposure by command."""
        with report_errors("a software trigger"):
            self._camera.execute("TriggerSoftware")

    def waits_for_trigger(self) -> bool | None:
        """Whether it would accept a trigger now; None if it does not report that."""
        if not self._tells_waiting:
            return None
        with report_errors("whether it waits for a trigger"):
            return self._camera.get_boolean("AcquisitionStatus")

    def abort(self) -> None:
        """Abandon a running exposure: it gives no frame."""
        with report_errors("ending an exposure"):
            if self._camera.has("AcquisitionAbort"):
                self._camera.execute("AcquisitionAbort")  # a stop may wait for its end
            self._camera.stop()
            self._camera.start()

    def record(self) -> dict[str, str]:
        """What the camera reports about itself at a photo, in its own words.

        This proves that it answers and kept its settings: raises PhotoError if it was restarted."""
        found = {"PixelFormat": self.pixel_format.name, **self.levels.words}
        with report_errors("its record"):
            for feature in (self._time, self._gain, "BlackLevel", "DeviceTemperature"):
                if feature is None or not self._camera.has(feature):
                    continue
                try:
                    found[feature] = f"{self._camera.get_number(feature):g}"
                except AravisError as err:
                    if err.lost:
                        raise
                    logger.info("not told feature=%s error=%s", feature, err)
        self.check_ours()
        return found

    def check_ours(self) -> None:
        """Raise PhotoError if it does not know that it is controlled from here."""
        if not self.ask_ours():
            raise PhotoError(
                "the camera was restarted, or another program has taken it",
                device=CAMERA_DEVICE,
                hint="take it again",
            )

    def restart_counters(self) -> None:
        """Count pulses from now on, at the inputs in `GenicamOptions.pulses`, if there are any."""
        if self._counters is not None:
            with report_errors("counting pulses"):
                self._counters.restart()

    def count_pulses(self) -> tuple[int, int] | None:
        """Pulses of projector and mask since then; None if none are counted."""
        if self._counters is None:
            return None
        with report_errors("its counters"):
            return self._counters.read()

    def pop(self, wait_s: float) -> RawBuffer | None:
        """The next frame, from `AravisCamera.pop`."""
        return self._camera.pop(wait_s)

    def close(self) -> None:
        """Release the camera. Idempotent, and never fails; a camera that does not answer is
        released by a thread, whose end is not awaited."""
        gone, self.distrusted = self.lost, True
        if not gone:
            with contextlib.suppress(AravisError):
                self._camera.stop()
                self._camera.close()
                return
        with contextlib.suppress(RuntimeError):  # no thread begins while the process ends
            ending = threading.Thread(target=self._camera.close, daemon=True)
            ending.start()
            ending.join(_LET_GO_S)

    def _try(self, feature: str, action: Callable[[], None]) -> None:
        """Set a feature if there is one; a refusal is noted, a lost camera raises."""
        camera = self._camera
        if not camera.has(feature):
            return
        try:
            action()
        except AravisError as err:
            if err.lost:
                raise
            self.unset.append(f"{feature}: {err}")

    def _choose_format(self) -> PixelFormat:
        with report_errors("its pixel formats"):
            offered = self._camera.choices("PixelFormat")
        name = self.options.pixel_format or choose_pixel_format(offered)
        if name is None or name not in offered or name not in BY_NAME:
            what = "no known pixel format" if name is None else f"pixel format {name}"
            raise ConfigError(
                f"{what} of a camera with {', '.join(offered)}",
                device=CAMERA_DEVICE,
                hint="name one as camera.options.pixel_format: Mono12p, BayerRG12p ...",
            )
        with report_errors(f"pixel format {name}"):
            self._camera.set_text("PixelFormat", name)
        return BY_NAME[name]

    def _set_region(self) -> tuple[int, int]:
        """Width and height of the pictures."""
        camera, region = self._camera, self.options.region
        for feature in ("OffsetX", "OffsetY"):
            if camera.has(feature):
                camera.set_integer(feature, 0)
        widest, highest = camera.integer_bounds("Width")[1], camera.integer_bounds("Height")[1]
        left, top, width, height = region or (0, 0, widest, highest)
        camera.set_integer("Width", width)
        camera.set_integer("Height", height)
        if region is not None:
            camera.set_integer("OffsetX", left)
            camera.set_integer("OffsetY", top)
        return camera.get_integer("Width"), camera.get_integer("Height")

    def _set_start(self, exposure: ExposureName) -> None:
        """By a command and timed, or by a line. Raises ConfigError where it has no such mode."""
        wanted = "TriggerWidth" if exposure == "width" else "Timed"
        has = self._camera.has("ExposureMode")
        offered = self._camera.choices("ExposureMode") if has else ("Timed",)
        if wanted not in offered:
            raise ConfigError(
                f"the camera has no ExposureMode {wanted}, but {', '.join(offered)}",
                device=CAMERA_DEVICE,
                hint="set camera.options.exposure = 'timed'",
            )
        if has:
            self._camera.set_text("ExposureMode", wanted)
        self._set_trigger("Software" if exposure == "timed" else self.options.line)

    def _set_trigger(self, source: str) -> None:
        """Let every frame be started by a trigger from this source, and by nothing else."""
        camera = self._camera
        if camera.has("TriggerSelector"):
            selectors = camera.choices("TriggerSelector")
            for other in selectors:
                camera.set_text("TriggerSelector", other)
                self._try("TriggerMode", partial(camera.choose, "TriggerMode", "Off"))
            chosen = next((name for name in START_SELECTORS if name in selectors), None)
            if chosen is not None:
                camera.set_text("TriggerSelector", chosen)
        camera.set_text("TriggerSource", source)
        if source != "Software":
            edge = "FallingEdge" if self.options.active_low else "RisingEdge"
            camera.set_text("TriggerActivation", edge)
        camera.set_text("TriggerMode", "On")

    def _find_waiting(self) -> bool:
        """Find out whether it reports that it waits for a frame's trigger."""
        camera, selector = self._camera, "AcquisitionStatusSelector"
        if not camera.has("AcquisitionStatus"):
            return False
        if not camera.has(selector):
            return True
        if "FrameTriggerWait" not in camera.choices(selector):
            return False
        camera.set_text(selector, "FrameTriggerWait")
        return True

    def _find_gains(self) -> tuple[str | None, dict[int, float]]:
        """The feature that sets the gain, and its value for each ISO number: in dB, or as a factor
        if it has no unit and 1 is the least.

        A camera with a gain in whole numbers, steps of its own, stays at the least one.
        """
        camera = self._camera
        gain = next((name for name in (*GAIN_FEATURES, "GainRaw") if camera.has(name)), None)
        unit = None if gain is None else camera.unit(gain)
        if gain is None or unit is None:
            if gain is not None:
                camera.set_integer(gain, camera.integer_bounds(gain)[0])
            return None, {_BASE_ISO: 0.0}
        low, high = camera.bounds(gain)
        if low >= 1.0 and "db" not in unit.lower():
            doublings = range(math.floor(math.log2(high / low) + _FACTOR_TOLERANCE) + 1)
            return gain, {_BASE_ISO * 2**step: min(low * 2.0**step, high) for step in doublings}
        doubling = 20.0 * math.log10(2.0)
        first = math.ceil((low - _GAIN_TOLERANCE_DB) / doubling)
        last = math.floor((high + _GAIN_TOLERANCE_DB) / doubling)
        found = {
            round(_BASE_ISO * 2.0**step): min(max(step * doubling, low), high)
            for step in range(first, last + 1)
        }
        return gain, found or {_BASE_ISO: min(max(0.0, low), high)}

    def _find_white(self) -> int | None:
        """White level that the camera reports; None if it does not."""
        if not self._camera.has("PixelDynamicRangeMax"):
            return None
        with report_errors("its white level"):
            told = self._camera.get_integer("PixelDynamicRangeMax")
        return told if 0 < told < 2**self.pixel_format.bits else None

    def _needed(self, names: tuple[str, ...], what: str) -> str:
        found = next((name for name in names if self._camera.has(name)), None)
        if found is None:
            raise ConfigError(
                f"the camera has no {names[0]}", device=CAMERA_DEVICE, hint=f"use one with {what}"
            )
        return found

    def _first_text(self, features: tuple[str, ...]) -> str:
        with report_errors("what it is"):
            for feature in features:
                if self._camera.has(feature):
                    return self._camera.get_text(feature).strip()
        return ""
