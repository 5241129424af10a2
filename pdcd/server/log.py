"""Log lines to stderr: with priorities for the journal, with times at a terminal.

Much of what is logged comes from clients and devices. So every record is one line, invisible
characters are escaped, and lines of a traceback are indented: nobody can forge a line.
"""

from __future__ import annotations

import logging
import os
import sys
from types import TracebackType

from pdcd.printable import to_indented_lines, to_one_line

_PRIORITY = {
    logging.DEBUG: 7,
    logging.INFO: 6,
    logging.WARNING: 4,
    logging.ERROR: 3,
    logging.CRITICAL: 2,
}
"""Priorities of sd-daemon(3), which are those of syslog."""

_ExcInfo = tuple[type[BaseException], BaseException, TracebackType | None] | tuple[None, None, None]


class _Formatter(logging.Formatter):
    """Escapes text that came from elsewhere, here and nowhere else."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - of logging
        """The record's own line."""
        return to_one_line(super().formatMessage(record))

    def formatException(self, ei: _ExcInfo) -> str:  # noqa: N802
        """The traceback, indented."""
        return "  " + to_indented_lines(super().formatException(ei))

    def formatStack(self, stack_info: str) -> str:  # noqa: N802
        """The stack, indented."""
        return "  " + to_indented_lines(super().formatStack(stack_info))


class _JournalFormatter(_Formatter):
    """Puts ``<N>`` before each line, so that a traceback keeps its priority to the end."""

    def format(self, record: logging.LogRecord) -> str:
        """The record as lines for the journal, which adds the time itself."""
        prefix = f"<{_PRIORITY.get(record.levelno, 6)}>"
        return prefix + super().format(record).replace("\n", f"\n{prefix}")


FOR_PEOPLE = {"for_people": True}
"""`extra` for the few lines below a warning that a person at a terminal should see, too."""


class _Quiet(logging.Filter):
    """Lets through warnings, errors, and lines marked by `FOR_PEOPLE`."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the line is shown."""
        return record.levelno >= logging.WARNING or getattr(record, "for_people", False)


def send_to_stderr(*, verbose: bool = False) -> None:
    """Send the log of this process to stderr, in the form that suits its reader.

    A terminal often also shows the commands and their progress bar, so it gets only warnings and
    lines marked by `FOR_PEOPLE`, or everything with `verbose`. Journal, files and pipes get
    everything.
    """
    logging.raiseExceptions = False  # a line that cannot be written must not cause more
    handler = logging.StreamHandler()
    if not verbose and sys.stderr.isatty():
        handler.addFilter(_Quiet())
    if _is_journal():
        handler.setFormatter(_JournalFormatter("%(name)s: %(message)s"))
    else:
        handler.setFormatter(_Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])


def _is_journal() -> bool:
    # JOURNAL_STREAM is inherited by children whose stderr may be another one, so compare.
    try:
        found = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"
