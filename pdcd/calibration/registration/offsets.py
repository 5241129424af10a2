"""The offset of the mask's map from where light and mask really meet, by stripes on both panels.

Each photo is divided by one with both panels white, and averaged over whole stripes by three box
filters of one period each. At a place of the field, photo s then has the light

    I_s = a_0 + sum over odd n of a_n cos(2 pi n (e / P - s / S)),

where e is the offset: the position of a mask pixel by the mask's map, less its true one, in
projector pixels. So e = P / (2 pi) arg sum_s I_s exp(2 pi i s / S). The camera's map says only
where on the field a place is, and an error of pixels there does no harm. Light of the scene or the
room that is smooth over the stripes is the same in all photos and drops out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from pdcd.arrays import Floats
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.registration import series_faults
from pdcd.calibration.registration.averaging import StripeAverager
from pdcd.calibration.registration.stripes import StripePlan
from pdcd.calibration.window import WHOLE, Window
from pdcd.panels.map import Map, map_between

_Complex = NDArray[np.complex128]

_PER_PERIOD = 8
"""Blocks of quads per period, at least: photos are first averaged over blocks."""
_APART = 1.5
"""Periods from one measured place to the next: their boxes share little light."""


@dataclass(frozen=True, eq=False)
class StripeSeries:
    """The measurements of one series of stripes, at n places.

    quads : (n, 2) places in the camera's photo.
    share : (n, S) light of each step, over white, averaged over stripes.
    first : (n,) complex, a_1 / 2 exp(2 pi i e / P).
    sigma : (n,) standard deviation of either part of `first`, by photon and read noise.
    """

    stripes: StripePlan
    quads: Floats
    share: Floats
    first: _Complex
    sigma: Floats

    @property
    def offset_px(self) -> Floats:
        """Offset of the mask's map along the stripes' axis, (n,), within half a period."""
        return np.asarray(self.stripes.period_px / (2.0 * np.pi) * np.angle(self.first))

    @property
    def sigma_px(self) -> Floats:
        """Its standard deviation, (n,), by noise alone."""
        return np.asarray(self.stripes.period_px / (2.0 * np.pi) * self.sigma / np.abs(self.first))

    @property
    def modulation(self) -> Floats:
        """Depth of the stripes, (n,): 8 / pi^2 = 0.81 where nothing is blurred and all is dark."""
        return np.asarray(2.0 * np.abs(self.first) / self.share.mean(axis=1))


@dataclass(frozen=True, eq=False)
class MaskOffsets:
    """The offset of the mask's map at n places, in projector pixels.

    points_px : (n, 2) in pixels of the mask, by the maps in use.
    offset_px, sigma_px : (n, 2) right and down: positions by the map less the true ones.
    """

    points_px: Floats
    offset_px: Floats
    sigma_px: Floats

    def quantile_px(self, share: float) -> float:
        """The length that this share of the offsets stays below."""
        return float(np.quantile(np.hypot(*self.offset_px.T), share))

    @property
    def e95_px(self) -> float:
        """The 95th percentile of the offsets: measured after a correction, it is the planner's
        number."""
        return self.quantile_px(0.95)


class StripeSeriesBuilder:
    """A series under way: only averages of each photo are kept.

    Parameters
    ----------
    white : both panels white for as many refreshes as the projector was lit.
    camera, projector : maps in use.
    window : the part of the field to be measured.

    Raises CalibrationError for a white photo without light, or saturated.
    """

    def __init__(
        self,
        stripes: StripePlan,
        white: QuadPhoto,
        camera: Map,
        projector: Map,
        *,
        window: Window = WHOLE,
    ) -> None:
        self._stripes, self._camera, self._projector = stripes, camera, projector
        self._window = window
        by = white.main
        self._lit = series_faults.find_lit_quads(by, white.main_variance)
        series_faults.check_stripe_saturation(white.saturated, self._lit)
        self._period = stripes.period_px * _quads_per_px(stripes.axis, camera, projector)
        block = max(1, int(self._period / _PER_PERIOD))
        self._averaging = StripeAverager(self._lit, by, self._period, block)
        self._stack: list[Floats] = []
        self._noise = np.zeros(self._averaging.count.shape)

    def add(self, photo: QuadPhoto) -> None:
        """The next photo, in the order of
        `pdcd.calibration.registration.stripes.make_stripe_sequences`. Raises CalibrationError for a
        saturated one."""
        series_faults.check_stripe_saturation(photo.saturated, self._lit)
        self._stack.append(self._averaging.over_white(photo.main))
        noise = self._averaging.over_white(photo.main_variance, power=2)
        self._noise += noise / self._stripes.steps

    def series(self, *, placed: bool = False) -> StripeSeries:
        """What all S photos show.

        placed : a longer period has already located the mask's stripes. Then the camera need not
            resolve these; they are averaged anyway.

        Raises CalibrationError for photos without light or modulation, a mirrored mask, a bench
        that moved or whose light changed, and where less than 60 % of the field could be measured.
        """
        stripes, averaging, steps = self._stripes, self._averaging, self._stripes.steps
        if len(self._stack) != steps:
            raise ValueError(f"{len(self._stack)} photos of stripes; {steps} belong to the series")
        places = averaging.places(_APART * self._period)
        series_faults.check_window_coverage(places, self._camera, self._period, self._window)
        stack = [self._stack[place] for place in np.argsort(stripes.order)]
        turns = np.exp(2j * np.pi * np.arange(steps) / steps) / steps
        share = np.stack([averaging.at(averaging.smooth(each), places) for each in stack], axis=-1)
        variance = averaging.at(averaging.smooth(self._noise), places)
        # Half of the noise of S photos falls on either part of their first harmonic.
        sigma = np.sqrt(variance / (2.0 * steps)) * averaging.noise
        found = StripeSeries(stripes, places, share, share @ turns, sigma)
        series_faults.check_stripe_contrast(share, found.first, sigma)
        if not placed:
            turning = np.tensordot(turns, np.stack(stack), 1)
            carrier = _carrier(stripes, self._camera, self._projector, averaging)
            series_faults.check_stripe_direction(turning, carrier, found.first, averaging, places)
        series_faults.check_series_consistency(share, found.first, sigma)
        return found


def measure_mask_offsets(
    right: StripeSeries, down: StripeSeries, camera: Map, mask: Map, *, corrected: bool = False
) -> MaskOffsets:
    """The offset of the mask's map, from upright and lying stripes of one period.

    camera, mask : maps in use.
    corrected : whether the mask's map was corrected by a longer period. Then this series shows the
        remaining offset, and whether the longer period matched the wrong stripes.

    Raises CalibrationError where stripes may have been matched wrongly: for offsets of 0.4 periods
    and more, or of more than 1 px after the correction by a longer period.
    """
    period = right.stripes.period_px
    # Both series use the same white photo, but a period may have more quads along one axis.
    other = find_nearest(right.quads, down.quads)
    points = map_between(camera, mask, right.quads)
    found = np.stack([right.offset_px, down.offset_px[other]], axis=-1)
    sigma = np.stack([right.sigma_px, down.sigma_px[other]], axis=-1)
    refuse = series_faults.check_same_stripe if corrected else series_faults.check_offset_range
    refuse(found, period)
    return MaskOffsets(points, found, sigma)


def find_nearest(wanted: Floats, places: Floats) -> NDArray[np.intp]:
    """For each of the places `wanted` (n, 2), the number of the nearest of `places` (m, 2),
    (n,)."""
    return np.asarray(cKDTree(places).query(wanted)[1])


def _quads_per_px(axis: int, camera: Map, projector: Map) -> float:
    """Quads from one line of the projector's pixels along an axis to the next, in the middle of the
    camera's photo."""
    middle = 0.5 * np.array(camera.size_px, dtype=np.float64)
    of_pixels = projector.jacobian(map_between(camera, projector, middle))
    px_by_quad = np.linalg.solve(of_pixels, camera.jacobian(middle))
    return float(1.0 / np.hypot(*px_by_quad[axis]))


def _carrier(
    stripes: StripePlan, camera: Map, projector: Map, averaging: StripeAverager
) -> _Complex:
    """The mask's stripes by the maps, at each block of a photo: exp(2 pi i x/P).

    Computed at every eighth block and interpolated, which is accurate enough for a phase.
    """
    rows, cols = averaging.count.shape
    every = 8
    y, x = (np.arange(-every, side + 2 * every, every) for side in (rows, cols))
    points = (np.stack(np.meshgrid(x, y), axis=-1) + 0.5) * averaging.block
    coarse = map_between(camera, projector, points)[..., stripes.axis]
    down, right = np.meshgrid(
        (np.arange(rows) - y[0]) / every, (np.arange(cols) - x[0]) / every, indexing="ij"
    )
    place = ndimage.map_coordinates(coarse, [down, right], order=1, mode="nearest")
    return np.asarray(np.exp(2j * np.pi * place / stripes.period_px))
