"""Pictures and plots as they are seen: one scale a row, signs about grey, strips, one style."""

from __future__ import annotations

import io
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.figures.draw import PALETTE, UNKNOWN, draw_plot, draw_row, white_of
from pdcd.figures.figure import FigurePanel, FigurePlot, Line, PanelRow


def light(level: float = 1.0, size: tuple[int, int] = (40, 60)) -> NDArray[np.float32]:
    return np.full((*size, 3), level, np.float32)


def drawn(image: NDArray[Any], **more: Any) -> NDArray[np.uint8]:
    (found,) = draw_row(PanelRow((FigurePanel(image, "a caption", **more),)))
    return found


def test_white_is_what_the_brightest_hundredth_gets_to() -> None:
    image = np.linspace(0.0, 1.0, 10_001)[:, None]
    assert white_of(image) == white_of(-image) == pytest.approx(0.99 / 0.9, rel=1e-3)
    image[5:] = np.nan
    assert white_of(image) < 0.01
    assert white_of(np.full((2, 2), np.nan)) == 0.0


def test_panels_of_a_row_share_a_scale_unless_they_have_their_own() -> None:
    row = PanelRow(
        (
            FigurePanel(light(0.9), ""),
            FigurePanel(light(0.45), ""),
            FigurePanel(light(0.45), "", white=0.5),
        )
    )
    one, half, own = (int(found[0, 0, 0]) for found in draw_row(row))
    assert one == own > half > 0.5 * one  # a gamma lifts what is half as bright
    assert drawn(light(0.0))[0, 0].tolist() == [0, 0, 0]


def test_a_signed_picture_is_grey_at_nothing_and_straight_about_it() -> None:
    values = [-2.0, -1.0, 0.0, 0.5, 1.0, np.nan]
    found = [int(drawn(light(v), white=1.0, signed=True)[20, 20, 0]) for v in values]
    assert found == [0, 0, 128, 191, 255, UNKNOWN]


@pytest.mark.parametrize(("width", "shown"), [(100, 480), (479, 480), (500, 492), (1300, 1280)])
def test_pictures_lose_their_rim_and_are_as_wide_as_their_strip(width: int, shown: int) -> None:
    image = light(0.2, (80, width))
    rim = max(round(0.008 * width), 1)
    image[rim:-rim, rim:-rim] = 0.9
    found = drawn(image, white=1.0)
    height = round((80 - 2 * rim) * shown / (width - 2 * rim))
    assert found.shape[1] == shown and found.shape[0] > height
    assert np.ptp(found[:height]) <= 2  # nothing of the rim is left


def test_grey_panels_are_enlarged_by_whole_factors() -> None:
    pixels = np.array([[0, 255, 7], [9, 8, 6]], np.uint8)
    found = drawn(pixels, kind="grey")
    assert np.array_equal(found[:320].reshape(2, 160, 3, 160, 3)[:, 80, :, 80, 1], pixels)
    assert drawn(np.zeros((2, 7), np.uint8), kind="grey").shape[1] == 7 * 69
    colours = np.arange(600 * 3, dtype=np.uint8).reshape(1, 600, 3)
    assert np.array_equal(drawn(colours, kind="grey")[:1], colours)


def test_a_plot_has_all_that_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    figures = pytest.importorskip("matplotlib.figure")
    kept: list[Any] = []
    saved = figures.Figure.savefig

    def savefig(figure: Any, file: io.BytesIO, **how: Any) -> None:
        kept.append((figure.axes[0], how))
        saved(figure, file, **how)

    monkeypatch.setattr(figures.Figure, "savefig", savefig)
    x = [1.0, 10.0]
    lines = (Line(x, [0.1, 0.2], "one"), Line(x, [0.3, 0.4], style=":", colour=1),
             Line(x, [0.5, 0.6], style="_", colour="black"))  # fmt: skip
    data = draw_plot(
        FigurePlot("p", "title", "time, s", "light", "below", lines, scales=("log", "symlog"),
             marks=((2.0, "here"),), level=0.35, band=(3.0, 4.0), x_from=0.5, y_range=(0.0, None))
    )  # fmt: skip
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) is not None
    ((axes, how),) = kept
    # A time or a version of a library in it would change a file that is else the same.
    assert how["metadata"] == {"Software": None}
    assert (axes.get_title(), axes.get_xlabel(), axes.get_ylabel()) == ("title", "time, s", "light")
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "symlog")
    assert axes.get_xlim()[0] == 0.5 and axes.get_ylim()[0] == 0.0 and axes.get_ylim()[1] > 0.6
    assert [one.get_text() for one in axes.texts] == ["here"]
    assert [one.get_text() for one in axes.get_legend().get_texts()] == ["one"]
    seen = [(one.get_color(), one.get_ydata()[0]) for one in axes.get_lines()[:3]]
    assert seen == [(PALETTE[0], 0.1), (PALETTE[1], 0.3), ("black", 0.5)]
