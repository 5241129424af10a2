"""The photos of `light.contrasts` by blocks, their sums, and checks for what is wrong with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.figures import ROOM_MOST
from pdcd.calibration.light.light_plan import COVERED, LightPlan, PulseEdges
from pdcd.calibration.photo import (
    NO_LIGHT_SIGMAS,
    BlockMeans,
    average_blocks,
    check_brightness,
    check_clipping,
    find_inliers,
    shrink_marks,
)
from pdcd.errors import CalibrationError

_Marks = NDArray[np.bool_]

_LIT = 0.1
"""Blocks with less of the brightest ones' light are no part of the picture."""
_LEAST_LIT = 0.1
_FIELD_LIT = 0.9
"""Shares of the photo, and of the field, that must be lit."""
_BRIGHT = 0.95
"""Share of the brightest blocks' light above which a block is used to find where a card is
brightest, and how bright."""
_LEAST_BLOCKS = 12
"""Blocks, at least, through which a smooth surface of six numbers is fitted."""
_LEAST_INNER = 0.25
"""Share of the lit blocks that must be surrounded by lit ones, so that these can stand for all."""
_LEAST_SEEN = 1.0 / 500.0
"""The light through a closed mask of 500:1 must exceed three standard deviations of black
levels."""
_MOVES = 0.03
"""Relative change of light within the series that is accepted, of the projector's white and the
room."""
_MOVED_SIGMAS = 6.0
_LEAST_CONTRAST = 3.0

_ROOM = "switch the room lights off"
_BLOCKS = "see that the mask is not inverted: turn its polariser by 90 degrees"
_HINTS = {
    "WW": "close the aperture, or show fewer refreshes",
    "BW": f"{_ROOM}; see that the projector's picture is not inverted",
    "WB": f"the mask does not block: {_BLOCKS}",
    "BB": f"{_ROOM}; see that both panels are black",
    "C": _ROOM,
}
"""What to do where a photo is saturated."""


@dataclass(frozen=True, eq=False)
class LitMeans:
    """Means over the lit blocks.

    mean, sigma : (C + 1,) float64 for each colour and all of them, and the standard deviation by
        noise.
    """

    mean: Floats
    sigma: Floats


@dataclass(frozen=True, eq=False)
class LightSeries:
    """All photos by blocks. `lit` (rows, cols) marks the blocks that are used."""

    plan: LightPlan
    edges: PulseEdges
    blocks: Mapping[str, BlockMeans]
    lit: _Marks
    black_sigma: float

    @cached_property
    def white(self) -> Floats:
        """WW - BW of equal times, (rows, cols, C)."""
        return _white(self.plan, self.edges, self.blocks)

    @property
    def white_variance(self) -> Floats:
        """Its variance by noise."""
        return 0.5 * (self.blocks["WW"].variance + self.blocks["BW"].variance)

    @property
    def lit_s(self) -> float:
        """Time of the projector's light in WW."""
        return self.plan.lit_s(1, self.edges.projector_s)

    @property
    def lit_long_s(self) -> float:
        """The same in WB."""
        return self.plan.lit_s(self.plan.longer, self.edges.projector_s)

    @property
    def open_long_s(self) -> float:
        """Time for which the mask was open in BW."""
        return self.plan.open_s(self.plan.longer, self.edges.mask_s)

    @property
    def edge_error(self) -> float:
        """Relative error of all ratios of times."""
        return self.edges.sigma_s / self.lit_s

    @cached_property
    def whole(self) -> LitMeans:
        """WW - BW."""
        return self._sums({"WW": 0.5, "WW-again": 0.5}, self.white)

    @cached_property
    def through(self) -> LitMeans:
        """WB - BB."""
        return self._sums({"WB": 0.5, "WB-again": 0.5, "BB": -1.0})

    @cached_property
    def left(self) -> LitMeans:
        """BW - C, or BW - BB where nothing was covered."""
        dark = {"BB": -1.0} if self.covered is None else {"C": -0.5, "C-again": -0.5}
        return self._sums({"BW": 0.5, "BW-again": 0.5} | dark)

    @cached_property
    def covered(self) -> LitMeans | None:
        """C - BB; None where nothing was covered."""
        if COVERED[0] not in self.blocks:
            return None
        return self._sums({"C": 0.5, "C-again": 0.5, "BB": -1.0})

    @cached_property
    def lamp(self) -> float:
        """WW-again over WW, less 1."""
        return self.total("WW-again") / self.total("WW") - 1.0

    @cached_property
    def mask_map(self) -> Floats:
        """(WB - BB) / (WW - BW) of all channels by blocks, NaN where it is dark."""
        through = self._mix({"WB": 0.5, "WB-again": 0.5, "BB": -1.0}).sum(axis=2)
        found = np.full(self.lit.shape, np.nan)
        times = self.lit_s / self.lit_long_s
        found[self.lit] = times * through[self.lit] / self.white.sum(axis=2)[self.lit]
        return found

    def total(self, name: str) -> float:
        """Mean light of one photo."""
        return float(self.blocks[name].mean[self.lit].mean())

    def middle(self, part: float) -> _Marks:
        """Lit blocks in the middle of the lit area, within `part` of its width and height; at least
        one block, or else all lit ones."""
        rows, cols = np.nonzero(self.lit)
        height, width = np.ptp(rows) + 1, np.ptp(cols) + 1
        y, x = np.mgrid[: self.lit.shape[0], : self.lit.shape[1]]
        down = np.abs(y - 0.5 * (rows.min() + rows.max())) <= max(0.5 * part * height, 0.5)
        across = np.abs(x - 0.5 * (cols.min() + cols.max())) <= max(0.5 * part * width, 0.5)
        found = np.asarray(self.lit & down & across)
        return found if found.any() else self.lit

    def brightest(self) -> tuple[Floats, float]:
        """WW - BW at the maximum of a smooth surface through the brighter blocks, (C,), and the
        relative noise of its mean.

        Projector and lens make light fall off to all sides from there, so it does not matter which
        part of the picture mask and frame leave visible.
        """
        total = self.white[self.lit].sum(axis=1)
        few = float(np.sort(total)[-_LEAST_BLOCKS:][0])
        near = total >= min(_BRIGHT * float(np.quantile(total, 0.98)), few)
        side = 1.0 / max(self.lit.shape)
        places = side * np.argwhere(self.lit)[near] - 0.5
        values, variance = self.white[self.lit][near], self.white_variance[self.lit][near]
        if len(values) < _LEAST_BLOCKS:
            mean = values.mean(axis=0)
            return mean, float(np.sqrt(variance.mean() / variance.size) / mean.mean())
        for _ in range(2):  # the second time without glints and dust
            terms = _surface(places, side)
            apart = values - terms @ (np.linalg.pinv(terms) @ values)
            kept = find_inliers(apart.mean(axis=1))
            places, values, variance = places[kept], values[kept], variance[kept]
        solve = np.linalg.pinv(_surface(places, side))
        weights = _top_of(places, solve @ values.mean(axis=1)) @ solve
        found = weights @ values
        noise = float(np.sqrt(weights**2 @ variance.mean(axis=1) / values.shape[1]))
        return np.asarray(found), noise / float(found.mean())

    def _mix(self, signs: Mapping[str, float]) -> Floats:
        return np.asarray(sum(sign * self.blocks[name].mean for name, sign in signs.items()))

    def _sums(self, signs: Mapping[str, float], values: Floats | None = None) -> LitMeans:
        values = self._mix(signs) if values is None else values
        variance = sum(sign**2 * self.blocks[name].variance for name, sign in signs.items())
        mean = values[self.lit].mean(axis=0)
        noise = np.asarray(variance)[self.lit].mean(axis=0) / self.lit.sum()
        return LitMeans(
            np.append(mean, mean.mean()), np.sqrt(np.append(noise, noise.mean() / noise.size))
        )

    def refuse_changes(self) -> None:
        """Raise CalibrationError where photos that are taken twice differ."""
        for name, what in (("WW", "lamp"), ("BW", "room"), ("WB", "lamp"), ("C", "room")):
            if name not in self.blocks:
                continue
            first, again = self.total(name), self.total(f"{name}-again")
            noise = _MOVED_SIGMAS * np.sqrt(2.0) * self.black_sigma
            larger = max(first, again)
            if abs(again - first) <= _MOVES * larger + noise:
                continue
            if min(first, again) < 0.2 * larger:
                dark = name if first < again else f"{name}-again"
                raise CalibrationError(
                    f"photo {dark} is dark, but the other one of the same light is not: the "
                    "shutter did not open, or a light was switched",
                    device="shutter",
                    hint="check the shutter's lag and its cable, and repeat the step",
                )
            change = 100.0 * (again / first - 1.0)
            if what == "room":
                raise CalibrationError(
                    f"light of the room changed by {change:+.3g} % within the series",
                    device="camera",
                    hint=_ROOM + ", draw the curtains, and repeat the step",
                )
            raise CalibrationError(
                f"the lamp changed by {change:+.3g} % within the series",
                device="projector",
                hint="let it warm up for half an hour; switch eco mode, automatic iris and dynamic "
                "contrast off",
            )

    def refuse_leaks(self) -> None:
        """Raise CalibrationError where a panel hardly blocks, or covering the projector adds
        light."""
        white, times = float(self.whole.mean[-1]), self.lit_s / self.lit_long_s
        if times * float(self.through.mean[-1]) > white / _LEAST_CONTRAST:
            raise CalibrationError(
                "the mask does not block: closed it lets more than a third of the light through",
                device="mask",
                hint=_BLOCKS,
            )
        noise = _MOVED_SIGMAS * np.hypot(self.black_sigma, float(self.left.sigma[-1]))
        if float(self.left.mean[-1]) < -noise:
            raise CalibrationError(
                "with the projector covered there is more light than with its black",
                device="camera",
                hint="the room's light changed, or a hand reflects it: cover the projector's lens "
                "with its cap, step away, and repeat the step",
            )

    def refuse_room(self, share: float) -> None:
        """Raise CalibrationError where there is much light beside the projector's white."""
        if share > ROOM_MOST:
            raise CalibrationError(
                f"without the projector's white there is {100.0 * share:.0f} % of its light: the "
                "room lights are on, or its black is too bright",
                device="camera",
                hint=_ROOM + "; see that the projector's picture is not inverted",
            )


def make_light_series(
    photos: Mapping[str, BlockMeans],
    plan: LightPlan,
    edges: PulseEdges,
    black_sigma: float,
    field: _Marks | None,
) -> LightSeries:
    """The series of these photos, checked. Raises CalibrationError: see `light.contrasts`."""
    blocks: dict[str, BlockMeans] = {}
    for name in (shown.name for shown in plan.photos()):
        if name in COVERED and name not in photos:
            continue
        blocks[name] = photos[name]
        share = float(np.mean(photos[name].clipped))
        check_clipping(name, share, _HINTS[name.removesuffix("-again")])
    times = plan.lit_s(1) / plan.lit_s(plan.longer)
    _refuse_no_light(blocks, black_sigma, times)
    white = _white(plan, edges, blocks).sum(axis=2)
    lit = white > _LIT * float(np.quantile(white, 0.98))
    _refuse_unlit(lit, field)
    series = LightSeries(plan, edges, blocks, _wholly(lit), black_sigma)
    series.refuse_changes()
    _refuse_dim(series)
    series.refuse_leaks()
    # Blocks with mirrors, dust or a hand in them are left out.
    steady_ones = series.lit.copy()
    steady_ones[series.lit] = find_inliers(series.mask_map[series.lit])
    return LightSeries(plan, edges, blocks, steady_ones, black_sigma)


def _surface(places: Floats, side: float = 0.0) -> Floats:
    """Terms of a surface of second order, (n, 6), as means over blocks of side `side` around places
    (n, 2)."""
    y, x = places.T
    mean = side**2 / 12.0
    return np.stack([np.ones_like(x), x, y, x * x + mean, x * y, y * y + mean], axis=1)


def _top_of(places: Floats, numbers: Floats) -> Floats:
    """The terms where a surface of these numbers (6,) is highest within places (n, 2)."""
    _, x, y, xx, xy, yy = numbers
    bent = np.array([[2.0 * yy, xy], [xy, 2.0 * xx]])
    if np.linalg.eigvalsh(bent).max() >= 0.0:  # it rises up to an edge
        points = _surface(places)
        return np.asarray(points[int((points @ numbers).argmax())])
    top = np.linalg.solve(bent, np.array([-y, -x]))
    inside = np.clip(top, places.min(axis=0), places.max(axis=0))
    return np.asarray(_surface(inside[None])[0])


def _wholly(lit: _Marks) -> _Marks:
    """Lit blocks that are surrounded by lit ones. At the edge of the projector's picture the room's
    light fills a block, but the projector's only a part of it."""
    inner = shrink_marks(lit)
    return inner if inner.sum() >= _LEAST_INNER * lit.sum() else lit


def _white(plan: LightPlan, edges: PulseEdges, blocks: Mapping[str, BlockMeans]) -> Floats:
    """WW - BW of equal times, (rows, cols, C)."""
    both, room = (0.5 * (blocks[name].mean + blocks[f"{name}-again"].mean) for name in ("WW", "BW"))
    share = plan.open_s(1, edges.mask_s) / plan.open_s(plan.longer, edges.mask_s)
    return np.asarray(both - share * room)


def _refuse_no_light(blocks: Mapping[str, BlockMeans], black_sigma: float, times: float) -> None:
    """Raise CalibrationError where white photos show nothing."""
    levels = {n: float(np.quantile(blocks[n].mean, 0.98)) for n in ("WW", "WW-again")}
    noise = float(np.sqrt(np.median(blocks["BB"].variance)))
    closed = float(np.quantile(blocks["WB"].mean, 0.98))
    floor = NO_LIGHT_SIGMAS * float(np.hypot(black_sigma, noise))
    if times * closed > max(*levels.values(), floor):
        raise CalibrationError(
            "there is more light with the mask closed than with the mask open: it is inverted",
            device="mask",
            hint=_BLOCKS,
        )
    check_brightness(levels, floor)


def _refuse_unlit(lit: _Marks, field: _Marks | None) -> None:
    """Raise CalibrationError where the projector's light covers too little."""
    share = float(lit.mean())
    if share < _LEAST_LIT:
        raise CalibrationError(
            f"the projector's light is in {100.0 * share:.2g} % of the photo only",
            device="camera",
            hint="see that camera, mask and projector look at the same place",
        )
    if field is None:
        return
    inside = average_blocks(field.astype(np.float64)) > 0.99
    share = float(lit[inside].mean()) if inside.any() else 0.0
    if share < _FIELD_LIT:
        raise CalibrationError(
            f"{100.0 * (1.0 - share):.0f} % of the field gets no light",
            device="camera",
            hint="something covers it: take it away; see that the card is larger than the field",
        )


def _refuse_dim(series: LightSeries) -> None:
    """Raise CalibrationError where the black level's error hides the light through a closed
    mask."""
    white = float(series.whole.mean[-1])
    error = 3.0 * np.sqrt(1.5) * series.black_sigma * series.lit_s / series.lit_long_s / white
    if error > _LEAST_SEEN:
        raise CalibrationError(
            f"too dim: white is {white:.3g} above black, which is known to {series.black_sigma:g}",
            device="camera",
            hint="open the aperture, or show more refreshes",
        )
