"""What is kept and told of runs: values that nobody changes, fields by name, numbers in bounds."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from pdcd.protocol import events
from pdcd.runs.folder import is_made_later, name_row_file
from pdcd.runs.record import Nanoseconds, RecordCount, RecordPositive, Sha256
from pdcd.runs.walk import is_job, parse_spot


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        (RecordCount, (0, 1, 2**62), (-1, 2**62 + 1, 0.5)),
        (Nanoseconds, (-(2**62), 0, 2**62), (-(2**62) - 1, 2**62 + 1)),
        (RecordPositive, (1e-300, 1.0, 7e9), (0.0, -1.0)),
        (Sha256, ("0" * 64, "a9f" * 21 + "0"), ("0" * 63, "0" * 65, "A" * 64, "g" * 64)),
        (events.EventCount, (0, 1), (-1,)),
        (events.ShotName, ("a",), ("",)),
    ],
)
def test_numbers_that_are_kept_have_bounds(
    kind: Any, good: tuple[object, ...], bad: tuple[object, ...]
) -> None:
    for value in good:
        assert msgspec.convert(value, kind) == value
    for value in bad:
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert(value, kind)


def test_files_that_are_made_later_have_these_names_only() -> None:
    assert name_row_file("coded", (3, 12)) == "row-coded-3-12.png"
    good = ("report.html", name_row_file("coded", (3, 12)), name_row_file("a" * 64, (999999, 0)))
    bad = (
        "report.htm", "reportXhtml", name_row_file("a" * 65, (0, 0)), name_row_file("", (0, 0)),
        name_row_file("a", (1000000, 0)), name_row_file("a", (0, 1000000)), name_row_file("é", (0,
        0)),
        "raw/report.html", name_row_file("a", (0, 0)) + "\n",
    )  # fmt: skip
    assert all(map(is_made_later, good)) and not any(map(is_made_later, bad))


@pytest.mark.parametrize(
    ("text", "job"),
    [
        ("20260101T000001Z-00ff", True),
        ("captures/20260101T000001Z-00ff", False),
        ("20260101T000001Z-00ff.partial", False),
        ("vase", False),
        ("", False),
    ],
)
def test_a_job_is_named_by_its_time_and_four_digits(text: str, job: bool) -> None:
    assert is_job(text) is job


@pytest.mark.parametrize(
    "ending",
    [
        "", ".partial", "-partial", "-decoded-1.partial", "-partial-decoded-1234.partial",
        "-partial.partial", ".removed", "-partial.removed", ".partial.removed",
        "-decoded-3.partial.removed", "-partial-decoded-3.partial.removed",
    ],
)  # fmt: skip
def test_how_a_run_stands_is_told_by_the_ending_of_its_name(ending: str) -> None:
    found = parse_spot(f"captures/20260101T000001Z-00ff{ending}")
    assert found is not None and not found.preview and not found.foreign
    assert (found.job, found.ending) == ("20260101T000001Z-00ff", ending)
    preview = parse_spot(f"preview/20260101T000001Z-00ff{ending}")
    assert preview is not None and preview.preview


@pytest.mark.parametrize("ending", ["x", "-decoded-1", "-decoded-12345.partial", ".partial2"])
def test_any_other_name_is_no_run(ending: str) -> None:
    assert parse_spot(f"20260101T000001Z-00ff{ending}") is None
