"""What made a result: time, versions, commit of the source tree."""

from __future__ import annotations

import importlib.metadata
import platform
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from pdcd.version import __version__


def format_utc_now() -> str:
    """The time of day, ISO 8601."""
    return datetime.now(UTC).isoformat()


def list_versions() -> dict[str, str]:
    """Python and the packages that a result depends on, with their versions when this process
    started using them.

    They are read once: a package that is upgraded later is not the one that this process runs.
    """
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    names = ("numpy", "scipy", "msgspec", "rawpy", "opencv-contrib-python-headless")
    found = {name: importlib.metadata.version(name) for name in names}
    return {"python": platform.python_version(), "pdcd": __version__, **found}


def find_git_commit() -> str | None:
    """Commit of the running source tree, or None where it is not a checkout."""
    git = Path(__file__).resolve().parents[2] / ".git"
    try:
        head = (git / "HEAD").read_text().strip()
        return head if not head.startswith("ref: ") else (git / head[5:]).read_text().strip()
    except OSError:
        return None
