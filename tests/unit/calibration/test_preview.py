"""Previews of steps: a PNG file where matplotlib is installed, and nothing where it is not."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pdcd.calibration.preview import ArrowField, draw_arrows, write_step_preview


def draw(figure: Any) -> None:
    places = np.array([[0.2, 0.5], [0.8, 0.5], [0.5, 0.2]])
    vectors = np.array([[0.0, 1.0], [0.0, 1.0], [np.nan, 0.0]])
    draw_arrows(figure, [ArrowField(places, vectors, "moved")], text_below=True)
    figure.axes[0].set_title("")


def test_a_preview_is_a_picture_with_arrows_that_point_down(tmp_path: Path) -> None:
    """Of vectors that are as long as 95 % are, each is 6 % of the box, downwards from its place."""
    write_step_preview(tmp_path / "a.png", draw)
    seen = cv2.imread(str(tmp_path / "a.png"))
    assert seen is not None
    blue = (seen[..., 0] > 150) & (seen[..., 2] < 90)
    rows, cols = np.nonzero(blue)
    half = seen.shape[1] // 2
    assert (cols < half).any() and (cols > half).any()  # and none of what is no number
    assert np.abs(cols - half).min() > 0.2 * half
    assert rows.min() > 0.4 * seen.shape[0]
    assert np.ptp(rows) == pytest.approx(0.06 * np.ptp(cols) / 0.6, rel=0.2)


def test_fields_of_arrows_have_one_scale_unless_it_is_said(tmp_path: Path) -> None:
    def keys(*lengths_px: float) -> list[tuple[float, str]]:
        """Length of each measure, over the width of its box, and what is written beside it."""
        found = []

        def draw_all(figure: Any) -> None:
            fields = [
                ArrowField(np.full((9, 2), 0.5), np.full((9, 2), (length, 0.0)), "moved")
                for length in lengths_px
            ]
            draw_arrows(figure, fields)
            for axes in figure.axes:
                (arrows,) = axes.collections
                (key,) = (one for one in axes.artists if hasattr(one, "U"))
                found.append((key.U / arrows.scale, key.label))

        write_step_preview(tmp_path / "a.png", draw_all)
        return found

    pytest.importorskip("matplotlib")
    (first, text), (second, other) = keys(0.053, 0.042)
    assert (text, other) == ("0.05 px", "0.05 px") and first == pytest.approx(second)
    (first, text), (second, other) = keys(0.024, 0.145)
    assert text == "0.02 px; arrows are drawn 5 times as long as beside" and other == "0.1 px"
    assert first == pytest.approx(second) == pytest.approx(0.06 * 0.1 / 0.145)


def test_without_matplotlib_there_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    write_step_preview(tmp_path / "a.png", draw)
    assert not list(tmp_path.iterdir())
