"""Packages that only some commands need, and the shell line that installs one for this pdcd.

A plain installation reads runs: it opens, verifies, reports and exports them. Packages that drive
the devices of a bench are in the extra `bench`; other commands have extras of their own.
"""

from __future__ import annotations

import importlib.util
import re
import shlex
import sys
from pathlib import Path
from shutil import which

from pdcd.errors import DriverUnavailable

SOURCE_ROOT = Path(__file__).resolve().parents[1]
"""The checkout, or the folder of installed packages."""

TARGETS = {"aiohttp": "web", "jupyterlab": "notebook"}
"""Targets of `make` in a checkout that install a package, by package."""

OPTIONAL = ("aiohttp", "aravis-python", "distributed", "gphoto2", "jupyterlab", "matplotlib")
"""All packages of other extras that may be missing."""

BENCH = {
    "Xlib": "python-xlib",
    "glfw": "glfw",
    "moderngl": "moderngl",
    "serial": "pyserial",
    "usb": "pyusb",
}
"""Packages of the extra `bench`, by the name that is imported; only drivers of real devices need
them."""
WITH_BENCH = "primal-dual-coding[bench]"
"""What to install for it; the distribution has another name than the package."""


def suggest_install(package: str) -> str:
    """A shell's line that installs `package` into the environment that this process runs in.

    It is the hint of the error for a missing package. In the environment that `make` has made in a
    checkout it is a target of the Makefile, if there is one for the package. Environments often
    lack a pip of their own; then the line uses the pip of the Python outside.
    """
    target = TARGETS.get(package, "")
    if target and _is_made_here() and _has_target(target):
        return (
            f"make {target}"
            if Path.cwd() == SOURCE_ROOT
            else f"make -C {_quoted(SOURCE_ROOT)} {target}"
        )
    package = shlex.quote(package)
    if importlib.util.find_spec("pip") is None and sys.prefix != sys.base_prefix:
        inside = Path(sys.prefix) / "bin" / "python"
        return f"{_outer_python()} -m pip --python {_quoted(inside)} install {package}"
    return f"{_quoted(sys.executable)} -m pip install {package}"


def explain_missing(error: ModuleNotFoundError) -> DriverUnavailable | None:
    """The error to raise for a module that was not found, if the extra `bench` contains it; else
    None.

    It is called with the error of a failed import, when a command is run or a driver is loaded.
    """
    package = BENCH.get((error.name or "").partition(".")[0])
    if package is None:
        return None
    return DriverUnavailable(
        f"the Python package {package} is not installed: devices of a bench need it",
        hint=suggest_install(WITH_BENCH),
    )


def require_bench(*modules: str) -> None:
    """Raise DriverUnavailable if one of these modules, keys of `BENCH`, is not installed. Call it
    before starting a process that imports them, as that process' own error would be lost."""
    for module in modules:
        if importlib.util.find_spec(module) is None:
            missing = explain_missing(ModuleNotFoundError(name=module))
            if missing is not None:
                raise missing


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
    """The command of a Python outside this environment."""
    found = which("python3")
    if found is not None and not Path(found).is_relative_to(sys.prefix):
        return "python3"
    return _quoted(getattr(sys, "_base_executable", sys.executable))


def _quoted(path: Path | str) -> str:
    return shlex.quote(str(path))
