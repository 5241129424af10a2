"""Where each value of the configuration comes from: typed, left at its default, or measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec

from pdcd.bench.calibration import MeasuredValue, read_calibration
from pdcd.bench.measured import (
    apply_calibration,
    choose_calibration_folder,
    compute_age_days,
    select_measured_values,
)
from pdcd.bench.reading import read_toml
from pdcd.bench.tables import Config


@dataclass(frozen=True)
class _Origin:
    """The origin of one value.

    typed : the value in the file, also where it was measured; None where the file has none.
    entry : how it was measured.
    """

    key: str
    value: Any
    how: Literal["typed", "default", "measured"]
    typed: Any = None
    entry: MeasuredValue | None = None

    @property
    def words(self) -> str:
        """The same for people, without the value."""
        if self.entry is None:
            return self.how
        said = f"measured {self.entry.made_utc[:16]} by {self.entry.step}"
        if isinstance(self.entry.sigma, int | float):
            said += f", sigma {self.entry.sigma:.2g}"
        return said if self.typed is None else f"{said}; the file has {self.typed!r}"


def trace_origins(source: Path | None, config: Config) -> Iterator[_Origin]:
    """Every value of a configuration as it is used, in the order of the tables.

    source : the file it was read from. Raises ConfigError as `apply_calibration` does.
    """
    typed = (
        {}
        if source is None
        else dict(_flat(read_toml(source, "the configuration", "", may_be_pipe=True)))
    )
    folder = choose_calibration_folder(config)
    measured = {}
    if folder is not None:
        measured = select_measured_values(read_calibration(folder)[0], config.calibration)
    used = msgspec.to_builtins(apply_calibration(config))
    for table, values in used.items():
        for name, value in values.items():
            key = f"{table}.{name}"
            entry = measured.get(key) or measured.get(f"{key}.map")
            said = typed.get(key)
            if entry is not None:
                yield _Origin(key, value, "measured", said, entry)
            else:
                yield _Origin(key, value, "typed" if key in typed else "default")


def describe_calibration_age(config: Config) -> str | None:
    """Which calibration is used and how old it is, for people; None for none."""
    folder = choose_calibration_folder(config)
    if folder is None:
        return None
    record, _ = read_calibration(folder)
    return f"{folder}, {compute_age_days(record):.1f} days old, {record.verdict}"


def _flat(table: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, values in table.items():
        if isinstance(values, dict):
            for key, value in values.items():
                yield f"{name}.{key}", value
