"""Entry point: ``python -m tests.bench [--quick]`` from the root of the repository."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

from tests import world
from tests.bench import (
    calibrating,
    camera,
    closed_form,
    code_error,
    error_seconds,
    growth,
    machine,
    machine_vision,
    pilots,
    pixels,
    planes,
    presenter,
    ranges,
    report,
    three_benches,
    throughput,
    weight,
)
from tests.bench import hard_cases as hard
from tests.bench import whole_capture as capture
from tests.bench.tables import Section
from tests.places import ROOT

SECTIONS: tuple[Callable[..., Section], ...] = (
    closed_form.run,
    code_error.run,
    ranges.run,
    pilots.run,
    error_seconds.run,
    capture.run,
    three_benches.run,
    growth.run,
    throughput.run,
    camera.run,
    machine_vision.run,
    pixels.run,
    planes.run,
    calibrating.run,
    presenter.section,
    weight.run,
    hard.run,
)


def main() -> None:
    """Measure everything, print the tables, write the report and the plots."""
    world.enter()
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer cases, below a minute")
    parser.add_argument(
        "--out", type=Path, default=ROOT / "docs", help="folder of benchmarks.md and plots/"
    )
    args = parser.parse_args()
    facts = machine.describe()
    begun_s = time.perf_counter()
    sections = []
    for run in SECTIONS:
        since_s = time.perf_counter()
        section = run(quick=args.quick, folder=args.out / "plots")
        sections.append(section)
        for table in section.tables:
            sys.stdout.write(table.text())
        sys.stdout.write(f"\n({section.title}: {time.perf_counter() - since_s:.0f} s)\n")
        sys.stdout.flush()
    took_s = time.perf_counter() - begun_s
    facts.append(("this run", f"{'quick, ' if args.quick else ''}{took_s:.0f} s"))
    sys.stdout.write(report.aims_table(sections).text())
    report.write(args.out / "benchmarks.md", sections, facts, "plots")


if __name__ == "__main__":
    main()
