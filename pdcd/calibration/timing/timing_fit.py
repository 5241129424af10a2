"""Least squares: the times of both panels out of the brightness of strips."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pdcd.calibration.timing.timing_model import COMMON, STEP, Model, Tail, Times

Floats = NDArray[np.float64]

SHORTEST_S, LONGEST_S = 2e-5, 0.06
"""Bounds of time constants."""
LEAKS = (0.0, 0.5)
STARTS_S = (0.0008, 0.004)
"""Time constants from which the fit starts, in all four combinations of both panels."""
LAGS_A_REFRESH = 6
KEPT_STARTS = 2
TAIL_START = 0.05, 4.0
TAIL_BOUNDS = ((0.0, 1.5), (0.4, 12.0))
"""Share and slowness of a second answer."""
TRIES = 30
"""Most steps of a fit; ten are usual."""
NO_SLOPE = 1e-9
"""Standard deviations for a whole unit of a parameter: less is none."""
FLAT = 5e-4
"""Relative error of each strip beside noise, at most: of flat field and lamp."""
FLOOR = 1e-4
"""Error of each strip over white beside that, at most."""
LEAST_FLOORS = 0.02
"""Share of both that is left at least, however well strips fit."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """times : the best. covariance : of the logarithms of four time constants, two leaks, the lags,
    what the lag grows across, then share and slowness of a tail where there is one.

    chi2 : reduced, by `FLAT` and `FLOOR` as they stand. scale, stray : (photos, B). dof : degrees
    of freedom. left : (photos, B, K) what the times do not explain of the strips, in standard
    deviations. floors : the share of `FLAT` and `FLOOR` that what is left of the strips speaks for.
    """

    times: Times
    covariance: Floats
    chi2: float
    dof: int
    scale: Floats
    stray: Floats
    left: Floats
    floors: float


class Fit:
    """The readings of a model, and their errors.

    floors : share of `FLAT` and `FLOOR` to weigh by. All of it, where a bench does better, hides
    the faint tails of slow panels, which tell a late mask from a slow projector.
    """

    def __init__(self, model: Model, floors: float = 1.0) -> None:
        self._model, self._floors = model, floors
        self._value = np.stack([r.value for r in model.readings])
        noise = np.stack([r.sigma for r in model.readings])
        most = (FLAT * self._value) ** 2 + FLOOR**2
        self._stated = np.sqrt(noise**2 + most)
        self._sigma = np.sqrt(noise**2 + floors**2 * most)
        self._past = np.stack([r.past for r in model.readings])
        self._bands = self._value.shape[1]

    def starts(self) -> list[Times]:
        """The best few of a coarse search; lags of each band by itself."""
        model, refresh = self._model, self._model.refresh_s
        period = model.readings[0].projector[0].of
        steps = period * LAGS_A_REFRESH
        lags = (np.arange(steps) / LAGS_A_REFRESH - 0.5 * period) * refresh - model.apart_s
        found = []
        for p_tau in STARTS_S:
            for m_tau in STARTS_S:
                taus = np.array([p_tau, p_tau, m_tau, m_tau])
                times = Times(taus, np.full(2, 2e-3), lags)
                shape = model.anywhere(times)  # (photos, lags, K): correction is none yet
                chi2 = self._coarse(shape)
                best = chi2.argmin(axis=0)
                found.append((float(chi2.min(axis=0).sum()), replace(times, lags_s=lags[best])))
        found.sort(key=lambda pair: pair[0])
        return [times for _, times in found[:KEPT_STARTS]]

    def _coarse(self, shape: Floats) -> Floats:
        """chi^2 of every lag at every band, (lags, B), scale and stray light free."""
        total = np.zeros((shape.shape[1], self._bands))
        for n in range(len(shape)):
            for b in range(self._bands):
                weight = 1.0 / self._sigma[n, b] ** 2
                x, y = shape[n], self._value[n, b]
                x = x - (x @ weight)[:, None] / weight.sum()
                y = y - (y @ weight) / weight.sum()
                scale = (x * y) @ weight / np.maximum((x * x) @ weight, 1e-300)
                left = y - np.maximum(scale, 0.0)[:, None] * x
                total[:, b] += (left * left) @ weight
        return total

    def solve(self, start: Times, *, tail: bool | None = None) -> Fitted:
        """Least squares from one start. tail : give the mask (True) or the projector (False) a
        second answer."""
        if tail is not None:
            start = replace(start, tail=Tail(tail, *TAIL_START))
        photos, bands = self._value.shape[:2]
        linear = np.concatenate([np.ones(photos * bands), np.zeros(photos * bands)])
        free = self._packed(start)
        lower, upper = self._bounds(start, free.size)
        at = np.clip(np.concatenate([free, linear]), lower + 1e-9, upper - 1e-9)
        solved = least_squares(
            lambda v: self._residuals(v, start.tail),
            at,
            jac=lambda v: self._slopes(v, start.tail),
            bounds=(lower, upper),
            x_scale="jac",
            ftol=1e-10,
            xtol=1e-9,
            gtol=1e-9,
            max_nfev=TRIES,
        )
        best = np.asarray(solved.x, dtype=np.float64)
        times, scale, stray = self._unpacked(best, start.tail)
        dof = max(self._value.size - best.size, 1)
        left = np.asarray(solved.fun, dtype=np.float64)
        of_stated = left.reshape(self._value.shape) * self._sigma / self._stated
        chi2 = float(np.sum(of_stated**2)) / dof
        floors = self._floors * float(np.sqrt(left @ left / dof))
        floors = min(max(floors, LEAST_FLOORS), 1.0)
        covariance = self._covariance(np.asarray(solved.jac, dtype=np.float64), left)
        count = free.size
        known = covariance[:count, :count]
        return Fitted(times, known, chi2, dof, scale, stray, of_stated, floors)

    def _covariance(self, jac: Floats, residuals: Floats) -> Floats:
        """Covariance of all parameters, by the scatter of the residuals. What all bands of a strip
        share (an uneven field, a panel that is not quite exponential) does not average out; how
        much that is, the residuals tell."""
        norm = np.linalg.norm(jac, axis=0)
        idle = norm < NO_SLOPE  # nothing depends on it: nothing is known of it
        norm = np.where(idle, 1.0, norm)
        slopes = jac / norm
        inverse = np.linalg.pinv(slopes.T @ slopes, rcond=1e-12)
        photos, bands, count = self._value.shape
        left = residuals.reshape(photos, bands, count)
        whole = float(np.mean(left**2))
        of_strips = float(np.mean(left.mean(axis=1) ** 2))
        shared = (bands * of_strips - whole) / (bands - 1) if bands > 1 else whole
        shared = min(max(shared, 0.0), whole)
        own = (whole - shared) * left.size / max(left.size - jac.shape[1], 1)
        shared *= photos * count / max(photos * count - COMMON - 3, 1)
        by_strip = slopes.reshape(photos, bands, count, -1).sum(axis=1).reshape(-1, norm.size)
        middle = own * slopes.T @ slopes + shared * by_strip.T @ by_strip
        found = np.asarray(inverse @ middle @ inverse / np.outer(norm, norm))
        found[idle, idle] = np.inf
        return found

    def _packed(self, times: Times) -> Floats:
        more = [] if times.tail is None else [times.tail.share, np.log(times.tail.slower)]
        lags = np.append(times.lags_s, times.across_s) / self._model.refresh_s
        return np.concatenate([np.log(times.taus_s), times.leaks, lags, more])

    def _bounds(self, start: Times, free: int) -> tuple[Floats, Floats]:
        linear = 2 * self._value.shape[0] * self._bands
        lower = np.full(free + linear, -np.inf)
        upper = np.full(free + linear, np.inf)
        lower[:4], upper[:4] = np.log(SHORTEST_S), np.log(LONGEST_S)
        lower[4:COMMON], upper[4:COMMON] = LEAKS
        lower[4] -= min(float((r.room / r.past).min()) for r in self._model.readings)
        if start.tail is not None:
            (lower[free - 2], lower[free - 1]), (upper[free - 2], upper[free - 1]) = (
                (TAIL_BOUNDS[0][0], 0.4),
                (0.4, np.log(TAIL_BOUNDS[1][1])),
            )
        return lower, upper

    def _unpacked(self, v: Floats, tail: Tail | None) -> tuple[Times, Floats, Floats]:
        bands, refresh = self._bands, self._model.refresh_s
        lags = v[COMMON : COMMON + bands] * refresh
        across_s = float(v[COMMON + bands]) * refresh
        at = COMMON + bands + 1
        if tail is not None:
            tail = Tail(tail.mask, float(v[at]), float(np.exp(v[at + 1])))
            at += 2
        shape = self._value.shape[:2]
        scale, stray = v[at:].reshape(2, *shape)
        return Times(np.exp(v[:4]), v[4:COMMON], lags, tail, across_s), scale, stray

    def _residuals(self, v: Floats, tail: Tail | None) -> Floats:
        times, scale, stray = self._unpacked(v, tail)
        found = scale[..., None] * self._model.shape(times) + stray[..., None] * self._past
        return np.asarray(((found - self._value) / self._sigma).ravel())

    def _slopes(self, v: Floats, tail: Tail | None) -> Floats:
        """Derivatives of the residuals, (readings, parameters)."""
        photos, bands, count = self._value.shape
        times, scale, _ = self._unpacked(v, tail)
        lags = slice(COMMON, COMMON + bands)
        common = [*range(COMMON), *range(COMMON + bands, v.size - 2 * photos * bands)]
        variants = [times]
        for moved in (lags, *common):  # the lag of a band moves that band alone: all at once
            there = v.copy()
            there[moved] += STEP
            variants.append(self._unpacked(there, tail)[0])
        here, *others = self._model.shapes(variants)
        by_lag, *by_common = (scale[..., None] * (other - here) / STEP for other in others)
        out = np.zeros((photos, bands, count, v.size))
        for number, slope in zip(common, by_common, strict=True):
            out[..., number] = slope
        band = np.arange(bands)
        out[:, band, :, COMMON + band] = by_lag.transpose(1, 0, 2)
        first = v.size - 2 * photos * bands
        for n in range(photos):
            at = first + n * bands + band
            out[n, band, :, at] = here[n]
            out[n, band, :, at + photos * bands] = self._past[n]
        return np.asarray((out / self._sigma[..., None]).reshape(-1, v.size))
