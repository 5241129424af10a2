"""From sections to `docs/benchmarks.md`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tests.bench.tables import Aim, Section, Table

BY_SUBJECT = "## By subject"
"""Heading of what other scripts have measured, which stays as it is here; the next one follows."""

SOAK = "## Soak"
"""Heading of the last section, which is written by `make soak` and stays as it is here."""

INTRODUCTION = (
    "Written by `make bench` (`python -m tests.bench`); every figure below was measured in one run "
    "of it, on the machine described here. Times are wall-clock. Do not edit: run it again."
)


def aims_table(sections: Sequence[Section]) -> Table:
    """All aims of all sections, with the figures of this run."""
    table = Table("Aims", ("aim", "limit", "measured", "reached"))
    for aim in (aim for section in sections for aim in section.aims):
        table.add(aim.what, _value(aim, aim.limit), _value(aim, aim.measured), _yes(aim))
    return table


def write(
    path: Path, sections: Sequence[Section], machine: Sequence[tuple[str, str]], plots: str
) -> None:
    """Write the report; `plots` is the folder of the plots, relative to it."""
    facts = Table("Machine", ("what", "value"))
    for name, value in machine:
        facts.add(name, value)
    parts = ["# Benchmarks: speed against error", INTRODUCTION]
    parts += [facts.markdown(), "## Aims", aims_table(sections).markdown()]
    for section in sections:
        parts += [f"## {section.title}", section.text]
        parts += [table.markdown() for table in section.tables]
        parts += [f"![{caption}]({plots}/{name})" for name, caption in section.plots]
    path.parent.mkdir(parents=True, exist_ok=True)
    before = path.read_text(encoding="utf-8") if path.exists() else ""
    first = next((title for title in (BY_SUBJECT, SOAK) if title in before), "")
    parts += [first + before.partition(first)[2].rstrip()] if first else []
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def write_soak(path: Path, text: str) -> None:
    """Put what a soak found at the end of the report, in the place of the last one."""
    report = path.read_text(encoding="utf-8").partition(SOAK)[0].rstrip()
    path.write_text(f"{report}\n\n{SOAK}\n\n{text.strip()}\n", encoding="utf-8")


def _value(aim: Aim, value: float) -> str:
    return f"{value:.3g} {aim.unit}" if value < 1000 else f"{value:.0f} {aim.unit}"


def _yes(aim: Aim) -> str:
    return "yes" if aim.reached else "**no**"
