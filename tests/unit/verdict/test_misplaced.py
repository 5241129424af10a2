"""What a user reads of panels that lie elsewhere."""

from __future__ import annotations

import pytest
from msgspec import structs

from pdcd.bench.tables import PanelConfig
from pdcd.panels.placing import Placing
from pdcd.pictures.lost_direct import LostDirectLight
from pdcd.runs.record import PanelLook, Six
from pdcd.verdict.causes import Grade
from pdcd.verdict.misplaced import (
    judge_camera_place,
    judge_mask_blur,
    judge_mask_place,
    judge_unseen_panels,
)

SIZE = (1024, 768)


def look(mask: Six | None = None, camera: Six | None = None, *, seen: bool = True) -> PanelLook:
    return PanelLook(mask=mask, camera=camera, rest_px=0.0, direct=0.8, mask_seen=seen)


@pytest.mark.parametrize(
    ("share", "grade"),
    [(0.059, None), (0.06, Grade.DOUBTFUL), (0.39, Grade.DOUBTFUL), (0.4, Grade.BAD)],
)
def test_a_mask_counts_by_what_it_does_to_the_answer(share: float, grade: Grade | None) -> None:
    moved = look((1.0, 0.0, 24.0, 0.0, 1.0, -3.0))
    mask = PanelConfig(size_px=(1600, 1200), place=Placing(offset_px=(1.0, 1.0)))
    found = list(judge_mask_place(moved, mask, SIZE, LostDirectLight(0.1, 0.2), share, 100.0))
    assert [one.grade for one in found] == ([] if grade is None else [grade])
    for one in found:
        assert "24.0 px right and 3.0 px up" in one.text
        assert "set offset_px = [25.0, -2.0] in [mask.place]" in one.text


def test_a_mirrored_mask_and_one_a_cell_off_are_bad_whatever_the_answer_is() -> None:
    mask = PanelConfig(size_px=(1600, 1200))
    mirrored = look((-1.0, 0.0, 1024.0, 0.0, 1.0, 0.0))
    (one,) = judge_mask_place(mirrored, mask, SIZE, LostDirectLight(1.0, 1.0), 0.0, 16.0)
    assert one.grade == Grade.BAD and 'set flip = "horizontal"' in one.text
    far = look((1.0, 0.0, 40.0, 0.0, 1.0, 0.0))
    (one,) = judge_mask_place(far, mask, SIZE, LostDirectLight(1.0, 1.0), 0.0, 16.0)
    assert one.grade == Grade.BAD


@pytest.mark.parametrize(
    ("right", "grades"), [(3.7, []), (3.9, [Grade.DOUBTFUL]), (4.1, [Grade.DOUBTFUL])]
)
def test_a_mask_a_quarter_of_a_cell_off_is_doubtful_whatever_the_answer_is(
    right: float, grades: list[Grade]
) -> None:
    """Direct light loses little to wrong cells, but quads were open at other times. Blocks are
    found to a fifth of a pixel here."""
    moved = look((1.0, 0.0, right, 0.0, 1.0, 0.0))
    mask = PanelConfig(size_px=(1600, 1200))
    found = list(judge_mask_place(moved, mask, SIZE, LostDirectLight(0.01, 0.02), 0.01, 16.0, 0.2))
    assert [one.grade for one in found] == grades


@pytest.mark.parametrize(
    ("share", "lost", "grade"),
    [(0.05, 0.1, None), (0.07, 0.1, Grade.DOUBTFUL), (0.5, 0.1, Grade.BAD), (0.3, 0.6, Grade.BAD)],
)
def test_a_blur_counts_by_what_it_does_to_the_answer(
    share: float, lost: float, grade: Grade | None
) -> None:
    """Where it sends more than half of the direct light astray, photos tell no share."""
    blurred = structs.replace(look((1.0, 0.0, 0.0, 0.0, 1.0, 0.0)), blur_px=8.2)
    found = judge_mask_blur(blurred, blurred.blur_px, 1.5, LostDirectLight(lost, lost), share)
    assert [one.grade for one in found] == ([] if grade is None else [grade])
    for one in found:
        assert "by 8.2 px" in one.text and "by the 1.5 px" in one.text


def test_blocks_that_are_not_seen_and_a_camera_that_looks_elsewhere_are_doubtful() -> None:
    for one, word in ((look(), "projector"), (look(seen=False), "polarisers")):
        (finding,) = judge_unseen_panels(one, measured=True)
        assert finding.grade == Grade.DOUBTFUL and word in finding.text
    assert list(judge_unseen_panels(look((1.0, 0.0, 0.0, 0.0, 1.0, 0.0)), measured=False)) == []
    for right, grades in ((7.9, []), (8.1, [Grade.DOUBTFUL])):
        aside = look(camera=(1.0, 0.0, right, 0.0, 1.0, 0.0))
        assert [f.grade for f in judge_camera_place(aside, Placing(), SIZE, 16.0)] == grades


def test_where_nobody_could_look_the_word_of_a_calibration_is_taken() -> None:
    nobody = structs.replace(look(seen=False), why="the display takes none")
    (finding,) = judge_unseen_panels(nobody, measured=False)
    assert finding.grade == Grade.DOUBTFUL
    assert "were not checked" in finding.text and "the display takes none" in finding.text
    assert list(judge_unseen_panels(nobody, measured=True)) == []


def test_panels_are_upright_where_blocks_showed_both_so() -> None:
    here, turned = (1.0, 0.0, 3.0, 0.0, 1.0, 0.0), (-1.0, 0.0, 1024.0, 0.0, -1.0, 768.0)
    assert look(here, here).upright
    for mask, camera in ((turned, here), (here, turned), (None, None)):
        assert not look(mask, camera).upright
