"""Packages that only some commands need, and the line that installs one where pdcd runs."""

from __future__ import annotations

import importlib.util
import re
import shlex
import sys
from pathlib import Path
from shutil import which

SOURCE_ROOT = Path(__file__).resolve().parents[1]
"""The checkout, or the folder of installed packages."""

TARGETS = {"aiohttp": "web", "jupyterlab": "notebook"}
"""What `make` sets up from a checkout, by the package that it is about."""

OPTIONAL = ("aiohttp", "aravis-python", "distributed", "gphoto2", "jupyterlab", "matplotlib")
"""All packages that may be missing."""


def suggest_install(package: str) -> str:
    """A shell's line that installs `package` into the environment that this process runs in.

    Whoever misses a package gives it as the hint of the error. In the environment that `make` has
    made beside a checkout it is a target of the Makefile, where there is one for the package.
    Environments often lack a pip of their own; then that of the Python outside is told to serve
    this one.
    """
    target = TARGETS.get(package, "")
    if target and _is_made_here() and _has_target(target):
        return (
            f"make {target}"
            if Path.cwd() == SOURCE_ROOT
            else f"make -C {_quoted(SOURCE_ROOT)} {target}"
        )
    if importlib.util.find_spec("pip") is None and sys.prefix != sys.base_prefix:
        inside = Path(sys.prefix) / "bin" / "python"
        return f"{_outer_python()} -m pip --python {_quoted(inside)} install {package}"
    return f"{_quoted(sys.executable)} -m pip install {package}"


def _is_made_here() -> bool:
    """Whether this is the environment that the Makefile of a checkout fills."""
    return Path(sys.prefix).resolve() == SOURCE_ROOT / ".venv"


def _has_target(name: str) -> bool:
    try:
        text = (SOURCE_ROOT / "Makefile").read_text(encoding="utf-8")
    except OSError:
        return False
    return re.search(rf"^{name}:", text, re.MULTILINE) is not None


def _outer_python() -> str:
    """A Python outside of this environment: while that is active, it is `python3` itself."""
    found = which("python3")
    if found is not None and not Path(found).is_relative_to(sys.prefix):
        return "python3"
    return _quoted(getattr(sys, "_base_executable", sys.executable))


def _quoted(path: Path | str) -> str:
    return shlex.quote(str(path))
