"""When the shutter really opened and closed: a bar moves over the card by one cell each refresh.

Cell c is lit at refreshes c, c + n, c + 2n, ...; the mask is open. A cell that was lit while the
shutter moved has only a part of a pulse. With ``G(t)`` the light that a pulse has given until t,

    light of a cell = scale * {sum over its pulses of [G(closed - start) - G(opened - start)]
                               + room * (closed - opened)} + stray

where ``room`` is light other than the projector's there, over its white. Each time follows from the
few cells in which it falls. They are on the clock of the frame log; a delay that all light of the
projector has is part of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pdcd.arrays import Floats
from pdcd.calibration.shutter.bars import BarLight
from pdcd.errors import CalibrationError
from pdcd.panels.frames import FrameLog

_REACH_S = 0.3
"""Largest difference of a shutter's times from the expected ones."""
_CHI2 = 3.0
"""Largest reduced chi^2 that is believed."""
_FLAT = 5e-4
"""Relative error of a cell in addition to noise: of the flat field, and of a pulse."""
_STEPS_A_REFRESH = 3
"""Steps of the coarse search per refresh."""
_EVENNESS = 0.03
"""Cells of a bar that did not run differ by less than this, over their mean: each had 30 pulses."""
_APART = 4.0
"""Cells, at least, between the one in which the shutter opened and the one in which it closed."""
_SHORTEST_S = 1e-7
_PLACES = (np.arange(8) + 0.5) / 8 - 0.5
"""Rows of a band that are modelled, in bands from its middle."""
_ROUNDS = 2
"""Rounds that model the rows of a band separately, by the travel over the bands of the round
before."""
_TAU_STEP = 0.01


@dataclass(frozen=True)
class ShutterTimes:
    """One exposure, in s on the clock of the log; sigma is one standard deviation.

    chi2 : reduced, the worst of all bands. bands : (B,) middle of each band of the camera's rows, 0
        to 1. by_band : (B, 2) opened and closed; a focal-plane shutter's blades need time to
        travel.
    """

    opened_s: float
    closed_s: float
    opened_sigma_s: float
    closed_sigma_s: float
    chi2: float
    bands: Floats
    by_band: Floats

    @property
    def travel_s(self) -> tuple[float, float]:
        """How much later the last row opened, and closed, than the first: slopes of straight lines
        through the bands."""
        if self.bands.size < 2:
            return 0.0, 0.0
        opened, closed = np.polyfit(self.bands, self.by_band, 1)[0]
        return float(opened), float(closed)


@dataclass(frozen=True)
class ShutterLag:
    """For several exposures: mean time from the command to the light, its standard error, and the
    scatter from one exposure to the next without that of the measurement; in s."""

    lag_s: float
    sigma_s: float
    jitter_s: float


def fit_shutter(
    light: BarLight,
    log: FrameLog,
    about_s: tuple[float, float],
    taus_s: tuple[float, float],
    *,
    tau_sigma: float = 0.0,
) -> ShutterTimes:
    """Times at which the shutter opened and closed.

    Parameters
    ----------
    light : of all cells. log : what the projector showed.
    about_s : when it should have opened and closed, on the clock of the log.
    taus_s : rise and fall of the projector. tau_sigma : their relative errors, part of the sigmas.

    Raises CalibrationError: the bar is not seen, or did not run while the shutter moved; no times
    explain its light.
    """
    pulses = _Pulses.of(log, light.value.shape[1])
    _check_runs(light)
    opened = np.empty((len(light.value), 2))
    sigma, chi2 = np.empty_like(opened), np.empty(len(opened))
    bands = [_Band.of(light, number) for number in range(len(opened))]
    for number, band in enumerate(bands):
        start = _coarse(pulses, band, about_s, taus_s)
        opened[number], sigma[number], chi2[number] = _fine(pulses, band, start, taus_s)
    for _ in range(_ROUNDS if len(bands) > 1 else 0):
        # A projector that is set row by row, and blades, reach the rows of a band one after the
        # other.
        rows_s = np.outer(_PLACES, np.polyfit(np.arange(len(bands)), opened, 1)[0])
        for number, band in enumerate(bands):
            bands[number] = replace(band, rows_s=rows_s)
            opened[number], sigma[number], chi2[number] = _fine(
                pulses, bands[number], opened[number], taus_s
            )
    if tau_sigma:
        slower = (taus_s[0] * (1.0 + _TAU_STEP), taus_s[1] * (1.0 + _TAU_STEP))
        for number, band in enumerate(bands):
            moved = _fine(pulses, band, opened[number], slower)[0]
            own = (moved - opened[number]) / _TAU_STEP * tau_sigma
            sigma[number] = np.hypot(sigma[number], own)
    _check_inside(opened, pulses)
    _check_apart(opened, pulses)
    worst = float(chi2.max())
    if worst > _CHI2:
        raise CalibrationError(
            f"no times of opening and closing explain the bar (reduced chi^2 {worst:.0f}, wanted "
            f"below {_CHI2:g})",
            device="shutter",
            hint="measure the projector's rise and fall first; see that no refresh was lost, and "
            "that room lights are off",
        )
    mean = opened.mean(axis=0)
    spread = np.sqrt(np.mean(sigma**2, axis=0) / len(sigma))
    return ShutterTimes(
        float(mean[0]), float(mean[1]), float(spread[0]), float(spread[1]), worst, light.bands,
        opened,
    )  # fmt: skip


def estimate_shutter_lag(
    measured_s: Sequence[float], commanded_s: Sequence[float], sigma_s: Sequence[float]
) -> ShutterLag:
    """Lag and jitter out of several exposures, two or more: light against command."""
    late = np.asarray(measured_s, np.float64) - np.asarray(commanded_s, np.float64)
    scatter2 = float(np.var(late, ddof=1))
    own2 = float(np.mean(np.square(sigma_s)))
    return ShutterLag(
        float(late.mean()), float(np.sqrt(scatter2 / late.size)), max(scatter2 - own2, 0.0) ** 0.5
    )


@dataclass(frozen=True, eq=False)
class _Band:
    """One band of the camera's rows.

    value, errors, room : (n,) of its cells. rows_s : (rows, 2) how much later than the middle row
        its rows see the shutter open, and close.
    """

    value: Floats
    errors: Floats
    room: Floats
    rows_s: Floats

    @classmethod
    def of(cls, light: BarLight, number: int) -> _Band:
        value, noise = light.value[number], light.sigma[number]
        errors = np.sqrt(noise**2 + (_FLAT * value) ** 2 + (_FLAT * 0.2 * value.max()) ** 2)
        return cls(value, errors, light.room[min(number, len(light.room) - 1)], np.zeros((1, 2)))


@dataclass(frozen=True, eq=False)
class _Pulses:
    """When each cell was asked for light: (n,) starts and lengths of pulses, in s, and the cell."""

    start_s: Floats
    long_s: Floats
    cell: NDArray[np.int64]
    cells: int

    @classmethod
    def of(cls, log: FrameLog, cells: int) -> _Pulses:
        at = np.append(log.primal_ns, log.end_ns[0]).astype(np.int64)
        shown = log.primal_shown.astype(np.int64)
        lit = shown >= 0
        start_s, long_s = (np.asarray(v[lit] * 1e-9, np.float64) for v in (at[:-1], np.diff(at)))
        return cls(start_s, long_s, shown[lit] % cells, cells)

    def given(self, at_s: Floats, taus_s: tuple[float, float]) -> Floats:
        """Seconds of light that each cell has given until each of some times, (times, cells)."""
        r, f = (max(tau, _SHORTEST_S) for tau in taus_s)
        since = np.asarray(at_s)[:, None] - self.start_s
        up = np.clip(since, 0.0, self.long_s)
        down = np.maximum(since - self.long_s, 0.0)
        peak = -np.expm1(-self.long_s / r)
        light = up + r * np.expm1(-up / r) - peak * f * np.expm1(-down / f)
        out = np.zeros((len(light), self.cells))
        for cell in range(self.cells):
            out[:, cell] = light[:, self.cell == cell].sum(axis=1)
        return out


def _coarse(
    pulses: _Pulses, band: _Band, about_s: tuple[float, float], taus_s: tuple[float, float]
) -> Floats:
    """The best pair of times on a grid."""
    value, errors, room = band.value, band.errors, band.room
    refresh = float(np.median(pulses.long_s))
    reach = min(_REACH_S, 0.5 * (pulses.cells - 1) * refresh)
    steps = np.arange(-reach, reach + 1e-9, refresh / _STEPS_A_REFRESH)
    first, last = about_s[0] + steps, about_s[1] + steps
    model = pulses.given(last, taus_s)[None] - pulses.given(first, taus_s)[:, None]
    model += room * (last[None, :, None] - first[:, None, None])
    weight = 1.0 / errors**2
    x = model - (model @ weight)[..., None] / weight.sum()
    y = value - value @ weight / weight.sum()
    scale = np.maximum((x * y) @ weight / np.maximum((x * x) @ weight, 1e-300), 0.0)
    chi2 = ((y - scale[..., None] * x) ** 2) @ weight
    chi2[first[:, None] >= last[None, :]] = np.inf
    one, other = np.unravel_index(int(np.argmin(chi2)), chi2.shape)
    return np.array([first[one], last[other]])


def _fine(
    pulses: _Pulses, band: _Band, start: Floats, taus_s: tuple[float, float]
) -> tuple[Floats, Floats, float]:
    """Both times by least squares, their sigmas, and reduced chi^2."""
    value, errors, rows = band.value, band.errors, len(band.rows_s)
    refresh = float(np.median(pulses.long_s))
    level = float(value.max())

    def residuals(v: Floats) -> Floats:
        at = start + v[:2] * refresh
        given = pulses.given((at + band.rows_s).T.ravel(), taus_s)
        got = (given[rows:] - given[:rows]).mean(axis=0) + band.room * (at[1] - at[0])
        found = v[2] * level * got / typical + v[3] * level
        return np.asarray((found - value) / errors)

    first = pulses.given(start, taus_s)
    typical = max(float((first[1] - first[0]).max()), 1e-12)
    solved = least_squares(residuals, [0.0, 0.0, 1.0, 0.0], x_scale=[0.1, 0.1, 0.01, 0.01])
    dof = max(value.size - 4, 1)
    chi2 = 2.0 * float(solved.cost) / dof
    spread = np.linalg.pinv(solved.jac.T @ solved.jac) * max(chi2, 1.0)
    sigma = np.sqrt(np.diag(spread)[:2]) * refresh
    return start + np.asarray(solved.x[:2]) * refresh, sigma, chi2


def _check_runs(light: BarLight) -> None:
    """Refuse cells that are all equally bright."""
    mean = light.value.mean(axis=1)
    uneven = np.ptp(light.value, axis=1) / np.maximum(mean, 1e-300)
    if float(uneven.min()) < _EVENNESS:
        raise CalibrationError(
            "the bar does not show: all cells are equally bright",
            device="shutter",
            hint="the projector must show the bar 1:1, and an exposure must not last whole "
            "cycles of it",
        )


def choose_bar_cells(exposure_s: float, refresh_s: float, cells: tuple[int, int] = (24, 40)) -> int:
    """How many cells a bar should have for an exposure: its cycle is then far from any whole
    fraction of the exposure, so that opening and closing fall into different cells."""
    counts = np.arange(cells[0], cells[1] + 1)
    rest = exposure_s / refresh_s % counts
    return int(counts[np.argmax(np.minimum(rest, counts - rest))])


def _check_apart(opened: Floats, pulses: _Pulses) -> None:
    """Raise CalibrationError for exposures that opened and closed in the same cells, where an error
    of one time hides that of the other."""
    refresh = float(np.median(pulses.long_s))
    rest = (opened[:, 1] - opened[:, 0]) / refresh % pulses.cells
    if (np.minimum(rest, pulses.cells - rest) < _APART).any():
        raise CalibrationError(
            "the exposure lasted about a whole number of cycles of the bar",
            device="shutter",
            hint="use another number of cells, or another exposure",
        )


def _check_inside(opened: Floats, pulses: _Pulses) -> None:
    """Refuse times at which the bar did not run."""
    end = pulses.start_s + pulses.long_s
    for at, what in ((opened[:, 0], "opened"), (opened[:, 1], "closed")):
        if (at < pulses.start_s.min()).any() or (at > end.max()).any():
            raise CalibrationError(
                f"the shutter {what} while the bar did not run",
                device="shutter",
                hint="let the bar begin earlier and end later, by more than the shutter's lag",
            )
