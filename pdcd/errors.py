"""One tree of errors; every failure a client can see is one of these.

::

    PdcdError                kind            what happened
    ├── ConfigError          config          a setting of the operator is wrong
    ├── RequestError         request         what a client asked for, or sent, is wrong
    ├── ProtocolError        protocol        a message on the socket is malformed or unknown
    ├── BusyError            busy            another capture holds the rig
    ├── DeniedError          denied          the user may not do this
    ├── DriverUnavailable    driver_unavailable   a driver is unknown or cannot be loaded
    ├── DeviceLost           device_lost     a device stopped answering or was never there
    ├── SyncError            sync            the panels missed refreshes
    ├── ExposureError        exposure        the shutter or the exposure went wrong
    │   └── PhotoError       exposure        its photo was lost; taking it again may help
    ├── DecodeError          decode          a RAW file or a run folder cannot be read
    ├── PlanError            plan            planning died, hung, or ran out of memory
    ├── CalibrationError     calibration     photos of a calibration cannot be trusted
    ├── NoSpaceError         no_space        the disk is full, or would be
    ├── DiskError            disk            the disk refuses for another reason
    └── Cancelled            cancelled       the user, the client or a signal ended the job

`kind` is stable and is what clients match on; the message says what failed, `device` on which
device, and `hint` what to do.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import ClassVar


class PdcdError(Exception):
    """Base of every error of pdcd.

    kind : the word that clients match on. message : what failed. device : on which device, or None.
    hint : one thing to do, or None.
    """

    kind: ClassVar[str] = "internal"

    def __init__(self, message: str, *, device: str | None = None, hint: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.device = device
        self.hint = hint

    def __str__(self) -> str:
        where = f"{self.device}: " if self.device else ""
        what = f" ({self.hint})" if self.hint else ""
        return f"{where}{self.message}{what}"


class ConfigError(PdcdError):
    """A setting of the configuration or the command line is wrong or out of range."""

    kind = "config"


class RequestError(PdcdError):
    """A request, or an array that came with it, is wrong or cannot be done on this rig."""

    kind = "request"


class ProtocolError(PdcdError):
    """A message on the socket is malformed, too long, or names an unknown method."""

    kind = "protocol"


class BusyError(PdcdError):
    """Another capture holds the rig; `device` is empty, the hint names the holder."""

    kind = "busy"


class DeniedError(PdcdError):
    """The user may not use this rig, or may not do this with it."""

    kind = "denied"


class DriverUnavailable(PdcdError):  # noqa: N818 - reads as the state it reports
    """A driver name is unknown, its module does not import, or its class is missing."""

    kind = "driver_unavailable"


class DeviceLost(PdcdError):  # noqa: N818
    """A device stopped answering, was unplugged, or was never found."""

    kind = "device_lost"


class SyncError(PdcdError):
    """The panels missed refreshes, or cannot be driven in lockstep."""

    kind = "sync"


class ExposureError(PdcdError):
    """The shutter did not open or close, or the exposure is unusable."""

    kind = "exposure"


class PhotoError(ExposureError):
    """The photo of an exposure was lost, is not whole, or did not see all of it. Nothing is broken,
    and taking it again may help: it is taken again as often as the rig allows."""


class DecodeError(PdcdError):
    """A RAW file or a run folder is damaged, incomplete or of an unknown form."""

    kind = "decode"


class PlanError(PdcdError):
    """Planning did not come to an end: its process died or hung, or memory ran out."""

    kind = "plan"


class CalibrationError(PdcdError):
    """Photos of a calibration cannot be trusted: the message names the cause, and none is kept."""

    kind = "calibration"


class NoSpaceError(PdcdError):
    """The disk is full, or the run would not fit on it."""

    kind = "no_space"


class DiskError(PdcdError):
    """The disk refuses to be written to or read, for a reason other than being full."""

    kind = "disk"


class Cancelled(PdcdError):  # noqa: N818
    """The job was ended by a cancel request, a client that went away, or a signal."""

    kind = "cancelled"


KINDS = tuple(sorted({c.kind for c in PdcdError.__subclasses__()} | {PdcdError.kind}))
"""Every `kind` that a client may see."""


def make_error(
    kind: str | None, message: str | None, device: str | None = None, hint: str | None = None
) -> PdcdError:
    """The error in a result or in a message on the wire; an unknown kind becomes PdcdError."""
    known = {c.kind: c for c in PdcdError.__subclasses__()}
    return known.get(kind or "", PdcdError)(message or "", device=device, hint=hint)


def restore_error(fields: Mapping[str, str | None] | None) -> PdcdError:
    """The error from the fields of `to_error_fields`, to raise the error that ended a job."""
    told = fields or {}
    return make_error(*(told.get(name) for name in ("kind", "message", "device", "hint")))


def to_error_fields(error: PdcdError) -> dict[str, str | None]:
    """The error as `CaptureResult.error` holds it: kind, message, device, hint."""
    return {
        "kind": error.kind,
        "message": error.message,
        "device": error.device,
        "hint": error.hint,
    }


_FULL = (errno.ENOSPC, errno.EDQUOT)
_SCARCE = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN)
"""The system's errors when a process, or all processes together, have reached a limit."""
_MOST_TOLD = 1000
"""Most characters of a message made from a foreign error."""


@contextmanager
def disk_errors(device: str) -> Iterator[None]:
    """Turn a full disk into NoSpaceError, too few descriptors or too little memory into BusyError,
    and any other refusal of the disk into DiskError."""
    try:
        yield
    except OSError as err:
        raise _to_disk_error(err, device, "cannot write") from err


def to_typed_error(error: BaseException) -> PdcdError:
    """Any exception as an error that can be sent to a client.

    Called where a request, a job or a command ends. An exception that is not one of our errors is a
    fault of the program, unless the system refused something: then it becomes the error for that.
    """
    if isinstance(error, PdcdError):
        return error
    said = _said_by(error)
    if isinstance(error, MemoryError) or "can't start new thread" in said:
        return _to_disk_error(OSError(errno.ENOMEM, said or "out of memory"), None, "")
    # Devices and connections raise OSError, too; only errors of files have a name.
    if isinstance(error, OSError) and (error.filename or error.errno in (*_FULL, *_SCARCE)):
        return _to_disk_error(error, None, f"cannot use {error.filename!r:.200}")
    message = f"{type(error).__name__}: {said}"
    return PdcdError(message, hint="a fault of the program: see the log")


def _said_by(error: BaseException) -> str:
    try:
        return str(error)[:_MOST_TOLD]
    except Exception:  # a foreign error whose text cannot even be made
        return "it has no text"


def _to_disk_error(error: OSError, device: str | None, what: str) -> PdcdError:
    why = error.strerror or _said_by(error)
    if error.errno in _FULL:
        return NoSpaceError("the disk is full", device=device, hint="free some space and run again")
    if error.errno in _SCARCE:
        hint = "try again in a moment; if it stays, raise LimitNOFILE or give it more memory"
        return BusyError(f"the system has nothing left: {why}", device=device, hint=hint)
    return DiskError(f"{what}: {why}", device=device, hint="check folder and rights")
