"""Figures for tests: taken coarsely, in this process, and looked at for their numbers alone."""

from __future__ import annotations

from collections.abc import Mapping

from pdcd.figures.figure import TINY, Figure, Photo, Take
from pdcd.figures.photo import photographs


def taken(figure: Figure, only: tuple[str, ...] = ()) -> dict[str, Photo]:
    """Photos of the captures of a figure, all or `only` those, in the mode of tests."""
    takes = figure.takes(TINY)
    benches: dict[str, dict[str, Take]] = {}
    for name, take in takes.items():
        if name in only or not only:
            benches.setdefault(take.stands, {})[name] = take
    return {name: photo for some in benches.values() for name, photo in photographs(some, TINY)}


def numbers_of(figure: Figure, photos: Mapping[str, Photo]) -> dict[str, float]:
    """The numbers of a figure by what they say."""
    return {number.what: number.value for number in figure.drawn(TINY, photos).numbers}
