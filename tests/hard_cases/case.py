"""What a hard case is: an error, measured against an independent reference, and its bound."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RECORD = "PDCD_HARD_CASES"
"""Environment variable that names a JSON lines file to which every measured case is added."""


@dataclass(frozen=True)
class Outcome:
    """Error of the program, and of the plain way that the case is hard for, if it has one."""

    error: float
    naive: float | None = None


@dataclass(frozen=True)
class Case:
    """One hard case.

    error, bound : what is measured, and the largest value allowed, in the unit `measure` names.
    reference : what it is measured against.
    naive : the plain way that exceeds the bound, which shows that the case is hard; "" is none.
    """

    name: str
    measure: str
    reference: str
    bound: float
    run: Callable[[], Outcome]
    naive: str = ""


@dataclass(frozen=True)
class Row:
    """One measured case, as tables and JSON lines have it."""

    name: str
    error: float
    measure: str
    reference: str
    bound: float
    naive: str
    naive_error: float | None


def measured(case: Case) -> Row:
    """Run a case; add it to the file that `PDCD_HARD_CASES` names, if it does."""
    outcome = case.run()
    row = Row(
        case.name,
        outcome.error,
        case.measure,
        case.reference,
        case.bound,
        case.naive,
        outcome.naive,
    )
    path = os.environ.get(RECORD)
    if path:
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(row)) + "\n")
    return row


def check(case: Case) -> None:
    """Assert that the program keeps the bound and that the plain way, where there is one, fails."""
    row = measured(case)
    assert row.error <= row.bound, f"{row.name}: {row.error:.3g} > {row.bound:.3g}"
    assert (row.naive_error is None) == (not row.naive)
    if row.naive_error is not None:
        assert row.naive_error > row.bound, f"{row.naive} would do: {row.naive_error:.3g}"


def worst(got: NDArray[np.floating], exact: Iterable[Fraction], scale: Fraction) -> float:
    """Largest absolute difference between numbers and exact ones, over `scale`.

    The subtraction itself is done in fractions: no digit of the difference is lost.
    """
    pairs = zip(np.ravel(got).tolist(), exact, strict=True)
    return float(max(abs(Fraction(g) - e) for g, e in pairs) / scale)
