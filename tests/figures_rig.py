"""Figures for tests: taken coarsely, in this process, and looked at for their numbers alone."""

from __future__ import annotations

from pdcd.figures.figure import TINY, Figure, Mode, Number, Photo, Photos
from pdcd.figures.photo import photographs


def taken(figure: Figure, only: tuple[str, ...] = ()) -> dict[str, Photo]:
    """Photos of the captures of a figure, all or `only` those, in the mode of tests."""
    takes = figure.takes(TINY)
    return dict(photographs({name: takes[name] for name in only or takes}, TINY))


def numbers_of(figure: Figure, photos: Photos, mode: Mode = TINY) -> dict[str, Number]:
    """The numbers of a figure by what they say."""
    found = figure.shown(mode, photos)
    return {number.what: number for number in found if isinstance(number, Number)}
