"""A camera that something else reads out: its RAW files appear in a folder.

Tethering software writes them there, or a card is mounted. The folder is checked from time to time,
by the injected clock; no notification service is needed, and network shares work.

A file is taken when it is the only RAW file whose name was not there at `arm`; its size, dates and
content stay the same for some looks; its directories refer to no data beyond its end; no strip of
it is all zeros, as in a file that is made with its full length first and filled later; LibRaw
decodes it; and it says the ISO and aperture that were asked for. Until then the driver waits; at
the end of the run it checks the file once more. So software that overwrites the last photo with
each new one cannot be used. The driver cannot see whether the file belongs to *this* exposure: a
late file of an earlier exposure, if it is the only one, is taken for it.

Whoever can write into the folder is not trusted: no link is followed, only regular files are
opened, and no file is read that is larger than a photo can be (`WatchedFolder`).
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

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
    Patience,
    RawFile,
    WatchedFile,
    WatchedFolder,
    disk_errors,
    find_gap,
    load_profile,
    read_options,
    read_raw,
    responsivity_e,
    to_one_line,
)

_DATE_SLACK_S = 2.0
"""Tolerance of dates: FAT stores them to two seconds."""
_F_NUMBER_SLACK = 0.06
"""Relative tolerance of f-numbers, which are rounded: 5.6 is 5.66, 3.5 is 3.56."""
_GRACE_S = 0.9
"""How long after the time-out a file that was whole by then may still be read."""
_NOT_YET = "is the transfer still going on? raise camera.fetch_timeout_s"
_MOST_NAMED = 6
"""Most names that an error lists."""
_MOST_LARGER = 4
"""A photo may have this many times the samples of its profile's sensor."""


class FolderOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[camera.options] of this driver."""

    folder: str
    """Where the files appear, directly or in folders below it."""
    suffixes: Annotated[tuple[str, ...], Meta(min_length=1)] = RAW_SUFFIXES
    """Suffixes that count as RAW, in lower case; other files are ignored."""
    take: Literal["copy", "move"] = "copy"
    """Whether the file also stays in the folder."""
    poll_s: Annotated[float, Meta(ge=0.01, le=10.0)] = 0.2
    looks: Annotated[int, Meta(ge=2, le=100)] = 4
    """How many looks in a row must find the same size and dates."""
    check_date: bool = True
    """Refuse a file whose date lies before the exposure. Only a camera with a wrong clock that
    writes to a mounted card needs it off."""


@dataclass
class _Arrival:
    """What has appeared since the camera was armed, look by look.

    same : looks in a row that found the same. sha256 : of the only new file, one look before it is
    taken. refused : SHA-256 of content that is not a photo, for the reason `fault`.
    """

    before: dict[str, WatchedFile] = field(default_factory=dict)
    same: int = 0
    sha256: str = ""
    refused: str = ""
    fault: DecodeError | None = None

    def see(self, photos: dict[str, WatchedFile]) -> None:
        """Count one more look."""
        self.same = self.same + 1 if photos == self.before else 1
        self.before = photos


class FolderReadout:
    """Takes the RAW file that appears after `arm`. ISO and aperture are set at the camera."""

    maturity = "experimental"

    def __init__(
        self,
        options: FolderOptions,
        config: CameraConfig,
        clock: Clock,
        patience: Patience,
    ) -> None:
        self._options = options
        self._config = config
        self._clock = clock
        self._patience = patience
        self._folder = WatchedFolder(_expand(options.folder))
        profile = load_profile(config.profile)
        self._isos, self._frame_quads = profile.isos, profile.frame_quads
        self._most_bytes = profile.largest_photo_bytes
        self._most_samples = _MOST_LARGER * profile.samples or self._most_bytes // 2
        self._settings: CameraSettings | None = None
        self._known: dict[str, WatchedFile] = {}
        self._armed_ns = 0
        self._taken: list[tuple[str, str]] = []
        self._changed: list[tuple[str, str]] = []

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
        return cls(options, config, context.clock, context.patience)

    def connect(self) -> CameraInfo:
        """Check that the folder can be read. Raises DeviceLost."""
        self._look()
        return CameraInfo(
            model=f"files in {self._folder.path}",
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
        if self._options.take == "move":
            self._settle(None)
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

        def too_slow() -> ExposureError:
            return ExposureError(
                f"{self._folder.path} cannot be read in time",
                device="camera",
                hint="is the network slow? raise camera.fetch_timeout_s",
            )

        with self._patience.within(timeout_s + _GRACE_S, too_slow):
            source, raw = self._wait(folder, name, timeout_s, settings)
        self._taken.append((source, raw.sha256))
        return raw

    def recheck(self, photos: Collection[str]) -> None:
        """Check once more the files that the photos with these SHA-256 were taken from.

        Raises ExposureError for a file that holds something else by now. With `take = "move"` the
        other files are removed; raises DeviceLost if one cannot be.
        """
        self._settle(photos)
        changed = [name for name, sha256 in self._changed if sha256 in photos]
        self._changed = []
        if changed:
            raise ExposureError(
                f"changed after it was taken: {_list(changed)}",
                device="camera",
                hint="have the files written elsewhere and moved here once they are whole",
            )

    def disconnect(self) -> None:
        """Forget the settings."""
        self._settings = None

    def _settle(self, photos: Collection[str] | None) -> None:
        """Note which files no longer hold what was taken, and remove the others if asked.

        photos : the photos to check, by SHA-256; the others are forgotten. None: all.
        """
        taken, self._taken = self._taken, []
        for name, sha256 in taken:
            if photos is not None and sha256 not in photos:
                continue
            try:
                now = self._folder.hash(name, self._most_bytes, self._patience.look)
                if now != sha256:
                    self._changed.append((name, sha256))
                elif self._options.take == "move":
                    self._folder.remove(name)
            except FileNotFoundError:  # somebody has removed it
                continue
            except DecodeError:
                self._changed.append((name, sha256))
            except OSError as err:
                raise DeviceLost(
                    f"cannot remove or read {to_one_line(name)}: {err.strerror}",
                    device="camera",
                    hint="may the daemon write there? take = 'copy' leaves files where they are",
                ) from err

    def _look(self) -> dict[str, WatchedFile]:
        """Everything in the folder, by name."""
        try:
            return self._folder.look(self._patience.look)
        except OSError as err:
            raise DeviceLost(
                f"cannot read the folder {self._folder.path}: {err.strerror}",
                device="camera",
                hint="is it mounted, and may the daemon read it?",
            ) from err

    def _wait(
        self, folder: Path, name: str, timeout_s: float, settings: CameraSettings
    ) -> tuple[str, RawFile]:
        """Wait until the one new file is whole; returns it and the photo in it."""
        until_ns, arrival = self._clock.now_ns() + round(timeout_s * 1e9), _Arrival()
        while True:
            there = self._look()
            new = {n: seen for n, seen in there.items() if n not in self._known and self._is_raw(n)}
            photos = {name: seen for name, seen in new.items() if seen.kind == "file"}
            arrival.see(photos)
            if photos and arrival.same >= self._options.looks:
                self._refuse_old_or_many(photos)
                (source,) = photos
                raw = self._take(source, arrival, folder, name, settings)
                if raw is not None:
                    return source, raw
                arrival.same = 0
            elif len(photos) == 1 and arrival.same == self._options.looks - 1:
                arrival.sha256 = self._hash(*photos)
            now_ns = self._clock.now_ns()
            if now_ns >= until_ns:
                raise self._nothing(photos, arrival.fault, there, timeout_s)
            poll_ns = round(self._options.poll_s * 1e9)
            self._patience.sleep_until_ns(min(now_ns + poll_ns, until_ns))

    def _hash(self, source: str) -> str:
        """SHA-256 of a file's present content; "" if it cannot be read."""
        try:
            return self._folder.hash(source, self._most_bytes, self._patience.look)
        except (OSError, DecodeError):
            return ""

    def _take(
        self, source: str, arrival: _Arrival, folder: Path, name: str, settings: CameraSettings
    ) -> RawFile | None:
        """The photo in a file that did not change for some looks; None if it is not one yet."""
        shown = to_one_line(source)
        try:
            data = self._folder.read(source, self._most_bytes, self._patience.look)
        except DecodeError as err:
            arrival.fault = err
            return None
        except OSError as err:
            hint = "may the daemon read the file?"
            arrival.fault = DecodeError(f"cannot read {shown}: {err.strerror}", hint=hint)
            return None
        sha256, size_bytes = hashlib.sha256(data).hexdigest(), len(data)
        if sha256 == arrival.refused:
            return None
        why = find_gap(data) if sha256 == arrival.sha256 else "it changed between two looks"
        if why:
            arrival.fault = DecodeError(f"{shown}: {why}", hint=_NOT_YET)
            return None
        path = folder / f"{name}{Path(source).suffix.lower()}"
        with disk_errors("camera"), path.open("xb") as copy:
            try:
                copy.write(data)
            except BaseException:
                path.unlink()
                raise
        del data  # of a large photo, which is decoded now
        raw = RawFile(path, size_bytes, sha256)
        try:
            self._check(shown, raw, settings)
        except DecodeError as err:
            path.unlink()
            arrival.refused = sha256
            arrival.fault = DecodeError(f"{shown}: {err.message}", hint=err.hint)
            return None
        except BaseException:
            path.unlink()
            raise
        return raw

    def _is_raw(self, name: str) -> bool:
        return Path(name).suffix.lower() in self._options.suffixes

    def _refuse_old_or_many(self, new: dict[str, WatchedFile]) -> None:
        if len(new) > 1:
            raise ExposureError(
                f"{len(new)} RAW files came for one exposure: {_names(new)}",
                device="camera",
                hint="has somebody else released the shutter? take single shots",
            )
        ((name, seen),) = new.items()
        late_s = (self._armed_ns - seen.date_ns) * 1e-9
        if self._options.check_date and late_s > _DATE_SLACK_S:
            raise ExposureError(
                f"{to_one_line(name)} is new but dated {late_s:.0f} s before the exposure",
                device="camera",
                hint="set the camera's clock, or check_date = false",
            )

    def _nothing(
        self,
        new: dict[str, WatchedFile],
        fault: DecodeError | None,
        there: dict[str, WatchedFile],
        timeout_s: float,
    ) -> Exception:
        """The error that says why no photo was taken, and which files were ignored."""
        if new and fault is not None and fault.hint != _NOT_YET:
            return fault
        if new:
            why = "" if fault is None else f": {fault.message}"
            return ExposureError(
                f"not whole after {timeout_s:g} s: {_names(new)}{why}",
                device="camera",
                hint=_NOT_YET,
            )
        passed = _list(self._passed_over(there))
        return ExposureError(
            f"no RAW file came into {self._folder.path} within {timeout_s:g} s"
            + (f"; passed over: {passed}" if passed else ""),
            device="camera",
            hint="is the camera set to RAW, and does the tethering software save here?",
        )

    def _passed_over(self, there: dict[str, WatchedFile]) -> list[str]:
        """New things that are not photos, each with the reason."""
        found = []
        for name, seen in there.items():
            known = self._known.get(name)
            if known == seen or (known is not None and seen.kind == "folder"):
                continue
            shown = to_one_line(name)
            if seen.kind != "file" and self._is_raw(name):
                found.append(f"{shown} (a {seen.kind})")
            elif seen.kind == "file" and not self._is_raw(name):
                found.append(f"{shown} (no RAW by its name)")
            elif seen.kind == "file":
                found.append(f"{shown} (its name was there before)")
        return found

    def _check(self, shown: str, raw: RawFile, settings: CameraSettings) -> None:
        """Decode a photo and compare its settings with those asked for. Raises DecodeError and
        ExposureError."""
        frame = read_raw(
            raw.path,
            sha256=raw.sha256,
            size_bytes=raw.size_bytes,
            most_samples=self._most_samples,
        )
        if frame.iso and frame.iso != settings.iso:
            raise ExposureError(
                f"{shown} was taken at ISO {frame.iso}, not {settings.iso}",
                device="camera",
                hint="set the camera's ISO, or camera.iso",
            )
        asked = settings.f_number or self._config.f_number
        if frame.f_number and asked != "auto":
            if abs(frame.f_number / asked - 1.0) > _F_NUMBER_SLACK:
                raise ExposureError(
                    f"{shown} was taken at f/{frame.f_number:g}, not f/{asked:g}",
                    device="camera",
                    hint="set the lens, or camera.f_number",
                )


def _expand(folder: str) -> Path:
    """A folder with its ~ replaced by the home folder. Raises ConfigError."""
    try:
        return Path(folder).expanduser()
    except RuntimeError as err:
        raise ConfigError(
            f"camera.options: folder = {to_one_line(folder)!r}: there is no such home folder",
            device="camera",
            hint="write the whole path",
        ) from err


def _list(names: Collection[str]) -> str:
    """Names in words; only the first ones if there are many."""
    shown = [to_one_line(name) for name in list(names)[:_MOST_NAMED]]
    more = [f"and {len(names) - _MOST_NAMED} more"] if len(names) > _MOST_NAMED else []
    return ", ".join([*shown, *more])


def _names(files: dict[str, WatchedFile]) -> str:
    return _list([f"{name} ({seen.size_bytes} bytes)" for name, seen in files.items()])
