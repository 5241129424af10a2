"""What other commands make of finished runs, and what they say without one."""

from __future__ import annotations

from tests.goldens.case import Case


def cases() -> list[Case]:
    """All of them."""
    return []
