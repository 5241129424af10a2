"""Least squares: the times of both panels from the brightness of strips."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from pdcd.arrays import Floats
from pdcd.calibration.timing.timing_model import (
    COMMON_PARAMETERS,
    STEP,
    PanelTimes,
    StripModel,
    Tail,
)
from pdcd.errors import CalibrationError

_SHORTEST_S, LONGEST_TAU_S = 2e-5, 0.06
"""Bounds of time constants."""
_LEAKS = (0.0, 0.5)
_STARTS_S = (0.0008, 0.004)
"""Time constants from which the fit starts, in all four combinations of both panels."""
_LIKELY_S, _LIKELY_SD = 2e-3, 1.0
"""Prior of a time constant, and its standard deviation as a power of e: it decides where noise
hides a fast projector behind a slow mask."""
_LAGS_A_REFRESH = 6
_KEPT_STARTS = 2
_REACH = 2.5
"""Refreshes by which a lag may have changed since it was measured, at most."""
_MODEL, _EXPLAINED = 4e-3, 5.0
"""Error of strips, over white, at another lag, by times that are known to 5 %; and the largest
residual of a lag, over that and the strips' errors."""
_TAIL_START = 0.05, 4.0
_TAIL_BOUNDS = ((0.0, 1.5), (0.4, 12.0))
"""Bounds of the share and the slowness of a second response."""
_TRIES = 30
"""Most steps of a fit; ten are usual."""
_NO_SLOPE = 1e-9
"""Change of the residuals, in standard deviations per unit of a parameter, below which the
parameter has no effect."""
FLAT = 5e-4
"""Relative error of each strip in addition to noise, at most: of flat field and lamp."""
FLOOR = 1e-4
"""Absolute error of each strip, over white, in addition to these, at most."""
LEAST_FLOORS = 0.02
"""Share of both that is kept at least, however well strips fit."""


@dataclass(frozen=True, eq=False)
class FittedTiming:
    """times : the best. covariance : of the logarithms of four time constants, two leaks, the lags,
        the growth of the lag across, then share and slowness of a tail where there is one.

    chi2 : reduced, with all of `FLAT` and `FLOOR`. stray : (photos, B).
    light, left : (photos, B, K), light of the strips by the times, and the residuals, in standard
        deviations.
    floors : share of `FLAT` and `FLOOR` that the residuals suggest.
    """

    times: PanelTimes
    covariance: Floats
    chi2: float
    stray: Floats
    light: Floats
    left: Floats
    floors: float


class TimingFitter:
    """The readings of a model, and their errors.

    floors : share of `FLAT` and `FLOOR` in the weights. The full errors, where a bench is better
        than that, would hide the faint tails of slow panels, which distinguish a late mask from a
        slow projector.
    """

    def __init__(self, model: StripModel, floors: float = 1.0) -> None:
        self._model, self._floors = model, floors
        self._value = np.stack([r.value for r in model.readings])
        noise = np.stack([r.sigma for r in model.readings])
        most = (FLAT * self._value) ** 2 + FLOOR**2
        self._stated = np.sqrt(noise**2 + most)
        self._sigma = np.sqrt(noise**2 + floors**2 * most)
        self._past = np.stack([r.past for r in model.readings])
        self._bands = self._value.shape[1]

    def starts(self) -> list[PanelTimes]:
        """The best few of a coarse search; the lag of each band is searched separately."""
        model, refresh = self._model, self._model.refresh_s
        period = model.readings[0].programmes[0].of
        steps = period * _LAGS_A_REFRESH
        lags = (np.arange(steps) / _LAGS_A_REFRESH - 0.5 * period) * refresh - model.apart_s
        found = []
        for p_tau in _STARTS_S:
            for m_tau in _STARTS_S:
                taus = np.array([p_tau, p_tau, m_tau, m_tau])
                times = PanelTimes(taus, np.full(2, 2e-3), lags)
                shape = model.anywhere(times)  # (photos, lags, K): correction is none yet
                chi2 = self._chi2(shape.swapaxes(0, 1)[:, :, None]).sum(axis=1)  # (lags, B)
                best = chi2.argmin(axis=0)
                found.append((float(chi2.min(axis=0).sum()), replace(times, lags_s=lags[best])))
        found.sort(key=lambda pair: pair[0])
        return [times for _, times in found[:_KEPT_STARTS]]

    def solve(self, start: PanelTimes, *, tail: bool | None = None) -> FittedTiming:
        """Least squares from one start. tail : give the mask (True) or the projector (False) a
        second response."""
        if tail is not None:
            start = replace(start, tail=Tail(tail, *_TAIL_START))
        free = self._packed(start)
        lower, upper = self._bounds(start, free.size)
        solved = least_squares(
            lambda v: np.append(
                self._beside(self._model.shape(self._unpacked(v, start)))[0],
                (v[:4] - np.log(_LIKELY_S)) / _LIKELY_SD,
            ),
            np.clip(free, lower + 1e-9, upper - 1e-9),
            jac=lambda v: np.vstack([self._slopes(v, start), np.eye(4, free.size) / _LIKELY_SD]),
            bounds=(lower, upper),
            method="dogbox",  # it takes whole steps where a parameter does not matter at all
            x_scale="jac",
            ftol=1e-10,
            xtol=1e-9,
            gtol=1e-9,
            max_nfev=_TRIES,
        )
        times = self._unpacked(np.asarray(solved.x, dtype=np.float64), start)
        left, numbers, _ = self._beside(self._model.shape(times))
        dof = max(left.size - free.size - numbers.size, 1)
        of_stated = left * self._sigma / self._stated
        chi2 = float(np.sum(of_stated**2)) / dof
        floors = self._floors * float(np.sqrt(np.sum(left**2) / dof))
        floors = min(max(floors, LEAST_FLOORS), 1.0)
        covariance = self._covariance(np.asarray(solved.jac[:-4], dtype=np.float64), left)
        light = self._value + left * self._sigma
        return FittedTiming(times, covariance, chi2, numbers[..., 1], light, of_stated, floors)

    def later(self, times: PanelTimes) -> tuple[float, float]:
        """How much later the mask is than at known times, in s, and its standard deviation; the
        leak of its black may have changed, too.

        Raises CalibrationError for strips that no lag explains.
        """
        refresh = self._model.refresh_s

        def moved(v: Floats) -> PanelTimes:
            leaks = times.leaks + np.array([0.0, v[1]])
            return replace(times, lags_s=times.lags_s + v[0] * refresh, leaks=leaks)

        reach = round(2 * _REACH * _LAGS_A_REFRESH)
        tried = np.arange(-reach, reach + 1) / (2.0 * _LAGS_A_REFRESH)
        shapes = self._model.shapes([moved(np.array([by, 0.0])) for by in tried])
        best = float(tried[int(self._chi2(shapes).sum(axis=(1, 2)).argmin())])
        solved = least_squares(
            lambda v: self._beside(self._model.shape(moved(v)))[0].ravel(),
            (best, 0.0),
            x_scale="jac",
        )
        left = solved.fun.reshape(self._sigma.shape)
        chi = float(np.sqrt(np.mean(left**2 / (1.0 + (_MODEL / self._sigma) ** 2))))
        if chi > _EXPLAINED:
            raise CalibrationError(
                f"no lag explains the timing strips ({chi:.0f} times their noise)",
                device="display",
                hint="calibrate the timing again",
            )
        spread = max(1.0, float(np.sqrt(np.mean(left**2))))
        sigma = spread * float(np.sqrt(np.linalg.inv(solved.jac.T @ solved.jac)[0, 0]))
        return float(solved.x[0]) * refresh, sigma * refresh

    def _beside(self, shape: Floats) -> tuple[Floats, Floats, Floats]:
        """Fit light of this shape (..., photos, B, K) to the readings, with the best scale and
        stray light of each band of each photo. Returns the residuals, in standard deviations; scale
        and stray light (..., photos, B, 2); and an orthonormal basis of what these two can explain,
        (..., photos, B, K, 2)."""
        shape, past = np.broadcast_arrays(shape, self._past)
        both, size = np.linalg.qr(np.stack([shape, past], axis=-1) / self._sigma[..., None])
        wanted = self._value / self._sigma
        along = np.einsum("...kn,...k->...n", both, wanted)
        numbers = (np.linalg.pinv(size) @ along[..., None])[..., 0]
        return np.einsum("...kn,...n->...k", both, along) - wanted, numbers, both

    def _chi2(self, shape: Floats) -> Floats:
        """chi^2 of shapes (..., photos, B, K) in each band of each photo; negative light is not
        accepted."""
        left, numbers, _ = self._beside(shape)
        dark = ((self._value / self._sigma) ** 2).sum(axis=-1)
        return np.asarray(np.where(numbers[..., 0] > 0.0, (left**2).sum(axis=-1), dark))

    def _covariance(self, slopes: Floats, left: Floats) -> Floats:
        """Covariance of all parameters, by the scatter of the residuals (photos, B, K). Errors that
        all bands of a strip share (an uneven field, a panel that is not quite exponential) do not
        average out; how large they are is estimated from the residuals."""
        norm = np.linalg.norm(slopes, axis=0)
        idle = norm < _NO_SLOPE  # no reading depends on it, so nothing is known of it
        norm = np.where(idle, 1.0, norm)
        slopes = slopes / norm
        inverse = np.linalg.pinv(slopes.T @ slopes, rcond=1e-12)
        photos, bands, count = left.shape
        whole = float(np.mean(left**2))
        of_strips = float(np.mean(left.mean(axis=1) ** 2))
        shared = (bands * of_strips - whole) / (bands - 1) if bands > 1 else whole
        shared = min(max(shared, 0.0), whole)
        numbers = norm.size + 2 * photos * bands
        own = (whole - shared) * left.size / max(left.size - numbers, 1)
        shared *= photos * count / max(photos * count - COMMON_PARAMETERS - 3, 1)
        by_strip = slopes.reshape(photos, bands, count, -1).sum(axis=1).reshape(-1, norm.size)
        middle = own * slopes.T @ slopes + shared * by_strip.T @ by_strip
        found = np.asarray(inverse @ middle @ inverse / np.outer(norm, norm))
        found[idle, idle] = np.inf
        return found

    def _packed(self, times: PanelTimes) -> Floats:
        more = [] if times.tail is None else [times.tail.share, np.log(times.tail.slower)]
        lags = np.append(times.lags_s, times.across_s) / self._model.refresh_s
        return np.concatenate([np.log(times.taus_s), times.leaks, lags, more])

    def _bounds(self, start: PanelTimes, free: int) -> tuple[Floats, Floats]:
        lower, upper = np.full(free, -np.inf), np.full(free, np.inf)
        lower[:4], upper[:4] = np.log(_SHORTEST_S), np.log(LONGEST_TAU_S)
        lower[4:COMMON_PARAMETERS], upper[4:COMMON_PARAMETERS] = _LEAKS
        lower[4] -= min(float((r.room / r.past).min()) for r in self._model.readings)
        if start.tail is not None:
            lower[-2:], upper[-2:] = (_TAIL_BOUNDS[0][0], 0.4), (0.4, np.log(_TAIL_BOUNDS[1][1]))
        return lower, upper

    def _unpacked(self, v: Floats, start: PanelTimes) -> PanelTimes:
        lags = v[COMMON_PARAMETERS : COMMON_PARAMETERS + self._bands + 1] * self._model.refresh_s
        tail = start.tail and Tail(start.tail.mask, float(v[-2]), float(np.exp(v[-1])))
        return PanelTimes(np.exp(v[:4]), v[4:COMMON_PARAMETERS], lags[:-1], tail, float(lags[-1]))

    def _slopes(self, v: Floats, start: PanelTimes) -> Floats:
        """Derivatives of the residuals, (readings, parameters), without the part that scale and
        stray light absorb, which is orthogonal to the rest."""
        lags = slice(COMMON_PARAMETERS, COMMON_PARAMETERS + self._bands)
        common = [*range(COMMON_PARAMETERS), *range(COMMON_PARAMETERS + self._bands, v.size)]
        variants = [self._unpacked(v, start)]
        for moved in (lags, *common):  # the lag of a band moves that band alone: all at once
            there = v.copy()
            there[moved] += STEP
            variants.append(self._unpacked(there, start))
        here, *others = self._model.shapes(variants)
        _, numbers, both = self._beside(here)
        by_lag, *by_common = (numbers[..., :1] * (other - here) / STEP for other in others)
        out = np.zeros((*here.shape, v.size))
        out[..., common] = np.stack(by_common, axis=-1)
        band = np.arange(self._bands)
        out[:, band, :, COMMON_PARAMETERS + band] = by_lag.transpose(1, 0, 2)
        out = out / self._sigma[..., None]
        out -= both @ (both.swapaxes(-1, -2) @ out)
        return out.reshape(-1, v.size)
