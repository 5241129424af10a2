"""How much an installation weighs: one that reads runs, and one that drives a bench."""

from __future__ import annotations

from pathlib import Path

from tests.bench.tables import Aim, Section, Table
from tests.light import GIVEN, MOST_BYTES, list_files, list_own_files, list_packages, weigh_bytes


def run(*, quick: bool, folder: Path) -> Section:
    """A row for each part; the same however quick it is to be."""
    table = Table("Weight on the disk, without byte code", ("what", "packages", "MB"))
    reads = list_packages()
    beside = reads - set(GIVEN)
    drives = list_packages("bench") - reads
    own_bytes = weigh_bytes(list_own_files())
    more_bytes = weigh_bytes(list_files(beside)) + own_bytes
    table.add("numpy, SciPy and OpenCV", str(len(GIVEN)), _mb(weigh_bytes(list_files(GIVEN))))
    table.add("all else that reads runs, pdcd included", str(len(beside) + 1), _mb(more_bytes))
    table.add("of it pdcd", "1", _mb(own_bytes))
    table.add("what the extra `bench` adds", str(len(drives)), _mb(weigh_bytes(list_files(drives))))
    return Section(
        "Weight of an installation",
        "Of the packages that are installed here, by the lists of their files.",
        [table],
        aims=[
            Aim(
                "packages that read runs, beyond numpy, SciPy and OpenCV",
                "MB",
                more_bytes / 1e6,
                MOST_BYTES / 1e6,
            )
        ],
    )


def _mb(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:.1f}"
