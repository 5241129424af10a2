"""Exit codes of every command; scripts rely on them."""

from __future__ import annotations

DONE = 0
_USAGE = 2
"""Wrong usage, configuration or request."""
UNREACHABLE = 3
"""No daemon answers."""
BUSY = 4
"""Another capture holds the rig."""
FAILED = 5
DENIED = 6
"""This user may not do that on this rig."""
CANCELLED = 130
"""128 + SIGINT, as shells report an interrupted program."""


_CODES = {
    "config": _USAGE,
    "request": _USAGE,
    "driver_unavailable": _USAGE,  # an unknown name, or a package that is not installed
    "busy": BUSY,
    "denied": DENIED,
    "cancelled": CANCELLED,
}


def exit_code_of(kind: str | None) -> int:
    """Exit code for an error of this `kind` (see `pdcd.errors`)."""
    return _CODES.get(kind or "", FAILED)
