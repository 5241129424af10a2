"""Sine stripes in black and white: for each quad, the panel pixel that it sees.

A sine is shown as 16 black and white pictures of one refresh each: where the sine is above a
threshold. The shutter adds them up. Each pixel is lit in one run, so the panel's response does not
matter, and its rise and fall add the same everywhere. With I_s the photo of the sine shifted by s
of S steps,

    z = sum of I_s exp(2 pi i s / S),    x = P arg(z) / 2 pi + P n.

The period's number n comes from a prior that is less than half a period wrong: the maps in use, or
whole pixels decoded from XOR codes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.calibration.geometry.lit import LIT_SIGMAS
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import NO_PATTERNS, Bits, PanelName, PanelSequence
from pdcd.errors import CalibrationError
from pdcd.panels.frames import WHITE

Placed = tuple[Floats, Floats, Bools]
"""Pixels along an axis, (h, w), their standard deviations, and which are valid."""

_LEAST_MODULATION = 0.2
"""Depth of the stripes over their mean, below which a quad is left out."""
LEAST_VALID = 0.02
"""Share of the frame that must be decoded."""
_MOST_BEYOND = 0.02
"""Share of the decoded quads that may lie beyond the panel: noise at its edges."""
_WRAPPED, _MOST_WRAPPED = 0.4, 0.05
"""Difference from the prior, in periods, that is near to the next period, and the largest share of
quads that may have it."""
_AROUND, _AROUND_SHARE = 7, 0.9
"""Side, in quads, of the surroundings of each quad, and the share of them that must be valid: at an
edge of the picture, or of what covers it, blur moves the stripes."""
AXES = ("x", "y")


@dataclass(frozen=True, eq=False)
class DecodedQuads:
    """What each quad of a photo sees.

    panel_px : (h, w, 2), x and y on the panel in pixels.
    sigma_px : (h, w, 2), standard deviation by the noise of the photos.
    valid : (h, w) bool; elsewhere the numbers mean nothing.
    """

    panel_px: Floats
    sigma_px: Floats
    valid: Bools


@dataclass(frozen=True)
class PhaseCode:
    """The patterns of one panel.

    size_px : (width, height). period_px : even, so that half periods are whole pixels; 4 or more.
    steps : shifts of the sine, 3 or more. levels : refreshes that make one sine.
    """

    panel: PanelName
    size_px: tuple[int, int]
    period_px: int = 16
    steps: int = 4
    levels: int = 16

    def sine(self, axis: int, step: int) -> Bits:
        """(levels, height, width) bool: a shifted sine above rising thresholds."""
        x = np.arange(self.size_px[axis]) + 0.5
        angle = 2.0 * np.pi * (x / self.period_px - step / self.steps)
        thresholds = (np.arange(self.levels) + 0.5) / self.levels
        return self._drawn(axis, 0.5 + 0.5 * np.cos(angle) > thresholds[:, None])

    def shown(self, axis: int, repeats: int = 1) -> tuple[PanelSequence, ...]:
        """The photos along an axis, each `levels * repeats` refreshes."""
        index = np.repeat(np.arange(self.levels, dtype=np.int32), repeats)
        name = f"sine-{AXES[axis]}"
        return tuple(
            make_panel_sequence(
                f"{name}{step}-{self.panel}", self.panel, self.sine(axis, step), index
            )
            for step in range(self.steps)
        )

    def _drawn(self, axis: int, lines: Bools) -> Bits:
        """Lines (P, side) as whole pictures, without a copy for each row."""
        lines = lines[:, None, :] if axis == 0 else lines[:, :, None]
        return np.broadcast_to(lines, (len(lines), self.size_px[1], self.size_px[0]))


def make_panel_sequence(
    name: str, panel: PanelName, patterns: Bits, index: NDArray[np.int32]
) -> PanelSequence:
    """A photo in which one panel shows patterns while the other lets all light pass."""
    all_light = np.full_like(index, WHITE)
    if panel == "projector":
        return PanelSequence(name, patterns, NO_PATTERNS, index, all_light)
    return PanelSequence(name, NO_PATTERNS, patterns, all_light, index)


def check_periods(found: DecodedQuads, prior_px: Floats, code: PhaseCode) -> None:
    """Raise CalibrationError where the belief that numbered the periods was too far off."""
    away = np.abs(found.panel_px - prior_px)[found.valid].max(axis=-1) / code.period_px
    far = float(np.mean(away > _WRAPPED))
    if far > _MOST_WRAPPED:
        raise CalibrationError(
            f"the {code.panel} lies {np.median(away) * code.period_px:.1f} pixels beside its "
            f"stored map, {far:.0%} of it about half a period of the stripes or more",
            device=code.panel,
            hint="use patterns that need no map: --marks xor on a scene, dots on a card",
        )


class Sines:
    """The shifts of one axis in one colour, photo by photo, in the order of `PhaseCode.shown`."""

    def __init__(self, code: PhaseCode, channel: int) -> None:
        self.code, self.channel = code, channel
        self._step = 0
        self._z = np.zeros((0, 0), np.complex128)
        # Sum of variances, each with the square of its photo's factor in z.
        self._turned = np.zeros((0, 0), np.complex128)
        self._variance = np.zeros((0, 0))
        self._saturated = np.zeros((0, 0), np.bool_)
        self.mean = np.zeros((0, 0))
        """(h, w), of all shifts: half of the light."""

    def add(self, photo: QuadPhoto) -> None:
        """Add the photo of the next shift."""
        if not self._step:
            self._z, self._turned = (np.zeros(photo.frame, np.complex128) for _ in range(2))
            self._variance, self.mean = np.zeros(photo.frame), np.zeros(photo.frame)
            self._saturated = np.zeros(photo.frame, np.bool_)
        factor = complex(np.exp(2j * np.pi * self._step / self.code.steps))
        values, spread = photo.light[..., self.channel], photo.variance[..., self.channel]
        self._z += values * factor
        self._turned += spread * factor**2
        self.mean += values / self.code.steps
        self._variance += spread
        if photo.saturated is not None:
            self._saturated |= photo.saturated
        self._step += 1

    def refuse_flat(self) -> None:
        """Raise CalibrationError where there is light, and most of it does not follow the
        stripes."""
        lit = (self.mean > 0.0) & (
            self.mean * self.code.steps > LIT_SIGMAS * np.sqrt(self._variance)
        )
        if not lit.any():
            return
        depth = np.abs(self._z[lit]) * (2.0 / self.code.steps) / self.mean[lit]
        if np.median(depth) < _LEAST_MODULATION:
            raise CalibrationError(
                f"the light hardly follows the {self.code.panel}'s stripes: by "
                f"{float(np.median(depth)):.0%} of it, at the median of the photo",
                device=self.code.panel,
                hint="darken the room, focus camera and projector, and see that the picture "
                "changes: pdcd show pixels; of fog and milk, calibrate with a card",
            )

    def beside(self, near_px: Floats) -> tuple[float, float]:
        """How far stripes lie from a prior (h, w), in pixels, within half a period either way, as
        most quads have it; and how well the quads agree: 1 is perfectly."""
        period = self.code.period_px
        with np.errstate(invalid="ignore"):
            known = np.isfinite(near_px) & ~self._saturated
            turn = self._z * np.exp(-2j * np.pi * np.where(known, near_px, 0.0) / period)
            turn = np.where(known & (self.mean > 0.0), turn / np.maximum(self.mean, 1e-12), 0.0)
        together = complex(turn.sum())
        alike = abs(together) / max(float(np.abs(turn).sum()), 1e-12)
        return period * float(np.angle(together)) / (2.0 * np.pi), alike

    def place(self, near_px: Floats) -> Placed:
        """Pixel of each quad, in the period nearest to `near_px`; its standard deviation, and
        whether it is valid."""
        period = self.code.period_px
        size = np.abs(self._z)
        with np.errstate(all="ignore"):
            angle = np.angle(self._z)
            at = period * angle / (2.0 * np.pi)
            at += period * np.round((near_px - at) / period)
            along = np.maximum(
                0.5 * (self._variance - (self._turned * np.exp(-2j * angle)).real), 0.0
            )
            sigma = period / (2.0 * np.pi) * np.sqrt(along) / size
            depth = 2.0 / self.code.steps * size
            valid = (depth > _LEAST_MODULATION * self.mean) & (
                size > LIT_SIGMAS * np.sqrt(0.5 * self._variance)
            )
            valid &= np.isfinite(at)
        return at, sigma, valid & ~self._saturated


def join_axes_on_panel(axes: Sequence[Placed], code: PhaseCode) -> DecodedQuads:
    """Join both axes. Raises CalibrationError where few quads are decoded, or many lie off the
    panel."""
    found = join_axes(axes, code)
    panel_px, valid = found.panel_px, found.valid
    inside = ((panel_px >= 0.0) & (panel_px <= code.size_px)).all(axis=-1)
    # Half a period beyond the panel, the period's number is wrong; a little beyond is noise.
    near = ((panel_px > -1.0) & (panel_px < np.array(code.size_px) + 1.0)).all(axis=-1)
    beyond = float(np.mean(~np.asarray(near)[valid]))
    if beyond > _MOST_BEYOND:
        raise CalibrationError(
            f"{beyond:.0%} of the stripes are decoded to places beyond the {code.panel}",
            device=code.panel,
            hint="the stored map is off by a period, or the patterns were not shown in order",
        )
    return DecodedQuads(panel_px, found.sigma_px, valid & inside)


def join_axes(axes: Sequence[Placed], code: PhaseCode) -> DecodedQuads:
    """Join both axes, wherever the pixels lie. Raises CalibrationError where few quads are
    decoded."""
    (x, sigma_x, valid_x), (y, sigma_y, valid_y) = axes
    valid = valid_x & valid_y
    share = cv2.blur(valid.astype(np.float32), (_AROUND, _AROUND), borderType=cv2.BORDER_REPLICATE)
    valid &= share >= _AROUND_SHARE
    if valid.mean() < LEAST_VALID:
        raise CalibrationError(
            f"stripes are seen in {valid.mean():.1%} of the photo only",
            device=code.panel,
            hint="expose so that white is well lit and not saturated, focus, take off the lens cap",
        )
    return DecodedQuads(np.stack([x, y], axis=-1), np.stack([sigma_x, sigma_y], axis=-1), valid)
