"""Do levels next to black and white differ from them? A limited range is reported by no server.

A panel that takes levels 16 to 235 for black and white, a contrast mode, or a ramp in a compositor
makes levels near the ends equal to them. Each panel shows one level near each end, all over, while
the other one is open, or white; nobody needs to know where anything lies. With p and m the shares
of white that a level gives, and the names of `light.contrasts`::

    light-projector - BW M / M_BW = p (1 - delta) L D
    light-mask / WW               = eps + (1 - eps) m

and likewise for the dark ones, which last twice as long.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.light.light_plan import DARK_LEVEL, DARK_TIMES, LIGHT_LEVEL
from pdcd.calibration.light.light_series import LightSeries
from pdcd.calibration.photo import BlockMeans

_PANELS = ("projector", "mask")
_BLACK, _WHITE = 1e-4, 0.98
"""Share of white above which the dark level differs from black, and below which the light one
differs from white: the shares of gamma 3.3 and of 0.3."""
_SURE_SIGMAS = 2.0


@dataclass(frozen=True)
class EndLevels:
    """Light of two levels of a panel, as shares of its white less its black, and standard
    deviations.

    dark, light : of `DARK_LEVEL` in the colour where it is least, and of `LIGHT_LEVEL` in the
        colour where it is most.
    """

    panel: str
    dark: float
    dark_sigma: float
    light: float
    light_sigma: float

    def figures(self) -> tuple[MeasuredFigure, MeasuredFigure]:
        """The figures. Photos of black and white do without these levels, so neither is ever
        bad."""
        seen = self.dark > _BLACK + _SURE_SIGMAS * self.dark_sigma
        apart = self.light < _WHITE
        return (
            MeasuredFigure(
                f"{self.panel}.level_{DARK_LEVEL}",
                self.dark,
                self.dark_sigma,
                "of white",
                f"more than {_BLACK:g}",
                Verdict.GOOD if seen else Verdict.DOUBTFUL,
            ),
            MeasuredFigure(
                f"{self.panel}.level_{LIGHT_LEVEL}",
                self.light,
                self.light_sigma,
                "of white",
                f"less than {_WHITE:g}",
                Verdict.GOOD if apart else Verdict.DOUBTFUL,
            ),
        )


def explain_level_figure(name: str) -> str:
    """What to do about a figure of `EndLevels` that is not good, by its name."""
    panel, _, level = name.partition(".level_")
    like = 0 if level == str(DARK_LEVEL) else 255
    return (
        f"level {level} of the {panel} gives the light of {like}: see that its input takes the "
        "full range (RGB 0 to 255), that contrast modes and night lights are off, and what pdcd "
        "doctor display says"
    )


def measure_end_levels(
    series: LightSeries, photos: Mapping[str, BlockMeans], eps: float
) -> tuple[EndLevels, ...]:
    """Light of levels next to black and white of both panels, for `measure_light`.

    photos : those of `LightPlan.levels` as well as the series'; where they are missing, the result
        is empty.
    eps : black over white of the mask.
    """
    times = {"dark": DARK_TIMES, "light": 1}
    if any(f"{end}-{panel}" not in photos for end in times for panel in _PANELS):
        return ()
    plan, edges = series.plan, series.edges
    opened = plan.open_s(plan.longer, edges.mask_s)
    first, again = (_mean(series, series.blocks[name])[0] for name in ("BW", "BW-again"))
    black, black_change = 0.5 * (first + again), 0.5 * np.abs(first - again)
    white = series.whole.mean[:-1]
    shares: dict[str, tuple[float, float]] = {}
    for end, factor in times.items():
        lit = plan.lit_s(factor, edges.projector_s) / series.lit_s * white
        part = plan.open_s(factor, edges.mask_s) / opened
        for panel in _PANELS:
            mean, noise = _mean(series, photos[f"{end}-{panel}"])
            if panel == "projector":
                share, change = (mean - part * black) / lit, part * black_change / lit
            else:
                share = (mean / (lit + part * black) - eps) / (1.0 - eps)
                change = np.full(share.shape, eps * series.lamp)
            if end == "light":
                change = np.hypot(change, share * series.lamp)
            error = np.hypot(np.hypot(noise, np.sqrt(2.0) * series.black_sigma) / lit, change)
            colour = int(share.argmin() if end == "dark" else share.argmax())
            shares[f"{end}-{panel}"] = float(share[colour]), float(error[colour])
    return tuple(
        EndLevels(panel, *shares[f"dark-{panel}"], *shares[f"light-{panel}"]) for panel in _PANELS
    )


def _mean(series: LightSeries, blocks: BlockMeans) -> tuple[Floats, Floats]:
    """Mean light of the lit blocks, (C,), and its standard deviation by noise."""
    mean, variance = (values[series.lit].mean(axis=0) for values in (blocks.mean, blocks.variance))
    return np.asarray(mean), np.sqrt(variance / series.lit.sum())
