"""Standard streams that are closed, full or gone: a command still does its work, or reports it.

The parent process may have closed any of them. Then the next file that is opened gets its number,
and text for the user would be written into that file. So all three are opened at the start.
"""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path
from typing import TextIO

from pdcd.errors import disk_errors
from pdcd.printable import keep_standard_streams


def open_missing_streams() -> None:
    """Put the null device where a standard stream is missing; called first of all. Characters that
    stdout cannot encode are written as escapes, as on stderr."""
    keep_standard_streams()
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode))
    with contextlib.suppress(AttributeError):  # in a notebook it is not a file
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]


def write_stdout(text: str) -> None:
    """Write a result and flush it, also into a pipe: the command may go on for hours.

    Raises BrokenPipeError when nobody reads any more, NoSpaceError and DiskError.
    """
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError:
        with disk_errors("stdout"):
            raise


def replace_broken_streams() -> None:
    """Send unwritten output of broken streams to the null device; called last of all, as the
    interpreter complains about output that is left."""
    for stream in (sys.stdout, sys.stderr):
        if not _is_flushed(stream):
            with contextlib.suppress(OSError, ValueError):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, stream.fileno())
                os.close(null)


def _is_flushed(stream: TextIO) -> bool:
    try:
        stream.flush()
    except (OSError, ValueError):
        return False
    return True
