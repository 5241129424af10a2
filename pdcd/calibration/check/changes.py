"""Is the bench still as it was calibrated? Five photos before a session say so.

White, the same with a black projector, dots of either panel, timing strips: each figure is compared
with that of the same photo taken right after the calibration. What is found is good, or small
enough to be taken into account (`Verdict.DOUBTFUL`: refit and go on), or calls for a new
calibration (`Verdict.BAD`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.check.similarity import Similarity, similarity
from pdcd.calibration.figures import Figure, Verdict
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, between

Floats = NDArray[np.float64]

GOOD_PX, UNLIKE_PX, CAMERA_PX = 0.1, 0.15, 3.0
"""Registration that is good; what a similarity may leave; how far a camera may have been bumped, in
projector pixels: its map is refitted, and no cell depends on it."""
GOOD_S, REFIT_S = 0.1e-3, 0.5e-3
GOOD_LAMP, REFIT_LAMP = 0.03, 0.15
GOOD_CLOSED, REFIT_CLOSED = 0.10, 0.50
DARKEST = 2e-4
"""Light through the closed mask over that through the open one, below which it is black: a smaller
share is hidden by noise, and changes are told over this one."""
TOLD_SIGMAS = 3.0
"""Standard deviations by which a change that is not known to its limit must differ from none."""
FEWEST_DOTS, LEAST_DOTS = 30, 0.6
"""Dots, and share of the reference's dots, that must be found again."""
LEAST_WHITE = 0.05
"""White over that of the reference, below which there was no light."""
UNEVEN = 0.1
"""Spread of white over its reference that another scene makes, and no lamp."""


@dataclass(frozen=True, eq=False)
class Dots:
    """Dots that were found: index (n, 2) whole numbers of each in its panel's pattern, quads
    (n, 2) where it lies in the photo, sigma (n,) of that in quads."""

    index: NDArray[np.int64]
    quads: Floats
    sigma: Floats


@dataclass(frozen=True, eq=False)
class Look:
    """What the five photos of a check say.

    projector, mask : dots of either panel.
    white : (rows, cols) mean light of parts of the white photo, per second of exposure.
    closed : light through the closed mask over that through the open one, and its sigma.
    skew_s : lag of the mask, and its sigma (`pdcd.calibration.timing.skew_change`).
    settings : what must not change: camera, lens, ISO, f-number, EDIDs, modes; by name.
    saturated : share of the white photo's lit quads that are saturated.
    """

    projector: Dots
    mask: Dots
    white: Floats
    closed: tuple[float, float]
    skew_s: tuple[float, float]
    settings: Mapping[str, str]
    saturated: float = 0.0


@dataclass(frozen=True)
class Finding:
    """A figure with its verdict, and what it means for the user."""

    figure: Figure
    advice: str


@dataclass(frozen=True, eq=False)
class Checked:
    """The verdict on a bench, and what a refit takes.

    camera : how the projector's dots moved in the photo, in quads.
    mask : how the mask moved against the projector, in projector pixels.
    lamp : white now over then. skew_s : lag now less then.
    """

    findings: tuple[Finding, ...]
    camera: Similarity
    mask: Similarity
    lamp: float
    skew_s: float

    @property
    def verdict(self) -> Verdict:
        """The worst of all."""
        return max(finding.figure.verdict for finding in self.findings)


def check(
    now: Look, then: Look, camera: Map, projector: Map, guard_px: float, refresh_s: float
) -> Checked:
    """Compare a look at the bench with that of its calibration.

    camera, projector : the calibrated maps. guard_px : of the cells that are to be used.

    Raises CalibrationError where the photos say nothing: no light, saturated, too few dots.
    """
    lamp, uneven, lamp_sigma = _lamp(now, then)
    of_projector, of_mask = matched(now.projector, then.projector), matched(now.mask, then.mask)
    _refuse_few(len(of_projector[0]), then.projector, "projector")
    _refuse_few(len(of_mask[0]), then.mask, "mask")
    moved = similarity(*of_projector)
    quads_then, quads_now, sigma = of_mask
    on_projector = [
        between(camera, projector, quads) for quads in (quads_then, moved.back(quads_now))
    ]
    corners = _corners(projector.size_px)
    seen = between(projector, camera, corners)
    # One number for the photo: a similarity has one size, too.
    px_by_quad = float(np.hypot(*np.ptp(corners, axis=0)) / np.hypot(*np.ptp(seen, axis=0)))
    mask = similarity(on_projector[0], on_projector[1], sigma * px_by_quad)
    bumped, bumped_sigma = (px_by_quad * each for each in moved.worst(seen))
    apart, apart_sigma = mask.worst(corners)
    # What the projector's dots are off by, the mask's are corrected by.
    apart_sigma = float(np.hypot(apart_sigma, bumped_sigma))
    culprit = _culprit(bumped, apart, px_by_quad * similarity(*of_mask).worst(seen)[0])
    skew, skew_sigma = (
        now.skew_s[0] - then.skew_s[0],
        float(np.hypot(now.skew_s[1], then.skew_s[1])),
    )
    closed, closed_sigma = _closed(now, then)
    findings = (
        _place("mask.place", apart, apart_sigma, guard_px / 3.0, mask.left, culprit),
        _place("camera.place", bumped, bumped_sigma, CAMERA_PX, moved.left * px_by_quad, culprit),
        _lag(skew, skew_sigma, refresh_s, moved=apart >= GOOD_PX),
        _lamp_finding(lamp, lamp_sigma, uneven),
        _graded(
            "mask.contrast", closed, closed_sigma, "", (GOOD_CLOSED, REFIT_CLOSED),
            "the closed mask lets another share of the light through: look at the polarisers' "
            "angles, and calibrate the light",
        ),
        _settings(now.settings, then.settings),
    )  # fmt: skip
    return Checked(findings, moved, mask, lamp, skew)


def parts_of(light: Floats, shape: tuple[int, int] = (12, 16)) -> Floats:
    """Mean light (h, w) of parts of a photo, (rows, cols): `Look.white`."""
    rows, cols = (
        np.array_split(np.arange(side), n) for side, n in zip(light.shape, shape, strict=True)
    )
    return np.array([[light[np.ix_(row, col)].mean() for col in cols] for row in rows])


def closed_share(
    dots: Floats, variance: Floats, white: Floats, places: Floats, radius_quads: float
) -> tuple[float, float]:
    """Light through the closed mask over that through the open one, and its sigma: `Look.closed`.

    dots, variance : (h, w) of the photo of the mask's dots. white : (h, w) both panels white.
    places : (n, 2) of the dots in quads. radius_quads : within which a dot's light falls.
    """
    height, width = white.shape
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    away = white > 0.25 * float(np.quantile(white, 0.98))
    for right, down in places.tolist():
        cols, rows = (
            slice(*np.searchsorted(line, (at - radius_quads, at + radius_quads)).tolist())
            for line, at in ((x, right), (y, down))
        )
        away[rows, cols] = False
    if np.count_nonzero(away) < 100:
        raise CalibrationError(
            "no part of the mask is closed in the photo of its dots",
            device="mask",
            hint="look whether the mask shows bright dots on black",
        )
    light = float(white[away].sum())
    return float(dots[away].sum()) / light, float(np.sqrt(variance[away].sum())) / light


def matched(now: Dots, then: Dots) -> tuple[Floats, Floats, Floats]:
    """Places then and now, (n, 2), of the dots that both looks have, and the sigma of their
    difference, (n,)."""
    number = [{tuple(at): n for n, at in enumerate(dots.index.tolist())} for dots in (now, then)]
    both = sorted(number[0].keys() & number[1].keys())
    first, second = (np.array([each[key] for key in both], dtype=np.int64) for each in number)
    sigma = np.hypot(now.sigma[first], then.sigma[second])
    return then.quads[second], now.quads[first], sigma


def _refuse_few(found: int, then: Dots, device: str) -> None:
    """Raise CalibrationError where too few of the reference's dots are there."""
    if found < max(FEWEST_DOTS, LEAST_DOTS * len(then.index)):
        raise CalibrationError(
            f"only {found} of {len(then.index)} dots of the {device} are found again",
            device=device,
            hint="clear the field, look whether the panel shows its dots and all is in focus; "
            "else calibrate the geometry anew",
        )


def _lamp(now: Look, then: Look) -> tuple[float, float, float]:
    """White now over then, how uneven that is over the photo, and its standard deviation."""
    if now.saturated > 0.001:
        raise CalibrationError(
            "the white photo is saturated",
            device="camera",
            hint="expose as the calibration did; look at aperture and ISO",
        )
    lit = then.white > 0.25 * then.white.max()
    ratio = now.white[lit] / then.white[lit]
    lamp = float(np.median(ratio))
    if not lamp > LEAST_WHITE:
        raise CalibrationError(
            f"there is next to no light: {max(lamp, 0.0):.1%} of the reference's",
            device="camera",
            hint="take the lens cap off, switch the lamp on, and look whether the shutter opens",
        )
    spread = 1.4826 * float(np.median(np.abs(ratio - lamp))) / lamp
    return lamp, spread, 1.2533 * spread * lamp / float(np.sqrt(ratio.size))


def _closed(now: Look, then: Look) -> tuple[float, float]:
    """Relative change of the light through the closed mask, and its standard deviation."""
    least = max(then.closed[0], DARKEST)
    change = (now.closed[0] - then.closed[0]) / least
    times = now.closed[0] / then.closed[0] if least > DARKEST else 1.0
    return change, float(np.hypot(now.closed[1], times * then.closed[1])) / least


def _culprit(bumped: float, apart: float, mask_in_photo: float) -> str:
    """Who moved, from how far projector and mask moved in the photo and against each other."""
    if apart < GOOD_PX:
        return "the camera was bumped"
    if bumped < GOOD_PX:
        return "the mask moved"
    return "the projector moved" if mask_in_photo < GOOD_PX else "more than one device moved"


def _place(
    name: str, moved: float, sigma: float, refit: float, left: float, culprit: str
) -> Finding:
    """The verdict on a movement, in projector pixels at the worst corner."""
    finding = _graded(
        name, moved, sigma, "px", (GOOD_PX, max(refit, GOOD_PX)), f"{culprit}: look at its mount"
    )
    if left <= UNLIKE_PX:
        return finding
    figure = Figure(
        name, left, sigma, "px", f"at most {UNLIKE_PX:g} px beside a shift and a turn", Verdict.BAD
    )
    return Finding(
        figure, f"calibrate the geometry anew: {culprit}, by more than a shift and a turn, or bent"
    )


def _lag(skew_s: float, sigma_s: float, refresh_s: float, *, moved: bool) -> Finding:
    """The verdict on the lag. Strips of a mask that moved may say nothing of it."""
    known = bool(np.isfinite(skew_s))
    if moved and not known:
        figure = Figure("mask.skew_s", skew_s, sigma_s, "s", "known", Verdict.DOUBTFUL)
        return Finding(figure, "it cannot be told while the mask lies elsewhere: check again then")
    advice = _late(skew_s, refresh_s) if known else ""
    return _graded("mask.skew_s", skew_s, sigma_s, "s", (GOOD_S, REFIT_S), advice)


def _late(skew_s: float, refresh_s: float) -> str:
    """What a changed lag means."""
    refreshes = round(skew_s / refresh_s)
    if refreshes and abs(skew_s - refreshes * refresh_s) < 0.25 * refresh_s:
        return (
            f"the mask is {refreshes:+d} refresh(es) later: set display.mask_delay_refreshes, "
            "calibrate the timing"
        )
    return "calibrate the timing; let the panels warm up"


def _lamp_finding(lamp: float, sigma: float, uneven: float) -> Finding:
    """The verdict on the lamp."""
    if uneven > UNEVEN:
        figure = Figure("lamp", lamp, sigma, "", f"even within {UNEVEN:.0%}", Verdict.DOUBTFUL)
        return Finding(figure, "this is not the scene of the reference: the lamp cannot be told")
    found = _graded(
        "lamp", lamp - 1.0, sigma, "", (GOOD_LAMP, REFIT_LAMP),
        "look at the iris and the lamp's mode, then calibrate the light",
    )  # fmt: skip
    return found


def _settings(now: Mapping[str, str], then: Mapping[str, str]) -> Finding:
    """The verdict on what must not have changed."""
    names = sorted(now.keys() | then.keys())
    other = [name for name in names if now.get(name) != then.get(name)]
    said = "; ".join(
        f"{name} is {now.get(name, 'not told')}, was {then.get(name, 'not told')}" for name in other
    )
    verdict = Verdict.BAD if other else Verdict.GOOD
    figure = Figure("settings", float(len(other)), 0.0, "", "none may differ", verdict)
    return Finding(figure, f"set them back, or calibrate anew: {said}" if other else "")


def _graded(
    name: str, value: float, sigma: float, unit: str, limits: tuple[float, float], advice: str
) -> Finding:
    """The verdict on a change: good below the first limit, refitted below the second."""
    good, refit = limits
    size = abs(value)
    verdict = Verdict.GOOD if size < good else Verdict.DOUBTFUL if size < refit else Verdict.BAD
    if not np.isfinite([value, sigma]).all():
        verdict, advice = Verdict.BAD, "it could not be measured: take the photos again"
    elif sigma > good and size < max(good, TOLD_SIGMAS * sigma):
        verdict, advice = Verdict.DOUBTFUL, "too noisy to be told: expose longer"
    said = "" if verdict is Verdict.GOOD else advice
    if verdict is Verdict.DOUBTFUL:
        said = f"taken into account; {advice}"
    limit = f"below {good:g} {unit}".rstrip()
    return Finding(Figure(name, value, sigma, unit, limit, verdict), said)


def _corners(size_px: tuple[int, int]) -> Floats:
    width, height = size_px
    return np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
