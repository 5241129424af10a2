"""The picture of a display's times."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.presenter.messages import Ready
from pdcd.presenter.timing import RefreshTiming, draw_histogram


def timing() -> RefreshTiming:
    """Three refreshes, two of them late by one and by two."""
    seconds = np.array([0.010, 0.020, 0.030])
    return RefreshTiming(Ready("swap", 100.0, {}), seconds, np.array([0, 1, 2]), seconds, seconds,
                  seconds / 10, 0.001)  # fmt: skip


class Axes:
    """One plot: what it was told, by name."""

    def __init__(self) -> None:
        self.told: dict[str, Any] = {}

    def __getattr__(self, name: str) -> Any:
        def tell(*words: Any, **how: Any) -> None:
            self.told[name] = (*words, how)

        return tell


class Figure(Axes):
    """A figure of two plots beside each other."""

    made: list[Figure]

    def __init__(self, **how: Any) -> None:
        super().__init__()
        self.how, self.axes = how, (Axes(), Axes())
        self.made.append(self)

    def subplots(self, rows: int, columns: int) -> tuple[Axes, Axes]:
        assert (rows, columns) == (1, 2)
        return self.axes


def test_a_picture_has_both_times_in_milliseconds_and_says_what_was_missed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    Figure.made = []
    monkeypatch.setitem(sys.modules, "matplotlib.figure", SimpleNamespace(Figure=Figure))
    draw_histogram(timing(), Path("a.png"))
    (made,) = Figure.made
    for axes, milliseconds, label in zip(
        made.axes, ([10.0, 20.0, 30.0], [1.0, 2.0, 3.0]), ("refresh to refresh / ms",
        "processor time of a refresh / ms"), strict=True,
    ):  # fmt: skip
        shown, how = axes.told["hist"]
        np.testing.assert_allclose(shown, milliseconds)
        # A single late one among thousands is to be seen.
        assert how["log"] is True and how["bins"] == 80 and how["color"].startswith("#")
        assert axes.told["set_xlabel"][0] == label
        assert axes.told["set_ylabel"][0] == "refreshes"
        sizes = [axes.told[f"set_{axis}label"][1]["fontsize"] for axis in "xy"]
        assert sizes == [9, 9] and axes.told["tick_params"] == ({"labelsize": 8},)
        assert axes.told["grid"] == ({"alpha": 0.3},)
    title, how = made.told["suptitle"]
    assert title == "3 refreshes, 3 missed, time source swap" and how == {"fontsize": 10}
    assert made.told["savefig"] == (Path("a.png"), {"dpi": 110})
    assert made.how == {"figsize": (8.0, 3.2), "layout": "constrained"}


def test_without_the_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ConfigError, match=r"needs matplotlib \(.* install matplotlib\)"):
        draw_histogram(timing(), Path("a.png"))
