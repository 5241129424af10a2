"""Charts and arrows for people: where points, lines and words land on the sheet."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.calibration import charts
from pdcd.calibration.arrows import arrows
from pdcd.calibration.charts import BLUE, GREY, INK, RED, Bytes, Chart, Colour, sheet, write


def drawn(on: Bytes, colour: Colour) -> np.ndarray:
    """(column, row) of the pixels of about a colour, as smooth edges have it, (n, 2)."""
    rows, cols = np.nonzero(np.abs(on.astype(int) - colour).max(axis=2) <= 45)
    return np.stack([cols, rows], axis=-1)


def chart(on: Bytes, x: tuple[float, float] = (0.0, 10.0)) -> Chart:
    """A box of 310 x 210 pixels from (80, 56), amid 70 to the left and 44 below."""
    return Chart(on, (10, 10, 400, 300), x, (-1.0, 1.0))


def test_a_sheet_is_white() -> None:
    on = sheet(30, 20)
    assert on.shape == (20, 30, 3) and on.dtype == np.uint8 and (on == 255).all()
    assert sheet().shape == (600, 900, 3)


@pytest.mark.parametrize(
    ("x", "y", "at"),
    [
        (0.0, -1.0, (80, 266)),
        (10.0, 1.0, (390, 56)),
        (5.0, 0.0, (235, 161)),
        (0.0, 1.0, (80, 56)),
        # What lies beyond is drawn close by: a twentieth of the box away.
        (99.0, 0.0, (406, 161)),
        (-99.0, 0.0, (64, 161)),
        (5.0, 99.0, (235, 46)),
        (5.0, -99.0, (235, 276)),
    ],
)
def test_points_lie_by_their_values_within_the_box(x: float, y: float, at: tuple[int, int]) -> None:
    found = chart(sheet(420, 320)).pixel(x, y)
    assert found == pytest.approx(at, abs=1)
    assert chart(sheet(9, 9)).pixel(0.0, -1.0) == (80, 266)
    assert chart(sheet(9, 9)).pixel(10.0, 1.0) == (390, 56)


def test_a_range_of_nothing_divides_by_nothing() -> None:
    assert chart(sheet(), x=(3.0, 3.0)).pixel(3.0, 0.0) == (80, 161)


def test_discs_are_drawn_for_all_that_is_finite() -> None:
    on = sheet(420, 320)
    box = chart(on)
    box.points([2.0, np.nan, 8.0], [0.5, 0.0, np.inf], BLUE)
    pixels = drawn(on, BLUE)
    assert np.abs(pixels - box.pixel(2.0, 0.5)).max() <= 3
    assert pixels.mean(axis=0) == pytest.approx(box.pixel(2.0, 0.5))
    small = sheet(420, 320)
    chart(small).points([2.0], [0.5], BLUE, radius_px=1)
    assert 0 < len(drawn(small, BLUE)) < len(pixels)


def test_of_many_points_some_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(charts, "MOST_POINTS", 5)
    for count, there in ((4, [0, 1, 2, 3]), (5, [0, 2, 4]), (10, [0, 3, 6, 9])):
        on = sheet(420, 320)
        box = chart(on)
        box.points(np.arange(count), np.zeros(count), RED, radius_px=1)
        found = [
            n for n in range(count) if (on[box.pixel(n, 0.0)[1], box.pixel(n, 0.0)[0]] == RED).all()
        ]
        assert found == there


def test_lines_go_from_point_to_point_past_what_is_not_finite() -> None:
    on = sheet(420, 320)
    box = chart(on)
    box.line([0.0, 5.0, np.nan, 10.0], [0.0, 0.0, 0.5, 0.0], GREY)
    pixels = drawn(on, GREY)
    assert set(pixels[:, 1].tolist()) == {161}
    assert (pixels[:, 0].min(), pixels[:, 0].max()) == pytest.approx((80, 390), abs=1)
    alone = sheet(420, 320)
    chart(alone).line([5.0], [0.0], GREY)
    assert not len(drawn(alone, GREY))


def test_an_error_bar_goes_up_and_down() -> None:
    on = sheet(420, 320)
    box = chart(on)
    box.bars([2.0, 6.0], [0.0, 0.5], [0.5, 0.25], RED)
    pixels = drawn(on, RED)
    for x, low, high in ((2.0, -0.5, 0.5), (6.0, 0.25, 0.75)):
        column, top = box.pixel(x, high)
        rows = pixels[pixels[:, 0] == column][:, 1]
        assert (rows.min(), rows.max()) == pytest.approx((top, box.pixel(x, low)[1]), abs=1)


def test_a_frame_has_its_box_and_its_ticks() -> None:
    on = sheet(420, 320)
    box = chart(on)
    box.frame("title", "x", "y", ticks=3)
    ink = {tuple(at) for at in drawn(on, INK).tolist()}
    for row in (100, 200):
        assert {(80, row), (390, row)} <= ink and not {(79, row), (391, row)} & ink
    faint = drawn(on, charts.FAINT)
    inner = faint[(faint[:, 0] > 85) & (faint[:, 0] < 385)]
    rows, counts = np.unique(inner[:, 1], return_counts=True)
    assert 161 in rows[counts > 200].tolist()
    words = drawn(on, INK)
    assert (words[:, 1] < 50).any() and (words[:, 1] > 275).any() and (words[:, 0] < 75).any()
    five = sheet(420, 320)
    chart(five).frame("title", "x", "y")
    lines = drawn(five, charts.FAINT)
    rows, counts = np.unique(lines[:, 1], return_counts=True)
    assert {109, 161, 213} <= {int(r) + d for r in rows[counts > 200] for d in (-1, 0, 1)}


def test_words_go_below_one_another() -> None:
    on = sheet(300, 100)
    write(on, ["HHH", "HHH"], (20, 10), RED)
    dark = np.flatnonzero((on != 255).any(axis=(1, 2)))
    gaps = np.flatnonzero(np.diff(dark) > 1)
    assert gaps.size == 1 and dark[0] > 10 and dark[-1] < 10 + 2 * charts.LINE_PX
    columns = np.flatnonzero((on != 255).any(axis=(0, 2)))
    assert columns[0] >= 19 and columns[-1] < 70
    first = sheet(420, 320)
    chart(first).note(0, "HHH")
    second = sheet(420, 320)
    chart(second).note(1, "HHH")
    assert np.array_equal(first[:-18], second[18:])
    seen = np.argwhere((first != 255).any(axis=2))
    assert seen[:, 0].min() > 56 and 80 < seen[:, 1].min() < 96


def test_a_legend_has_a_disc_and_words_for_each_colour() -> None:
    on = sheet(420, 320)
    chart(on).legend([("one", BLUE), ("two", RED)])
    discs = [drawn(on, colour).mean(axis=0) for colour in (BLUE, RED)]
    assert discs[0] == pytest.approx((390 - 150, 56 + 12))
    assert discs[1] - discs[0] == pytest.approx((0.0, 16.0))
    words = np.argwhere((on[:, 255:] != 255).any(axis=2))
    assert len(words) and words[:, 0].min() > 56 and words[:, 0].max() < 100


BOX = (50, 60, 500, 400)


def field(vectors: np.ndarray, places: np.ndarray) -> Bytes:
    on = sheet(700, 560)
    arrows(on, BOX, places, vectors, "title")
    return on


def test_arrows_are_enlarged_to_a_measure_of_their_own() -> None:
    """Of 2 px each: the measure is 2 px, and as long as 6 % of the box: 30 pixels."""
    places = np.array([[0.2, 0.3], [0.8, 0.7]])
    on = field(np.array([[2.0, 0.0], [0.0, 2.0]]), places)
    blue = drawn(on, BLUE)
    for place, (right, down) in zip(places, ((30, 0), (0, 30)), strict=True):
        tail = place * (500, 400) + (50, 60)
        near = blue[np.abs(blue - tail).max(axis=1) <= 40]
        low, high = near.min(axis=0), near.max(axis=0)
        assert high - tail == pytest.approx((max(right, 1), max(down, 1)), abs=1.5)
        assert tail - low == pytest.approx((1, 1), abs=1.5)
    ink = drawn(on, INK)
    ruler = ink[(ink[:, 1] >= 472) & (ink[:, 1] <= 476) & (ink[:, 0] <= 84)]
    assert (ruler[:, 0].min(), ruler[:, 0].max()) == pytest.approx((50, 80), abs=2)


def test_arrows_much_longer_than_others_are_red() -> None:
    vectors = np.tile([0.1, 0.0], (40, 1))
    places = np.stack([np.linspace(0.1, 0.6, 40), np.full(40, 0.5)], axis=-1)
    assert not len(drawn(field(vectors, places), RED))
    vectors[7] = (0.31, 0.0)
    assert len(drawn(field(vectors, places), RED))
    vectors[7] = (0.29, 0.0)
    assert not len(drawn(field(vectors, places), RED))


def test_what_is_not_finite_has_no_arrow_and_nothing_is_borne() -> None:
    places = np.array([[0.2, 0.5], [0.5, 0.5], [np.nan, 0.5]])
    on = field(np.array([[1.0, 0.0], [np.nan, 0.0], [1.0, 0.0]]), places)
    blue = drawn(on, BLUE)
    assert len(blue) and np.abs(blue - (150, 260)).max() < 40
    assert not len(drawn(field(np.zeros((0, 2)), np.zeros((0, 2))), BLUE))
    for at in ((300, 60), (300, 460), (50, 200), (550, 200)):
        assert (on[at[1], at[0]] == GREY).all()
