"""What fits of misplaced panels and shares of direct light come to."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.verdict.causes import Grade
from pdcd.verdict.panels import judge_panel_places
from pdcd.verdict.placement import PlacementFit

BAD, DOUBTFUL = Grade.BAD, Grade.DOUBTFUL
NONE = np.zeros(0)
BELIEVED = "as believed"


def grades(shares: object, fits: list[PlacementFit], stack: list[PlacementFit]) -> list[Grade]:
    return [f.grade for f in judge_panel_places(np.asarray(shares), fits, stack)]


@pytest.mark.parametrize(
    ("share", "chance", "sure"),
    [
        (0.29, 60.0, False), (0.9, 5.9, False), (0.31, 6.1, True), (-0.31, -6.1, True),
        (1.4, 60.0, True), (1.6, 60.0, False),  # no more light can follow codes than there is
    ],
)  # fmt: skip
def test_a_fingerprint_needs_its_share_and_more_than_chance(
    share: float, chance: float, sure: bool
) -> None:
    fit = PlacementFit("mirrored", share, chance)
    assert grades(NONE, [fit], []) == grades(NONE, [], [fit]) == [BAD] * sure


@pytest.mark.parametrize("share", [0.35, -0.35])
@pytest.mark.parametrize(("middle", "grade"), [(0.34, [BAD]), (0.36, []), (0.9, [])])
def test_a_photo_with_more_direct_light_in_place_speaks_of_the_scene(
    share: float, middle: float, grade: list[Grade]
) -> None:
    """As of the pages of a book, which send each other light from mirrored places."""
    shares, fit = [0.0, middle, 1.0], PlacementFit("mirrored", share, 9.0 * np.sign(share))
    assert grades(shares, [fit], []) == grade
    assert grades(shares, [], [fit]) == [BAD]


def test_of_panels_that_blocks_showed_upright_only_inverse_codes_speak() -> None:
    mirrored, inverse = PlacementFit("mirrored", 0.9, 30.0), PlacementFit(BELIEVED, -0.9, -90.0)
    assert judge_panel_places(NONE, [mirrored], [], upright=True) == []
    (found,) = judge_panel_places(NONE, [], [inverse], upright=True)
    assert found.grade == BAD and "a panel is inverted" in found.text


def test_the_surest_of_wrong_places_is_named() -> None:
    fits = [
        PlacementFit("a", 0.9, 7.0), PlacementFit("b", -0.5, -9.0), PlacementFit("c", 0.8, 8.0),
        PlacementFit("d", 0.2, 90.0),
    ]  # fmt: skip
    (found,) = judge_panel_places(NONE, fits, [])
    assert found.text.startswith("a panel is b and inverted: 50 % of the light follows codes")
    (found,) = judge_panel_places(NONE, fits[:1], [])
    assert found.text.startswith("a panel is a: 90 %") and "(limit 30 %)" in found.text
    (found,) = judge_panel_places(NONE, [], [PlacementFit(BELIEVED, -0.4, -7.0)])
    assert found.text.startswith("a panel is inverted: 40 %")


def test_the_best_tenth_of_all_places_must_have_direct_light() -> None:
    for count, grade in ((2, []), (1, [DOUBTFUL])):  # of eleven the second best counts
        assert grades([0.2] * count + [0.0] * (11 - count), [], []) == grade
    (found,) = judge_panel_places(np.full(7, 0.125), [], [])
    assert "(at most 12.5 % in nine of ten places, limit 15 %)" in found.text
    assert grades(NONE, [], []) == []


def test_less_direct_light_than_none_is_an_inverted_panel() -> None:
    assert grades([-0.3, -0.2, 0.9], [], []) == []  # the median is the limit: not below it
    (found,) = judge_panel_places(np.array([-0.3, -0.25, 0.9]), [], [])
    assert found.grade == BAD and "(direct light -25 %, limit -20 %)" in found.text


def test_single_codes_speak_of_direct_light_where_photos_of_codes_do_not() -> None:
    """They went through an open mask, and would be as bright behind one that lies anywhere."""
    for share, grade in ((0.5, []), (0.1, [DOUBTFUL])):
        stack = [PlacementFit(BELIEVED, share, 3.0), PlacementFit("mirrored", -0.9, -3.0)]
        assert grades(NONE, [], stack) == grade
        assert grades(np.full(9, -0.9), [], stack) == [BAD]
        assert grades(np.full(9, 0.1), [], stack) == [DOUBTFUL]
        assert grades(np.full(9, 0.5), [], stack) == []
