"""What the users of a rig may do."""

from __future__ import annotations

import enum


class Role(enum.IntEnum):
    """What a client may do; each role may all that the ones below it may."""

    LOOK = 1
    """See the rig, its jobs and their events."""
    SHOOT = 2
    """Take photos, and cancel jobs of the same user."""
    ADMINISTER = 3
    """Cancel everybody's jobs."""
