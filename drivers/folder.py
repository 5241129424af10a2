"""A camera that something else reads out: its RAW files appear in a folder.

Tethering software writes them there, or a card is mounted. The folder is looked at from time to
time, by the injected clock; no notification service is needed, and network shares work.

A file is taken when it is the only RAW file under a name that was not there at `arm`, its size and
date have not changed for some looks, its directories speak of no data behind its end, LibRaw
decodes it, and it says the ISO and aperture that were asked for. So software that writes each photo
over the last one does not do. What cannot be seen: whether the file is that of *this* exposure. One
of an earlier exposure that arrives late, alone, is taken for it.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
from msgspec import Meta

from pdcd.driver import (
    RAW_SUFFIXES,
    CameraConfig,
    CameraInfo,
    CameraSettings,
    Clock,
    ConfigError,
    DecodeError,
    DeviceLost,
    DriverContext,
    ExposureError,
    NoSpaceError,
    RawFile,
    load_profile,
    read_options,
    read_raw,
    read_tags,
    responsivity_e,
)

_DATE_SLACK_S = 2.0
"""FAT stores dates to two seconds."""
_F_NUMBER_SLACK = 0.06
"""Nominal and true f-numbers differ by rounding: 5.6 is 5.66, 3.5 is 3.56."""
_BLOCK_BYTES = 1 << 20


class FolderOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[camera.options] of this driver."""

    folder: str
    """Where the files appear, also in folders below it."""
    suffixes: Annotated[tuple[str, ...], Meta(min_length=1)] = RAW_SUFFIXES
    """What counts as RAW, in lower case; all else is passed over."""
    take: Literal["copy", "move"] = "copy"
    """Whether the file stays in the folder as well."""
    poll_s: Annotated[float, Meta(ge=0.01, le=10.0)] = 0.2
    looks: Annotated[int, Meta(ge=2, le=100)] = 4
    """How many looks in a row must find the same size and date."""
    check_date: bool = True
    """Refuse a file whose date lies before the exposure. Only a camera with a wrong clock, on a
    card that is mounted, needs it off."""


class _Seen(NamedTuple):
    size_bytes: int
    date_ns: int


class FolderReadout:
    """Takes the RAW file that appears after `arm`. ISO and aperture are set at the camera."""

    maturity = "experimental"

    def __init__(
        self,
        options: FolderOptions,
        config: CameraConfig,
        clock: Clock,
        alive: Callable[[], object] = lambda: None,
    ) -> None:
        self._options = options
        self._config = config
        self._clock = clock
        self._alive = alive
        self._folder = Path(options.folder).expanduser()
        profile = load_profile(config.profile)
        self._isos, self._frame_quads = profile.isos, profile.frame_quads
        self._settings: CameraSettings | None = None
        self._known: dict[Path, _Seen] = {}
        self._armed_ns = 0

    @classmethod
    def create(cls, context: DriverContext) -> FolderReadout:
        """Check the options. Raises ConfigError."""
        config = context.config.camera
        options = read_options(
            config.options,
            FolderOptions,
            table="camera.options",
            device="camera",
            hint="docs/cameras.md lists the options of the driver folder",
        )
        return cls(options, config, context.clock, context.alive)

    def connect(self) -> CameraInfo:
        """See that the folder can be read. Raises DeviceLost."""
        self._look()
        return CameraInfo(
            model=f"files in {self._folder}",
            serial="",
            profile=self._config.profile,
            responsivity_e=responsivity_e(self._config),
            isos=self._isos,
            f_numbers=(),
            frame_quads=self._frame_quads,
        )

    def arm(self, settings: CameraSettings) -> None:
        """Remember what is there already. The settings are compared with the file's own later.

        Raises ConfigError for an ISO that the sensor's profile lacks, DeviceLost.
        """
        if settings.iso not in self._isos:
            raise ConfigError(
                f"the sensor profile has no ISO {settings.iso}",
                device="camera",
                hint=f"take one of {', '.join(map(str, self._isos))}",
            )
        self._known = self._look()
        self._armed_ns = time.time_ns()
        self._settings = settings

    def fetch(self, folder: Path, name: str, timeout_s: float) -> RawFile:
        """Wait for one new, whole RAW file and take it.

        Raises ExposureError for none, more than one, one that stays incomplete or one taken with
        other settings; DecodeError for one that cannot be read; DeviceLost when the folder is gone;
        NoSpaceError.
        """
        settings, self._settings = self._settings, None
        if settings is None:
            raise ExposureError("the camera was not armed", device="camera", hint="call arm first")
        source, seen = self._wait(timeout_s)
        path = folder / f"{name}{source.suffix.lower()}"
        raw = self._copy(source, seen, path)
        try:
            self._check(source, raw, settings)
            if self._options.take == "move":
                source.unlink()
        except OSError as err:
            path.unlink()
            raise DeviceLost(
                f"cannot remove {source}: {err.strerror}", device="camera", hint="take = 'copy'?"
            ) from err
        except BaseException:
            path.unlink()
            raise
        return raw

    def disconnect(self) -> None:
        """Forget the settings."""
        self._settings = None

    def _look(self) -> dict[Path, _Seen]:
        """All RAW files by name; hidden ones are somebody's unfinished business."""
        found: dict[Path, _Seen] = {}
        try:
            os.scandir(self._folder).close()  # rglob passes over a folder that is not there
            for path in self._folder.rglob("*"):
                if path.suffix.lower() in self._options.suffixes and path.name[0] != ".":
                    with contextlib.suppress(FileNotFoundError):  # renamed in between
                        status = path.stat()
                        found[path] = _Seen(status.st_size, status.st_mtime_ns)
        except OSError as err:
            raise DeviceLost(
                f"cannot read the folder {self._folder}: {err.strerror}",
                device="camera",
                hint="is it mounted, and may the daemon read it?",
            ) from err
        return found

    def _wait(self, timeout_s: float) -> tuple[Path, _Seen]:
        """The one new file, once it is whole."""
        until_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        before: dict[Path, _Seen] = {}
        same = 0
        while True:
            self._alive()
            new = {p: seen for p, seen in self._look().items() if p not in self._known}
            same = same + 1 if new == before else 1
            before = new
            if same >= self._options.looks and new and all(map(_whole, new)):
                self._refuse_old_or_many(new)
                return next(iter(new.items()))
            now_ns = self._clock.now_ns()
            if now_ns >= until_ns:
                raise self._nothing(new, timeout_s)
            poll_ns = round(self._options.poll_s * 1e9)
            self._clock.sleep_until_ns(min(now_ns + poll_ns, until_ns))

    def _refuse_old_or_many(self, new: dict[Path, _Seen]) -> None:
        if len(new) > 1:
            raise ExposureError(
                f"{len(new)} RAW files came for one exposure: {_names(new)}",
                device="camera",
                hint="has somebody else released the shutter? take single shots",
            )
        ((path, seen),) = new.items()
        late_s = (self._armed_ns - seen.date_ns) * 1e-9
        if self._options.check_date and late_s > _DATE_SLACK_S:
            raise ExposureError(
                f"{path.name} is new but dated {late_s:.0f} s before the exposure",
                device="camera",
                hint="set the camera's clock, or check_date = false",
            )

    def _nothing(self, new: dict[Path, _Seen], timeout_s: float) -> ExposureError:
        if new:
            return ExposureError(
                f"not whole after {timeout_s:g} s: {_names(new)}",
                device="camera",
                hint="is the transfer still going on? raise camera.fetch_timeout_s",
            )
        return ExposureError(
            f"no RAW file came into {self._folder} within {timeout_s:g} s",
            device="camera",
            hint="is the camera set to RAW, and does the tethering software save here?",
        )

    def _copy(self, source: Path, seen: _Seen, path: Path) -> RawFile:
        """Copy and hash in one go; what is left of a failed copy is removed."""
        digest, size_bytes = hashlib.sha256(), 0
        made = False
        try:
            try:
                with source.open("rb") as file, path.open("xb") as copy:
                    made = True
                    while block := file.read(_BLOCK_BYTES):
                        self._alive()
                        digest.update(block)
                        size_bytes += copy.write(block)
            except BaseException:  # a signal, say
                if made:
                    path.unlink()
                raise
        except OSError as err:
            if err.errno in (errno.ENOSPC, errno.EDQUOT):
                raise NoSpaceError(
                    f"no space left for {path.name}", device="camera", hint="free some space"
                ) from err
            raise DecodeError(
                f"cannot copy {source} to {path}: {err.strerror}",
                device="camera",
                hint="may the daemon read the file?",
            ) from err
        if size_bytes != seen.size_bytes:
            path.unlink()
            raise ExposureError(
                f"{source.name} changed while it was copied", device="camera", hint="raise looks"
            )
        return RawFile(path, size_bytes, digest.hexdigest())

    def _check(self, source: Path, raw: RawFile, settings: CameraSettings) -> None:
        """Decode it and compare it with what was asked for."""
        frame = read_raw(raw.path, sha256=raw.sha256, size_bytes=raw.size_bytes)
        if frame.iso and frame.iso != settings.iso:
            raise ExposureError(
                f"{source.name} was taken at ISO {frame.iso}, not {settings.iso}",
                device="camera",
                hint="set the camera's ISO, or camera.iso",
            )
        asked = settings.f_number or self._config.f_number
        if frame.f_number and asked != "auto":
            if abs(frame.f_number / asked - 1.0) > _F_NUMBER_SLACK:
                raise ExposureError(
                    f"{source.name} was taken at f/{frame.f_number:g}, not f/{asked:g}",
                    device="camera",
                    hint="set the lens, or camera.f_number",
                )


def _whole(path: Path) -> bool:
    """Whether all that the file's directories speak of is there."""
    try:
        data = path.read_bytes()
    except OSError:
        return True  # let the copy say what is wrong
    tags = read_tags(data)
    return bool(data) and (tags is None or tags.needs_bytes <= len(data))


def _names(files: dict[Path, _Seen]) -> str:
    return ", ".join(f"{path.name} ({seen.size_bytes} bytes)" for path, seen in files.items())
