"""Black of every sample: as the tags of a file say it, and as a border without light measures it.

The tags give a pattern that repeats from the corner of the ActiveArea, of any size and in
fractions, and a number more for each row and for each column. A masked border was exposed with the
picture and is a better measurement, but only if it is dark: a file may call any place masked.
Source: Adobe DNG specification 1.4, chapter 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats

Area = tuple[int, int, int, int]
"""First row and column of samples, and the row and column after the last."""

MIN_MASKED = 64
"""Fewest masked samples of a colour that black is taken from."""
_OUTLIER_SIGMAS = 5.0
_LIT_SHARE = 0.05
"""Share of the span from the tags' black to white: dark current never moves a border so far."""
_HIGH_SHARE = 0.25
"""Share of white: no camera has so high a black, whatever the tags say."""
_ROUGH_SHARE = 0.03
"""Share of the span from black to white: samples of a dark border spread less."""
_DOUBT_SHARE = 0.01
"""Share of that span from which the user is told how far the border and the tags differ."""


@dataclass(frozen=True)
class BlackLevels:
    """Black as tags say it, counted from the ActiveArea's corner.

    pattern : (R, C) DN, repeats in both directions.
    rows, columns : (h,) and (w,) DN that are added for each row and column of the ActiveArea; empty
        where all are zero.
    """

    pattern: Floats
    rows: Floats
    columns: Floats

    def of_plane(self, first: tuple[int, int], shape: tuple[int, int], step: int) -> PlaneBlack:
        """Black of the plane whose samples begin at `first` and lie `step` apart; `shape` is its
        rows and columns."""
        (top, left), (height, width) = first, shape
        rows, columns = top + step * np.arange(height), left + step * np.arange(width)
        down = self.rows[rows] if self.rows.size else np.zeros(height)
        across = self.columns[columns] if self.columns.size else np.zeros(width)
        row, column = rows % self.pattern.shape[0], columns % self.pattern.shape[1]
        return PlaneBlack(self.pattern, row, column, down, across)


@dataclass(frozen=True)
class PlaneBlack:
    """Black of one colour plane, (h, w): pattern[row, column] + down + across.

    pattern : (R, C). row, down : (h,). column, across : (w,).
    """

    pattern: Floats
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    down: Floats
    across: Floats

    @property
    def mean(self) -> float:
        """Mean black of all samples of the plane; exact where all have the same black."""
        used = self.pattern[np.ix_(np.unique(self.row), np.unique(self.column))]
        if not np.ptp(used):
            level = float(used.flat[0])
        else:
            share = np.bincount(self.row, minlength=self.pattern.shape[0]) / self.row.size
            part = np.bincount(self.column, minlength=self.pattern.shape[1]) / self.column.size
            level = float(share @ self.pattern @ part)
        return level + float(self.down.mean()) + float(self.across.mean())

    @property
    def even(self) -> bool:
        """Whether all samples of the plane have the same black."""
        used = self.pattern[np.ix_(np.unique(self.row), np.unique(self.column))]
        return not any(np.ptp(part) for part in (used, self.down, self.across))

    def of_rows(self, rows: slice) -> Floats:
        """Black of some rows, (n, w) DN."""
        pattern = self.pattern[self.row[rows, None], self.column[None, :]]
        return np.asarray(pattern + self.down[rows, None] + self.across, np.float64)


def choose_dark_areas(
    said: Sequence[int], shape: tuple[int, int], active: Area
) -> tuple[list[Area], str | None]:
    """The plausible masked areas of a file, and what is wrong with the others.

    said : four numbers an area, as in the file. shape : rows and columns of the sensor.
    active : the picture.
    """
    areas = [(said[i], said[i + 1], said[i + 2], said[i + 3]) for i in range(0, len(said) - 3, 4)]
    wrong = "" if len(said) % 4 == 0 else "are not four numbers each"
    sound: list[Area] = []
    for top, left, bottom, right in areas:
        if not (0 <= top < bottom <= shape[0] and 0 <= left < right <= shape[1]):
            wrong = "lie beyond the file"
        elif top < active[2] and active[0] < bottom and left < active[3] and active[1] < right:
            wrong = "lie in the picture"
        else:
            sound.append((top, left, bottom, right))
    return sound, f"masked areas of the file {wrong}; they are not used" if wrong else None


def measure_dark_areas(
    sensor: NDArray[np.generic],
    areas: Sequence[Area],
    places: Sequence[tuple[int, int]],
    step: int,
) -> tuple[Floats, Floats] | None:
    """Mean and spread (DN) of each plane's masked samples without hot ones; None if too few.

    sensor : (H, W) all samples. places : row and column of one sample of each plane; the others of
    the plane lie `step` samples apart from it.
    """
    black, spread = np.empty(len(places)), np.empty(len(places))
    for plane, (row, column) in enumerate(places):
        parts = [
            sensor[
                top + (row - top) % step : bottom : step,
                left + (column - left) % step : right : step,
            ]
            for top, left, bottom, right in areas
        ]
        samples = np.concatenate([part.ravel() for part in parts]) if parts else np.empty(0)
        if samples.size < MIN_MASKED:
            return None
        black[plane], spread[plane] = _steady_mean(samples)
    return black, spread


def find_lit_border(
    measured: tuple[Floats, Floats], tagged: Floats, white: float, darkest: Floats
) -> tuple[bool, str | None]:
    """Whether a masked border cannot be dark, and what the user should know about it.

    measured : from `measure_dark_areas`. tagged : (P,) black of P planes by the tags, NaN where
    they do not say. darkest : (P,) a level of each plane of the picture, much of which is brighter.
    """
    black, spread = measured
    said = np.where(np.isnan(tagged), 0.0, tagged)
    span = white - said
    away = (black - tagged) / span
    above = bool(np.any(black > darkest + _DOUBT_SHARE * span))
    rough = bool(np.any(spread > _ROUGH_SHARE * span))
    high = bool(np.any(black > _HIGH_SHARE * white) or np.any(np.abs(away) > _LIT_SHARE))
    if above or rough or high:
        why = "is as bright as the picture" if above else "is not dark"
        return True, (
            f"the masked border {why} ({_level(black)} DN beside {_level(said)} DN by the tags); "
            "black is that of the tags"
        )
    if bool(np.any(np.abs(away) > _DOUBT_SHARE)):
        return False, (
            f"black is {_level(black)} DN by the masked border and {_level(said)} DN by the tags; "
            "the border is believed"
        )
    return False, None


def _level(levels: Floats) -> str:
    return f"{float(np.mean(levels)):.5g}"


def _steady_mean(samples: NDArray[np.generic]) -> tuple[float, float]:
    """Mean and spread without outliers: hot pixels sit in the masked border, too."""
    numbers = samples.astype(np.float64)
    middle = float(np.median(numbers))
    distance = np.abs(numbers - middle)
    wide = 1.4826 * float(np.median(distance))  # the standard deviation, if normal
    spread = max(wide, 1.0)  # 1 DN rounds
    if not np.issubdtype(samples.dtype, np.integer):
        spread = wide or 1.0
    return float(np.mean(numbers[distance <= _OUTLIER_SIGMAS * spread])), wide
