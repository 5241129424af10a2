"""What the name of a folder says of a run."""

from __future__ import annotations

import pytest

from pdcd.runs.walk import is_job, parse_spot


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
