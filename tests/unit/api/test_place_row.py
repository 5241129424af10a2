"""The row of an acceptance that says whether panels lie where they are believed to."""

from __future__ import annotations

import pytest

from pdcd.api.acceptance import make_place_row
from pdcd.runs.record import PanelLook
from pdcd.verdict.causes import Cause, Grade, VerdictFinding, judge

IN_PLACE = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
SEEN = PanelLook(
    mask=IN_PLACE, camera=IN_PLACE, rest_px=0.1, sigma_px=0.25, direct=0.9, mask_seen=True
)
UNSEEN = PanelLook(mask=None, camera=None, rest_px=0.0, direct=0.0, mask_seen=True)


@pytest.mark.parametrize("grade", [Grade.DOUBTFUL, Grade.BAD])
@pytest.mark.parametrize("cause", [Cause.WRONG_WAY, Cause.BESIDE_MASK])
def test_whatever_the_verdict_says_of_places_fails(cause: Cause, grade: Grade) -> None:
    """In any words: of these, some name neither mask nor camera."""
    said = [VerdictFinding(Grade.DOUBTFUL, "less", cause), VerdictFinding(grade, "worst", cause)]
    row = make_place_row(SEEN, said)
    assert (row.state, row.found) == ("fail", "less" if grade is Grade.DOUBTFUL else "worst")
    assert "calibrate geometry" in row.advice


def test_codes_that_do_not_meet_are_a_matter_of_times() -> None:
    row = make_place_row(SEEN, judge(Cause.CODES_APART, 0.5, lost=0.2, elsewhere=""))
    assert row.state == "fail" and "calibrate timing" in row.advice


def test_a_blur_is_a_matter_of_focus_and_registration() -> None:
    row = make_place_row(SEEN, judge(Cause.MASK_BLUR, 0.5, blur_px=4.0, known_px=0.0, lost=0.2))
    assert row.state == "fail" and "calibrate registration" in row.advice


def test_remarks_pass() -> None:
    said = [VerdictFinding(Grade.REMARK, "the mask is a little small", Cause.BESIDE_MASK)]
    row = make_place_row(SEEN, said)
    assert (row.state, row.found) == ("pass", "as believed, to 0.25 projector pixels")


def test_where_nobody_looked_it_says_so() -> None:
    why = "too few quads"
    blind = PanelLook(mask=None, camera=None, rest_px=0.0, direct=0.0, mask_seen=False, why=why)
    said = judge(Cause.NOBODY_LOOKED, why=why)
    assert said and make_place_row(blind, said).state == "not tried"
    assert make_place_row(blind, said).found == why
    assert make_place_row(None, []).state == "not tried"
    wrong = [*said, *judge(Cause.WRONG_WAY, 0.9, how="inverted")]
    assert make_place_row(blind, wrong).state == "fail"  # by light that follows codes


def test_blocks_that_are_not_seen_fail() -> None:
    row = make_place_row(UNSEEN, judge(Cause.PROJECTOR_UNSEEN))
    assert row.state == "fail" and "projector" in row.found
