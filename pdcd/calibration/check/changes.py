"""Is the bench still as it was calibrated? Five photos before a session answer that.

The photos show white, white light with a black projector, the dots of either panel, and timing
strips. Maps and lag are fitted anew, and each figure is compared with that of the same photo taken
right after the calibration. A change is good, or small enough to be taken into account
(`Verdict.DOUBTFUL`: refit and go on), or calls for a new calibration (`Verdict.BAD`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats
from pdcd.calibration.check.moved import MapDrift
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.errors import CalibrationError

_GOOD_PX, _UNLIKE_PX, _CAMERA_PX = 0.1, 0.15, 3.0
"""In projector pixels: drift that counts as good, the largest residual of a similarity, and how far
the camera may have been bumped. Its map is refitted, and no cell depends on it."""
_GOOD_S, _REFIT_S = 0.1e-3, 0.5e-3
_GOOD_LAMP, _REFIT_LAMP = 0.03, 0.15
_GOOD_CLOSED, _REFIT_CLOSED = 0.10, 0.50
DARKEST_MASK_SHARE = 2e-4
"""Light through the closed mask over that through the open one, below which it counts as black:
noise hides a smaller share. Changes are given relative to this share at least."""
_TOLD_SIGMAS = 3.0
"""Where a change is not known to within its limit, it must differ from none by so many standard
deviations."""
_FEWEST_DOTS, _LEAST_DOTS = 30, 0.6
"""Dots, and share of the reference's dots, that must be found again."""
_LEAST_WHITE = 0.05
"""White over that of the reference, below which there was no light."""
_PARTS = (12, 16)
"""Rows and columns of parts of the white photo."""
_UNEVEN = 0.1
"""Spread of white over its reference from which the scene has changed, not the lamp."""


@dataclass(frozen=True, eq=False)
class BenchSnapshot:
    """What the five photos of a check say.

    camera : how far the projector's dots lie from where the camera's map puts them. mask : how far
        those of the mask lie from where its map puts them. Both in projector pixels.
    white : (rows, cols) mean light of parts of the white photo, per second of exposure.
    closed : light through the closed mask over that through the open one, and its sigma.
    lag_s : lag of the mask less the calibrated one, and its sigma; None where no strips were shown.
    settings : what must not change: camera, lens, ISO, f-number, EDIDs, modes; by name.
    saturated : share of the white photo's lit quads that are saturated.
    """

    camera: MapDrift
    mask: MapDrift
    white: Floats
    closed: tuple[float, float]
    lag_s: tuple[float, float] | None
    settings: Mapping[str, str]
    saturated: float = 0.0


@dataclass(frozen=True)
class CheckFinding:
    """A figure with its verdict, and what it means for the user. sure : whether it is known well
    enough to be taken into account."""

    figure: MeasuredFigure
    advice: str
    sure: bool = True


@dataclass(frozen=True, eq=False)
class CheckResult:
    """The verdict on a bench, and what a refit needs.

    camera, mask : how they moved. lamp : white now over white at the reference.
    """

    findings: tuple[CheckFinding, ...]
    camera: MapDrift
    mask: MapDrift
    lamp: float

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of all findings."""
        return max(finding.figure.verdict for finding in self.findings)


def compare_snapshots(
    now: BenchSnapshot, then: BenchSnapshot, guard_px: float, refresh_s: float
) -> CheckResult:
    """Compare a snapshot of the bench with that of its calibration.

    guard_px : guard of the cells that are to be used.

    Raises CalibrationError where the photos cannot be used: no light, saturated, too few dots.
    """
    lamp, uneven, lamp_sigma = _lamp(now, then)
    _refuse_few(now.camera.count, then.camera.count, "projector")
    _refuse_few(now.mask.count, then.mask.count, "mask")
    camera, mask = now.camera.since(then.camera), now.mask.since(then.mask)
    bumped, apart = camera.worst_px, mask.worst_px
    culprit = _culprit(bumped[0], apart[0], mask.since(camera).worst_px[0])
    # The mask's dots are corrected by the projector's, so the errors of both count.
    apart = apart[0], float(np.hypot(apart[1], bumped[1]))
    closed = _closed(now, then)
    findings = [
        _place("mask.place", apart, guard_px / 3.0, mask.unlike_px, culprit),
        _place("camera.place", bumped, _CAMERA_PX, camera.unlike_px, culprit),
        _lamp_finding(lamp, lamp_sigma, uneven),
        _graded(
            "mask.contrast", closed, "", (_GOOD_CLOSED, _REFIT_CLOSED),
            "the closed mask lets a different share of the light through: check the polarisers' "
            "angles, and calibrate the light",
        ),
        _settings(now.settings, then.settings),
    ]  # fmt: skip
    if now.lag_s is not None:
        was = then.lag_s or (0.0, 0.0)
        lag = now.lag_s[0] - was[0], float(np.hypot(now.lag_s[1], was[1]))
        findings.insert(2, _lag(lag, refresh_s, moved=apart[0] >= _GOOD_PX))
    return CheckResult(tuple(findings), camera, mask, lamp)


def average_parts(light: Floats) -> Floats:
    """Mean light of the parts of a photo (h, w), (rows, cols): `BenchSnapshot.white`."""
    rows, cols = (
        np.array_split(np.arange(side), n) for side, n in zip(light.shape, _PARTS, strict=True)
    )
    return np.array([[light[np.ix_(row, col)].mean() for col in cols] for row in rows])


def measure_closed_mask(
    dots: Floats, variance: Floats, white: Floats, places: Floats, radius_quads: float
) -> tuple[float, float]:
    """Light through the closed mask over that through the open one, and its sigma:
    `BenchSnapshot.closed`.

    dots, variance : (h, w) of the photo of the mask's dots. white : (h, w) both panels white.
    places : (n, 2) of the dots in quads. radius_quads : a dot's light falls within this radius.
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
            hint="check that the mask shows bright dots on black",
        )
    light = float(white[away].sum())
    return float(dots[away].sum()) / light, float(np.sqrt(variance[away].sum())) / light


def _refuse_few(found: int, then: int, device: str) -> None:
    """Raise CalibrationError where too few of the reference's dots were found again."""
    if found < max(_FEWEST_DOTS, _LEAST_DOTS * then):
        raise CalibrationError(
            f"only {found} of {then} dots of the {device} were found again",
            device=device,
            hint="clear the field, and check that the panel shows its dots and that all is in "
            "focus; if so, calibrate the geometry again",
        )


def _lamp(now: BenchSnapshot, then: BenchSnapshot) -> tuple[float, float, float]:
    """White now over then, how uneven that is over the photo, and its standard deviation."""
    if now.saturated > 0.001:
        raise CalibrationError(
            "the white photo is saturated",
            device="camera",
            hint="expose as the calibration did; check aperture and ISO",
        )
    lit = then.white > 0.25 * then.white.max()
    ratio = now.white[lit] / then.white[lit]
    lamp = float(np.median(ratio))
    if not lamp > _LEAST_WHITE:
        raise CalibrationError(
            f"there is almost no light: {max(lamp, 0.0):.1%} of the reference's",
            device="camera",
            hint="take the lens cap off, switch the lamp on, and check that the shutter opens",
        )
    spread = 1.4826 * float(np.median(np.abs(ratio - lamp))) / lamp
    return lamp, spread, 1.2533 * spread * lamp / float(np.sqrt(ratio.size))


def _closed(now: BenchSnapshot, then: BenchSnapshot) -> tuple[float, float]:
    """Relative change of the light through the closed mask, and its standard deviation."""
    least = max(then.closed[0], DARKEST_MASK_SHARE)
    change = (now.closed[0] - then.closed[0]) / least
    times = now.closed[0] / then.closed[0] if least > DARKEST_MASK_SHARE else 1.0
    return change, float(np.hypot(now.closed[1], times * then.closed[1])) / least


def _culprit(bumped: float, apart: float, mask_in_photo: float) -> str:
    """Which device moved, from how far projector and mask moved in the photo and against each
    other."""
    if apart < _GOOD_PX:
        return "the camera was bumped"
    if bumped < _GOOD_PX:
        return "the mask moved"
    return "the projector moved" if mask_in_photo < _GOOD_PX else "more than one device moved"


def _place(
    name: str, moved: tuple[float, float], refit: float, unlike: float, culprit: str
) -> CheckFinding:
    """The verdict on a movement, in projector pixels at the worst corner."""
    finding = _graded(
        name, moved, "px", (_GOOD_PX, max(refit, _GOOD_PX)), f"{culprit}: check the mount"
    )
    if unlike <= _UNLIKE_PX:
        return finding
    figure = MeasuredFigure(
        name,
        unlike,
        moved[1],
        "px",
        f"at most {_UNLIKE_PX:g} px beside a shift and a turn",
        Verdict.BAD,
    )
    return CheckFinding(
        figure, f"calibrate the geometry again: {culprit}, by more than a shift and a turn, or bent"
    )


def _lag(lag: tuple[float, float], refresh_s: float, *, moved: bool) -> CheckFinding:
    """The verdict on the lag. Where the mask has moved, its strips may not show the lag."""
    known = bool(np.isfinite(lag[0]))
    if moved and not known:
        figure = MeasuredFigure("mask.skew_s", *lag, "s", "known", Verdict.DOUBTFUL)
        said = "it cannot be measured while the mask is out of place: mend that, then check again"
        return CheckFinding(figure, said, sure=False)
    advice = _late(lag[0], refresh_s) if known else ""
    return _graded("mask.skew_s", lag, "s", (_GOOD_S, _REFIT_S), advice)


def _late(skew_s: float, refresh_s: float) -> str:
    """What a changed lag means."""
    refreshes = round(skew_s / refresh_s)
    if refreshes and abs(skew_s - refreshes * refresh_s) < 0.25 * refresh_s:
        return (
            f"the mask is {refreshes:+d} refresh(es) later: set display.mask_delay_refreshes, "
            "calibrate the timing"
        )
    return "calibrate the timing; let the panels warm up"


def _lamp_finding(lamp: float, sigma: float, uneven: float) -> CheckFinding:
    """The verdict on the lamp."""
    if uneven > _UNEVEN:
        figure = MeasuredFigure(
            "lamp", lamp, sigma, "", f"even within {_UNEVEN:.0%}", Verdict.DOUBTFUL
        )
        said = "the scene differs from that of the reference, so the lamp cannot be judged"
        return CheckFinding(figure, said, sure=False)
    advice = "check the iris and the lamp's mode, then calibrate the light"
    return _graded("lamp", (lamp - 1.0, sigma), "", (_GOOD_LAMP, _REFIT_LAMP), advice)


def _settings(now: Mapping[str, str], then: Mapping[str, str]) -> CheckFinding:
    """The verdict on what must not have changed."""
    names = sorted(now.keys() | then.keys())
    other = [name for name in names if now.get(name) != then.get(name)]
    said = "; ".join(
        f"{name} is {now.get(name, 'not told')} and was {then.get(name, 'not told')}"
        for name in other
    )
    verdict = Verdict.BAD if other else Verdict.GOOD
    figure = MeasuredFigure("settings", float(len(other)), 0.0, "", "none may differ", verdict)
    return CheckFinding(figure, f"set them back, or calibrate again: {said}" if other else "")


def _graded(
    name: str, change: tuple[float, float], unit: str, limits: tuple[float, float], advice: str
) -> CheckFinding:
    """The verdict on a change and its sigma: good below the first limit, refitted below the
    second."""
    (value, sigma), (good, refit) = change, limits
    size = abs(value)
    verdict = Verdict.GOOD if size < good else Verdict.DOUBTFUL if size < refit else Verdict.BAD
    if not np.isfinite([value, sigma]).all():
        verdict, advice = Verdict.BAD, "it could not be measured: take the photos again"
    elif sigma > good and size < max(good, _TOLD_SIGMAS * sigma):
        verdict, advice = Verdict.DOUBTFUL, "too noisy to tell: expose longer"
    figure = MeasuredFigure(name, value, sigma, unit, f"below {good:g} {unit}".rstrip(), verdict)
    return CheckFinding(figure, "" if verdict is Verdict.GOOD else advice, sure=sigma < good)
