"""What shall go wrong with the virtual camera, set when it is created.

A script is immutable and names occasions, not times: the n-th call of an operation, the next file.
So runs with the same script are identical.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Literal

from ..ptp.codes import ExposureMode, FocusMode

WireKind = Literal[
    "stall",  # the answer's endpoint halts; after clear-halt the answer is there
    "mute",  # the operation is done, its answer never comes
    "deaf",  # the operation is not done, and never answered
    "busy",  # DeviceBusy, the operation is not done
    "error",  # GeneralError, the operation is not done
    "short-read",  # the data phase breaks off half way, then an OK comes
    "lost-session",  # the camera has forgotten the session: SessionNotOpen
    "unplug",  # the cable is out, before the operation is done
    "wrong-transaction",  # the response carries another transaction's id
    "corrupt",  # one byte of the data is not what it was
    "no-data",  # an OK comes where data were due
]
_FileKind = Literal["normal", "none", "late", "twice", "truncated"]


@dataclass(frozen=True)
class ScriptedFault:
    """`kind` happens at the calls `first` to `first + times - 1` (from 1) of an operation.

    Calls are counted from the creation of the camera; calls that met a fault count too.
    """

    kind: WireKind
    operation: int
    first: int = 1
    times: int = 1


@dataclass(frozen=True)
class FaultScript:
    """Everything that is wrong with a camera; the default is a faultless one, set for bulb.

    wire
        Faults of the connection.
    file
        What becomes of files: "none" are announced, all come `late_s` late, are announced "twice",
        or are "truncated": half of the bytes that were announced exist.
    dial, focus
        Mode dial and focus switch.
    battery
        `Property.BATTERY`; 0 is nearly empty: the camera says so and does not release.
    long_exposure_nr
        A second, dark exposure follows each; the camera is busy meanwhile.
    buffer_full
        No shots are left, whatever room the computer reports.
    """

    wire: tuple[ScriptedFault, ...] = ()
    file: _FileKind = "normal"
    late_s: float = 20.0
    dial: ExposureMode = ExposureMode.MANUAL
    focus: FocusMode = FocusMode.MANUAL
    battery: int = 2
    long_exposure_nr: bool = False
    buffer_full: bool = False


class Occasions:
    """Counts calls and says which fault, if any, applies to the current one."""

    def __init__(self, script: FaultScript) -> None:
        self._script = script
        self._calls: Counter[int] = Counter()

    def meet(self, operation: int) -> WireKind | None:
        """Count one call of the operation; the first fault that names it wins."""
        self._calls[operation] += 1
        call = self._calls[operation]
        for fault in self._script.wire:
            if fault.operation == operation and fault.first <= call < fault.first + fault.times:
                return fault.kind
        return None
