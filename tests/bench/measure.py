"""Time and memory of one function, in a process of its own.

``python -m tests.bench.measure MODULE:FUNCTION JSON`` calls the function with the keywords in the
JSON and prints what it returns as JSON; `alone` runs that and reads the answer.
"""

from __future__ import annotations

import importlib
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from tests.places import ROOT

T = TypeVar("T")

REPEATS = 3
LONG_S = 2.0
"""A call that takes longer is timed only once."""
TIMEOUT_S = 300.0


def alone(function: str, timeout_s: float = TIMEOUT_S, **keywords: Any) -> Any:
    """Result of "module:function" below `tests.bench`, called in a fresh interpreter. Raises
    TimeoutExpired."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.bench.measure", function, json.dumps(keywords)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=timeout_s,
    )
    if done.returncode != 0:
        raise RuntimeError(f"{function} {keywords} failed:\n{done.stderr}")
    return json.loads(done.stdout)


def timed(run: Callable[[], T], repeats: int = REPEATS) -> tuple[float, T]:
    """Median wall time of `repeats` calls in seconds, and what the last one returned.

    Calls that take longer than `LONG_S` are not repeated.
    """
    times: list[float] = []
    while len(times) < repeats and not (times and times[0] > LONG_S):
        result: T | None = None  # let go of the last one first: it would count as peak memory
        begun_s = time.perf_counter()
        result = run()
        times.append(time.perf_counter() - begun_s)
    return statistics.median(times), cast(T, result)


def peak_mib(process: int | str = "self") -> float:
    """Most memory that a process ever held in RAM, in MiB; this one unless told otherwise.

    Read from the kernel's VmHWM. `ru_maxrss` would start from the peak of the parent process,
    which Linux carries over when a child is started.
    """
    for line in Path(f"/proc/{process}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024.0
    raise RuntimeError("the kernel does not tell the peak memory (VmHWM)")


def _main() -> None:
    module, _, name = sys.argv[1].partition(":")
    function = getattr(importlib.import_module(f"tests.bench.{module}"), name)
    sys.stdout.write(json.dumps(function(**json.loads(sys.argv[2]))) + "\n")


if __name__ == "__main__":
    _main()
