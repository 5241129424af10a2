"""Standard streams that are closed, full or gone: a command ends by what it was asked, or says so.

Whoever starts us may have closed any of them. Then the next file that is opened gets the number,
and what is meant for a person would be written into it: so there is something on all three from the
start.
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
    """Put the null device where a standard stream is missing; called first of all. What stdout has
    no letter for is written as an escape, as stderr does it."""
    keep_standard_streams()
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode))
    with contextlib.suppress(AttributeError):  # in a notebook, it is no file
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]


def write_stdout(text: str) -> None:
    """Write a result, at once also into a pipe: the command may go on for hours.

    Raises BrokenPipeError where nobody reads any more, NoSpaceError and DiskError.
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
    """Send what cannot be written to the null device; called last of all, for the interpreter
    complains of what is left."""
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
