"""What the virtual camera answers."""

from __future__ import annotations

from dataclasses import dataclass

from ..ptp.codes import ResponseCode
from .faults import WireKind


@dataclass(frozen=True)
class CameraReply:
    """An answer: response code, parameters, and the data phase (None: there is none).

    `fault` is for the transport: the script's fault to apply to the answer on its way.
    """

    code: int = ResponseCode.OK
    parameters: tuple[int, ...] = ()
    data: bytes | memoryview | None = None
    fault: WireKind | None = None


OK = CameraReply()


def make_error_reply(code: ResponseCode) -> CameraReply:
    """An answer without data that says what is wrong."""
    return CameraReply(code)
