"""What the figures were measured on."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from pathlib import Path

PACKAGES = ("numpy", "scipy", "rawpy", "matplotlib")
THREADS = "OMP_NUM_THREADS"


def describe() -> list[tuple[str, str]]:
    """Name and value of everything that the figures depend on."""
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in PACKAGES)
    load = os.getloadavg()[0]
    return [
        ("processor", _cpu_model()),
        ("cores usable", str(len(os.sched_getaffinity(0)))),
        ("memory", f"{_memory_gib():.0f} GiB"),
        ("threads of the linear algebra", os.environ.get(THREADS, "as many as cores")),
        ("load of the machine at the start (1 min)", f"{load:.1f}"),
        ("system", f"{platform.system()} {platform.machine()}"),
        ("python", platform.python_version()),
        ("packages", versions),
    ]


def _cpu_model() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        name, _, value = line.partition(":")
        if name.strip() == "model name":
            return value.strip()
    return platform.processor() or "unknown"


def _memory_gib() -> float:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
