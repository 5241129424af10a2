"""Wheels and archives of the sources: made, and installed where nothing else is."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.places import ROOT

_LIMIT_S = 170.0


def run(*command: str | Path, folder: Path, ends: int = 0) -> str:
    """What a program says, called as by a user: in a folder of their own. Where it is to fail, what
    it says is its complaint."""
    kept = {k: v for k, v in os.environ.items() if k in ("PATH", "LANG", "TMPDIR")}
    done = subprocess.run(
        [*map(str, command)],
        cwd=folder,
        env={**kept, "HOME": str(folder)},
        capture_output=True,
        text=True,
        timeout=_LIMIT_S,
        check=False,
    )
    assert done.returncode == ends, done.stdout + done.stderr
    return done.stderr if ends == 2 else done.stdout


def make_distribution(kind: str, folder: Path, root: Path = ROOT) -> Path:
    """The "wheel" or "sdist" of a tree, made in a folder."""
    folder.mkdir(exist_ok=True)
    run(sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", folder, folder=root)
    (made,) = folder.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return made


def find_base_python() -> str | None:
    """The Python outside of this environment, where it has a pip."""
    base = getattr(sys, "_base_executable", sys.executable)
    asked = subprocess.run([base, "-m", "pip", "--version"], capture_output=True, check=False)
    return None if asked.returncode else base


def install_wheel(wheel: Path, folder: Path) -> Path:
    """Where packages are in a new environment `env` of a folder, which has the wheel alone."""
    base = find_base_python()
    assert base is not None
    run(base, "-m", "venv", "--without-pip", folder / "env", folder=folder)
    python = folder / "env" / "bin" / "python"
    options = ("--no-deps", "--no-index", "--disable-pip-version-check")
    run(base, "-m", "pip", "--python", python, "install", *options, wheel, folder=folder)
    (packages,) = (folder / "env" / "lib").glob("python3*/site-packages")
    return packages
