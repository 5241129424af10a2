"""The promises of a camera's readout, tested with the shutter that goes with it."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from pdcd.bench.devices import (
    CameraInfo,
    CameraSettings,
    PhotoFrame,
    RawFile,
    RecheckingReadout,
)
from pdcd.bench.exposure_time import tell_exposure_time
from pdcd.capture.rig import Rig
from pdcd.errors import ConfigError, ExposureError
from pdcd.sensor.dng import write_photo_frame
from pdcd.sensor.raw import RAW_SUFFIXES, RawFrame, read_raw
from pdcd.testing.promises import Promise
from pdcd.testing.rigs import RigContract

READOUT_SAYS = Promise(
    "`connect` returns a CameraInfo: model, ISOs, electrons for each of its colours",
    "fill in what pdcd plans with; responsivity_e(context.config.camera) is what is known of light",
)
READOUT_ISO = Promise(
    "`arm` raises ConfigError for an ISO that is not offered, with those that are",
    "compare settings.iso with CameraInfo.isos, and list these in the hint",
)
READOUT_APERTURE = Promise(
    "`arm` raises ConfigError for an aperture that is not offered, with those that are",
    "compare settings.f_number with CameraInfo.f_numbers; leave these empty for a manual lens",
)
READOUT_PHOTO = Promise(
    "`fetch` returns a PhotoFrame, or a RawFile `folder/name.<suffix>` with its size and SHA-256",
    "return samples as the sensor has them, or the camera's file byte for byte",
)
READOUT_TOLD = Promise(
    "a photo tells what it was taken with, and its sensor is that of the CameraInfo",
    "take ISO, exposure, order of colours and size from the camera, or leave them out: 0, None",
)
READOUT_LATEST = Promise(
    "`fetch` returns the photo of the latest exposure, whatever was left behind before `arm`",
    "let `arm` drop what is on its way or lies in the camera",
)
READOUT_ONE = Promise(
    "an exposure has one photo: the next `fetch` raises ExposureError",
    "forget settings and photo in `fetch`",
)
READOUT_NOT_ARMED = Promise(
    "`fetch` without `arm` raises ExposureError",
    "keep the settings in `arm`, and refuse to fetch without them",
)
READOUT_NO_PHOTO = Promise(
    "`fetch` raises ExposureError when no photo comes within its time-out",
    "wait by context.patience until timeout_s is over",
)
READOUT_DISCONNECT = Promise(
    "`disconnect` may be called twice, and `connect` after it",
    "forget the device in `disconnect`, and do nothing where there is none",
)
READOUT_RECHECK = Promise(
    "`recheck` takes the SHA-256 of photos that still are what was fetched, and of none",
    "raise ExposureError only where a file holds something else by now",
)

_LATE_S = 20.0
"""On a busy machine a shutter is closed late, never early."""
_EARLY = 0.8
_QUIET_S = 1.0
"""How long a photo is waited for that must not come."""
_ODD_ISO = 77
_BEYOND = 1.3
"""Times the highest aperture is none."""


class ReadoutContract(RigContract):
    """Each promise of `pdcd.driver.Readout` and `RecheckingReadout`, as tests of one driver."""

    roles: ClassVar[tuple[str, ...]] = ("readout", "shutter")
    exposure_s: ClassVar[float] = 0.5
    """How long the photos are exposed that are taken here."""

    @pytest.fixture
    def info(self, rig: Rig) -> CameraInfo:
        """What the camera says of itself."""
        return rig.readout.connect()

    def expose(self, rig: Rig, info: CameraInfo, seconds: float | None = None) -> CameraSettings:
        """One exposure with settings that the camera offers, as the rig takes it."""
        seconds = self.exposure_s if seconds is None else seconds
        stop = max(info.f_numbers, default=None)
        settings = CameraSettings(min(info.isos), stop, seconds, seconds + _LATE_S)
        rig.readout.arm(settings)
        tell_exposure_time(rig.shutter, settings)
        open_ns = rig.shutter.open()
        rig.clock.sleep_until_ns(open_ns + round(seconds * 1e9))
        rig.shutter.close()
        return settings

    def fetch_file(self, rig: Rig, info: CameraInfo, folder: Path, name: str = "photo") -> RawFile:
        """The file of the last exposure's photo, also of one in memory."""
        with READOUT_PHOTO.keep():
            photo = rig.readout.fetch(folder, name, rig.config.camera.fetch_timeout_s)
            if isinstance(photo, PhotoFrame):
                return write_photo_frame(photo, folder / f"{name}.dng", info.model, info.serial)
            READOUT_PHOTO.require(isinstance(photo, RawFile), repr(photo))
            path = photo.path
            placed = path.parent == folder and path.stem == name
            READOUT_PHOTO.require(placed and path.suffix.lower() in RAW_SUFFIXES, path)
            return photo

    def fetch(self, rig: Rig, info: CameraInfo, folder: Path, name: str = "photo") -> RawFrame:
        """What is in that file."""
        file = self.fetch_file(rig, info, folder, name)
        with READOUT_PHOTO.keep():
            return read_raw(file.path, sha256=file.sha256, size_bytes=file.size_bytes)

    def test_connect_says_what_it_is(self, rig: Rig) -> None:
        with READOUT_SAYS.keep():
            info = rig.readout.connect()
            READOUT_SAYS.require(isinstance(info, CameraInfo), repr(info))
            electrons = np.asarray(info.responsivity_e)
            known = (
                electrons.shape in ((3,), (1,))
                and np.isfinite(electrons).all()
                and electrons.min() > 0
            )
            numbers = [*info.isos, *info.f_numbers, *(info.frame_quads or ())]
            readout_s = info.readout_s or 0.0
        whole = bool(info.model and info.isos) and min(numbers) > 0 and readout_s >= 0.0
        READOUT_SAYS.require(known and whole, repr(info))

    def test_an_iso_that_is_not_offered_is_refused_with_the_list(
        self, rig: Rig, info: CameraInfo
    ) -> None:
        stop = max(info.f_numbers, default=None)
        asked = CameraSettings(_ODD_ISO, stop)
        said = READOUT_ISO.require_error(ConfigError, lambda: rig.readout.arm(asked))
        READOUT_ISO.require(str(min(info.isos)) in said, said)

    def test_an_aperture_that_is_not_offered_is_refused_with_the_list(
        self, rig: Rig, info: CameraInfo
    ) -> None:
        if not info.f_numbers:
            pytest.skip("a lens that cannot be set from here")
        asked = CameraSettings(min(info.isos), _BEYOND * max(info.f_numbers))
        said = READOUT_APERTURE.require_error(ConfigError, lambda: rig.readout.arm(asked))
        READOUT_APERTURE.require(f"{max(info.f_numbers):g}" in said, said)

    def test_a_photo_comes_home_whole(self, rig: Rig, info: CameraInfo, tmp_path: Path) -> None:
        settings = self.expose(rig, info)
        frame = self.fetch(rig, info, tmp_path)
        READOUT_TOLD.require(frame.iso in (0, settings.iso), f"ISO {frame.iso} of {settings.iso}")
        told_s, asked_s = frame.exposure_s, self.exposure_s
        READOUT_TOLD.require(
            told_s == 0.0 or _EARLY * asked_s < told_s < asked_s + _LATE_S,
            f"{told_s:g} s of an exposure of {asked_s:g} s",
        )
        READOUT_TOLD.require(
            (frame.pattern or None) == info.cfa,
            f"a sensor of {frame.pattern}, and {info.cfa} in CameraInfo",
        )
        size_px = frame.samples.shape[2], frame.samples.shape[1]
        READOUT_TOLD.require(
            info.frame_quads in (None, size_px),
            f"{size_px} pixels, and {info.frame_quads} in CameraInfo",
        )

    def test_one_photo_for_each_exposure(self, rig: Rig, info: CameraInfo, tmp_path: Path) -> None:
        for number in range(2):
            self.expose(rig, info)
            self.fetch(rig, info, tmp_path, f"photo-{number}")
            READOUT_ONE.require_error(
                ExposureError, lambda: rig.readout.fetch(tmp_path, "again", _QUIET_S)
            )

    def test_what_was_left_behind_is_not_the_next_photo(
        self, rig: Rig, info: CameraInfo, tmp_path: Path
    ) -> None:
        self.expose(rig, info, 4.0 * self.exposure_s)
        with READOUT_LATEST.keep():
            self.expose(rig, info)
            frame = self.fetch(rig, info, tmp_path)
        READOUT_LATEST.require(
            frame.exposure_s < 3.0 * self.exposure_s,
            f"{frame.exposure_s:g} s of an exposure of {self.exposure_s:g} s",
        )

    def test_fetch_without_arm_is_refused(self, rig: Rig, tmp_path: Path) -> None:
        rig.shutter.open()
        rig.shutter.close()
        READOUT_NOT_ARMED.require_error(
            ExposureError, lambda: rig.readout.fetch(tmp_path, "photo", _QUIET_S)
        )

    def test_a_photo_that_never_comes(self, rig: Rig, info: CameraInfo, tmp_path: Path) -> None:
        rig.readout.arm(CameraSettings(min(info.isos), max(info.f_numbers, default=None)))
        READOUT_NO_PHOTO.require_error(
            ExposureError, lambda: rig.readout.fetch(tmp_path, "photo", _QUIET_S)
        )

    def test_disconnect_twice_and_connect_again(self, rig: Rig) -> None:
        with READOUT_DISCONNECT.keep():
            rig.readout.disconnect()
            rig.readout.disconnect()
            rig.readout.connect()

    def test_photos_that_did_not_change_pass_a_second_look(
        self, rig: Rig, info: CameraInfo, tmp_path: Path
    ) -> None:
        readout = rig.readout
        if not isinstance(readout, RecheckingReadout):
            pytest.skip("others do not write its files")
        self.expose(rig, info)
        file = self.fetch_file(rig, info, tmp_path)
        with READOUT_RECHECK.keep():
            readout.recheck({file.sha256})
            readout.recheck(())
