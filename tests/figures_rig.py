"""Figures for tests: taken coarsely, in this process, and looked at for their numbers alone."""

from __future__ import annotations

from dataclasses import replace

from pdcd.figures.figure import (
    PAPER_PROFILE,
    BoundedNumber,
    FigureMode,
    FigurePhoto,
    PaperFigure,
    Photos,
)
from pdcd.figures.photo import photograph_takes

TINY_MODE = FigureMode("tiny", (12, 16), (120, 80), 100, True, thrift=4, least_codes=16)


def taken(
    figure: PaperFigure, only: tuple[str, ...] = (), profile: str = PAPER_PROFILE
) -> dict[str, FigurePhoto]:
    """Photos of the captures of a figure, all or `only` those, in the mode of tests."""
    mode = replace(TINY_MODE, profile=profile)
    takes = figure.takes(mode)
    return dict(photograph_takes({name: takes[name] for name in only or takes}, mode))


def numbers_of(
    figure: PaperFigure, photos: Photos, mode: FigureMode = TINY_MODE
) -> dict[str, BoundedNumber]:
    """The numbers of a figure by what they say."""
    found = figure.shown(mode, photos)
    return {number.what: number for number in found if isinstance(number, BoundedNumber)}
