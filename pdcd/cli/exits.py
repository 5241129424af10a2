"""Exit codes of every command; scripts rely on them."""

from __future__ import annotations

DONE = 0
USAGE = 2
"""Wrong usage, configuration or request."""
UNREACHABLE = 3
"""No daemon answers."""
BUSY = 4
"""Another capture holds the rig."""
FAILED = 5
CANCELLED = 130
"""128 + SIGINT, as shells report an interrupted program."""


def exit_code(kind: str | None) -> int:
    """Exit code for an error of this `kind` (see `pdcd.errors`)."""
    codes = {"config": USAGE, "request": USAGE, "busy": BUSY, "cancelled": CANCELLED}
    return codes.get(kind or "", FAILED)
