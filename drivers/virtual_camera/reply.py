"""What the virtual camera answers."""

from __future__ import annotations

from dataclasses import dataclass

from ..ptp.codes import Response
from .faults import WireKind


@dataclass(frozen=True)
class Reply:
    """An answer: response code, parameters, and the data phase (None: there is none).

    `fault` is for the transport: what to do to the answer on its way, as the script has it.
    """

    code: int = Response.OK
    parameters: tuple[int, ...] = ()
    data: bytes | memoryview | None = None
    fault: WireKind | None = None


OK = Reply()


def failed(code: Response) -> Reply:
    """An answer without data that says what is wrong."""
    return Reply(code)
