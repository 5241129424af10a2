"""Packages that only some commands need, and the line that installs one where pdcd runs.

A plain installation reads runs: it opens, verifies, reports and exports them. What drives the
devices of a bench is in the extra `bench`, and what other commands need in extras of their own.
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
"""What `make` sets up from a checkout, by the package that it is about."""

OPTIONAL = ("aiohttp", "aravis-python", "distributed", "gphoto2", "jupyterlab", "matplotlib")
"""All packages of other extras that may be missing."""

BENCH = {
    "Xlib": "python-xlib",
    "glfw": "glfw",
    "moderngl": "moderngl",
    "serial": "pyserial",
    "usb": "pyusb",
}
"""What the extra `bench` brings, by the name that is imported: drivers of real devices alone need
it."""
WITH_BENCH = "primal-dual-coding[bench]"
"""What is installed for it; the name of the distribution is not that of the package."""


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
    package = shlex.quote(package)
    if importlib.util.find_spec("pip") is None and sys.prefix != sys.base_prefix:
        inside = Path(sys.prefix) / "bin" / "python"
        return f"{_outer_python()} -m pip --python {_quoted(inside)} install {package}"
    return f"{_quoted(sys.executable)} -m pip install {package}"


def explain_missing(error: ModuleNotFoundError) -> DriverUnavailable | None:
    """The error to raise for a module that was not found, where the extra `bench` brings it; None
    where it does not.

    Whoever runs a command or loads a driver asks, with what an import raised.
    """
    package = BENCH.get((error.name or "").partition(".")[0])
    if package is None:
        return None
    return DriverUnavailable(
        f"the Python package {package} is not installed: devices of a bench need it",
        hint=suggest_install(WITH_BENCH),
    )


def require_bench(*modules: str) -> None:
    """Raise DriverUnavailable where one of these modules, keys of `BENCH`, is not installed. Asked
    by whoever starts a process that imports them, as its own error would be lost."""
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
    """A Python outside of this environment: while that is active, it is `python3` itself."""
    found = which("python3")
    if found is not None and not Path(found).is_relative_to(sys.prefix):
        return "python3"
    return _quoted(getattr(sys, "_base_executable", sys.executable))


def _quoted(path: Path | str) -> str:
    return shlex.quote(str(path))
