"""The command line, called in this process as `python -m pdcd` would be."""

from __future__ import annotations

import contextlib
import io
import json
import os
import runpy
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Said:
    """How a command ended.

    out, err : what it printed. lines : of `out` those that are JSON, read.
    """

    code: int
    out: str
    err: str
    lines: list[Any]

    @property
    def last(self) -> dict[str, Any]:
        """The last JSON object; an empty one where there is none."""
        found = self.lines[-1] if self.lines else {}
        return found if isinstance(found, dict) else {}

    @property
    def folder(self) -> Path | None:
        """The folder of the run that it took."""
        found = self.last.get("folder")
        return None if found is None else Path(found)


def call_pdcd(words: Sequence[str]) -> Said:
    """Run one command in this process and catch what it prints."""
    out, err = io.StringIO(), io.StringIO()
    code = 0
    with _arguments(["pdcd", *words]), warnings.catch_warnings():
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                runpy.run_module("pdcd", run_name="__main__", alter_sys=True)
            except SystemExit as end:
                code = end.code if isinstance(end.code, int) else int(end.code is not None)
    return Said(code, out.getvalue(), err.getvalue(), list(_json_lines(out.getvalue())))


def _json_lines(text: str) -> Iterator[Any]:
    for line in text.splitlines():
        with contextlib.suppress(ValueError):
            yield json.loads(line)


@contextlib.contextmanager
def _arguments(words: list[str]) -> Iterator[None]:
    before = sys.argv
    sys.argv = words
    try:
        yield
    finally:
        sys.argv = before


def own_environment(scratch: Path, tree: Path) -> dict[str, str]:
    """Variables of a process that takes goldens: its own home, state and sockets, this tree's
    modules, one thread for the linear algebra, and nothing of the caller's benches."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PDCD", "XDG_", "OMP_", "OPENBLAS_", "MKL_", "PYTHON"))
        and name not in ("STATE_DIRECTORY", "RUNTIME_DIRECTORY", "DISPLAY", "INVOCATION_ID")
    }
    return {
        **kept,
        "HOME": str(scratch / "home"),
        "TMPDIR": str(scratch / "tmp"),
        "XDG_CONFIG_HOME": str(scratch / "home" / "config"),
        "XDG_CACHE_HOME": str(scratch / "home" / "cache"),
        "PYTHONPATH": str(tree),
        "PYTHONHASHSEED": "0",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "COLUMNS": "100",
        "LC_ALL": "C.UTF-8",
        "TZ": "UTC",
        "MPLBACKEND": "agg",
        "LIBGL_ALWAYS_SOFTWARE": "1",
        "LP_NUM_THREADS": "0",
    }


def case_environment(scratch: Path) -> dict[str, str]:
    """Variables that each case has of its own: what it learns stays with it."""
    return {"XDG_STATE_HOME": str(scratch / "state"), "XDG_RUNTIME_DIR": str(scratch / "run")}
