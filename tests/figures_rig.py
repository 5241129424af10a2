"""Figures for tests: taken coarsely, in this process, and looked at for their numbers alone."""

from __future__ import annotations

from pdcd.figures.figure import (
    TINY_MODE,
    BoundedNumber,
    FigureMode,
    FigurePhoto,
    PaperFigure,
    Photos,
)
from pdcd.figures.photo import photograph_takes


def taken(figure: PaperFigure, only: tuple[str, ...] = ()) -> dict[str, FigurePhoto]:
    """Photos of the captures of a figure, all or `only` those, in the mode of tests."""
    takes = figure.takes(TINY_MODE)
    return dict(photograph_takes({name: takes[name] for name in only or takes}, TINY_MODE))


def numbers_of(
    figure: PaperFigure, photos: Photos, mode: FigureMode = TINY_MODE
) -> dict[str, BoundedNumber]:
    """The numbers of a figure by what they say."""
    found = figure.shown(mode, photos)
    return {number.what: number for number in found if isinstance(number, BoundedNumber)}
