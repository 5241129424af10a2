"""Files that somebody else wrote: opened with rights, read with limits, never trusted."""

from __future__ import annotations
