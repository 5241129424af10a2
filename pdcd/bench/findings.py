"""What a doctor says: one finding for each thing that was looked at."""

from __future__ import annotations

from typing import Literal

import msgspec

from pdcd.errors import PdcdError

State = Literal["good", "warning", "fault", "unknown"]


class Finding(msgspec.Struct, frozen=True):
    """One thing looked at. `state` "unknown" means that it could not be looked at."""

    what: str
    state: State
    found: str
    hint: str | None = None


def fault(what: str, err: PdcdError, device: str | None = None) -> Finding:
    """What an error says, `device` being the one that this doctor is about."""
    where = f"{err.device}: " if err.device not in (None, device) else ""
    return Finding(what, "fault", where + err.message, err.hint)
