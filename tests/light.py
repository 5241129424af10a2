"""What `pip install` brings without and with extras: names, files and weight of the packages, as
they lie in this environment."""

from __future__ import annotations

import importlib.metadata
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path

from packaging.requirements import Requirement

from tests.places import ROOT

MOST_BYTES = 80_000_000
"""Most that packages which read runs may weigh, beside these:"""
GIVEN = ("numpy", "scipy", "opencv-contrib-python-headless")


def list_packages(extra: str = "") -> set[str]:
    """Names of all packages that an installation of pdcd needs, those that they need included."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [Requirement(line) for line in project["dependencies"]]
    if extra:
        wanted += map(Requirement, project["optional-dependencies"][extra])
    found: set[str] = set()
    while wanted:
        need = wanted.pop()
        name = re.sub(r"[-_.]+", "-", need.name).lower()
        if name in found or not (need.marker is None or need.marker.evaluate({"extra": ""})):
            continue
        found.add(name)
        wanted += map(Requirement, importlib.metadata.requires(need.name) or ())
    return found


def list_files(packages: Iterable[str]) -> list[Path]:
    """All files of these packages, byte code left out."""
    files = [
        Path(str(file.locate()))
        for name in packages
        for file in importlib.metadata.files(name) or ()
        if file.suffix != ".pyc" and ".." not in file.parts
    ]
    return [file for file in files if file.is_file()]


def weigh_bytes(files: Iterable[Path]) -> int:
    """What these files weigh together."""
    return sum(file.stat().st_size for file in files)


def list_own_files() -> list[Path]:
    """What the wheel of pdcd itself holds."""
    return [
        file
        for top in ("pdcd", "drivers", "config", "systemd")
        for file in (ROOT / top).rglob("*")
        if file.is_file() and file.suffix != ".pyc"
    ]
