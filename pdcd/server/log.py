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


FOR_PEOPLE = {"for_people": True}
"""`extra` of the few lines below a warning that a person at a terminal wants, too."""


class _Quiet(logging.Filter):
    """Lets through warnings, errors, and lines marked by `FOR_PEOPLE`."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the line is shown."""
        return record.levelno >= logging.WARNING or getattr(record, "for_people", False)


def to_stderr(level: int = logging.INFO, *, verbose: bool = False) -> None:
    """Send the log of this process to stderr, in the form that its reader wants.

    A terminal is often that of the commands, too, and of their progress bar: it gets warnings and
    what is marked by `FOR_PEOPLE`, or everything with `verbose`. Journal, files and pipes get
    everything.
    """
    handler = logging.StreamHandler()
    if not verbose and sys.stderr.isatty():
        handler.addFilter(_Quiet())
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
