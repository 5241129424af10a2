"""Log lines to stderr: with priorities under the journal, with times at a terminal."""

from __future__ import annotations

import logging
import os
import sys

_PRIORITY = {
    logging.DEBUG: 7,
    logging.INFO: 6,
    logging.WARNING: 4,
    logging.ERROR: 3,
    logging.CRITICAL: 2,
}
"""Priorities of sd-daemon(3), which are those of syslog."""


class _JournalFormatter(logging.Formatter):
    """Puts ``<N>`` before each line, so that a traceback keeps its priority to the end."""

    def format(self, record: logging.LogRecord) -> str:
        """The record as lines for the journal, which adds the time by itself."""
        prefix = f"<{_PRIORITY.get(record.levelno, 6)}>"
        return prefix + super().format(record).replace("\n", f"\n{prefix}")


def to_stderr(level: int = logging.INFO) -> None:
    """Send the log of this process to stderr, in the form that its reader wants."""
    handler = logging.StreamHandler()
    if _is_journal():
        handler.setFormatter(_JournalFormatter("%(name)s: %(message)s"))
    else:
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=level, handlers=[handler])


def _is_journal() -> bool:
    # JOURNAL_STREAM is inherited by children whose stderr may be another one, so compare.
    try:
        found = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"
