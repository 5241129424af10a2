"""Slow panels: time constants that are equal, nearly equal or vanishing, and very short intervals.

The reference follows every pair of cells through the exposure in decimal numbers of 80 digits, by
antiderivatives that cancel badly in double precision and do not with so many digits.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np

from pdcd.codes.make import make_codes
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.schedule import build_frames
from pdcd.probing.panel import PanelOptics, compute_decay_integral
from tests import bench_rig
from tests.frame_logs import REFRESH_NS
from tests.hard_cases.case import Case, Outcome, worst
from tests.hard_cases.exposures import log_of, realised, spans

GRID = (2, 3)
DIGITS = 80
NS = Decimal(1).scaleb(-9)


@dataclass
class _Level:
    """One cell of a panel: where it is, and how it moves."""

    panel: PanelOptics
    now: Decimal

    def towards(self, on: bool) -> tuple[Decimal, Decimal, Decimal]:
        """Target, deviation from it, and time constant in s (0: at once)."""
        goal = Decimal(1) if on else Decimal(self.panel.leak)
        tau = Decimal(self.panel.rise_s if goal >= self.now else self.panel.fall_s)
        return goal, (self.now - goal if tau else Decimal(0)), tau

    def move(self, on: bool, duration: Decimal) -> None:
        """Follow the target for a while."""
        goal, deviation, tau = self.towards(on)
        self.now = goal + (deviation * (-duration / tau).exp() if tau else 0)


def _integral(tau: Decimal, duration: Decimal) -> Decimal:
    return tau * (1 - (-duration / tau).exp())


def _stretch(mask: _Level, m: bool, light: _Level, i: bool, duration: Decimal) -> Decimal:
    """Integral of mask times light over a stretch of constant targets."""
    (g, a, s), (h, b, t) = mask.towards(m), light.towards(i)
    total = g * h * duration
    if a:
        total += a * h * _integral(s, duration)
    if b:
        total += g * b * _integral(t, duration)
    if a and b:
        total += a * b * _integral(s * t / (s + t), duration)
    return total


def decimal_matrix(
    frames: Frames, log: FrameLog, primal: PanelOptics, dual: PanelOptics
) -> list[Fraction]:
    """Realised matrix in s, row by row, from 80 digits."""
    assert primal.skew_ns == dual.skew_ns == 0
    span_ns, m, i = spans(frames, log)
    cells = range(frames.grid[0] * frames.grid[1])
    out = []
    with localcontext() as context:
        context.prec = DIGITS
        for n, o in itertools.product(cells, cells):
            mask, light = (_Level(p, Decimal(p.leak)) for p in (dual, primal))
            total = Decimal(0)
            for length, seen, lit in zip(span_ns.tolist(), m[:, n], i[:, o], strict=True):
                duration = length * NS
                total += _stretch(mask, bool(seen), light, bool(lit), duration)
                mask.move(bool(seen), duration)
                light.move(bool(lit), duration)
            out.append(Fraction(total))
    return out


def error(
    primal: PanelOptics, dual: PanelOptics, *, refresh_ns: int = REFRESH_NS, phase_ns: int = 0
) -> float:
    """Largest error of the realised matrix, over its largest entry."""
    codes = make_codes("bernoulli", GRID, 4, dual="complement", seed=1)
    frames = build_frames(bench_rig.pairs(codes), GRID, window="whole", schedule="none", passes=1)
    log = log_of(frames, refresh_ns=refresh_ns, phase_ns=phase_ns)
    want = decimal_matrix(frames, log, primal, dual)
    return worst(realised(frames, log, primal, dual).dense(), want, max(want))


def panels(primal: PanelOptics, dual: PanelOptics) -> Callable[[], Outcome]:
    """The case of two panels at 60 Hz, the mask 1.2 ms behind."""
    return lambda: Outcome(error(primal, dual, phase_ns=1_234_567))


def billionth() -> Outcome:
    """Mask and projector change 1e-9 of a refresh apart, refreshes of one second."""
    slow = PanelOptics(0.3, 0.1, 1 / 300), PanelOptics(0.2, 0.2, 1 / 50)
    return Outcome(error(*slow, refresh_ns=10**9, phase_ns=1))


def billionth_alone() -> Outcome:
    """A decay over 1e-9 of a refresh at 60 Hz, far shorter than a nanosecond."""
    rates, short_s = [0.5, 100.0, 1e4], 1e-9 / 60.0
    with localcontext() as context:
        context.prec = DIGITS
        want = [Fraction(_integral(1 / Decimal(r), Decimal(short_s))) for r in rates]
    got = compute_decay_integral(np.array(rates), np.array(short_s))
    plain = (1.0 - np.exp(-np.array(rates) * short_s)) / np.array(rates)
    scale = min(want)
    return Outcome(worst(got, want, scale), worst(plain, want, scale))


def late_nanosecond() -> Outcome:
    """Mask and projector meet for one nanosecond, an hour after the shutter opened.

    The first refresh of the mask begins a nanosecond before the only lit one of the projector
    ends; all that the photo holds is that nanosecond.
    """
    one = np.array([[0b10000000]], dtype=np.uint8)
    frames = build_frames((one, one), (1, 1), window="whole", schedule="none", passes=1)
    hour_ns = 3_600_000_000_000
    log = log_of(frames, start_ns=hour_ns, phase_ns=REFRESH_NS - 1)
    got = float(realised(frames, log, PanelOptics(), PanelOptics()).coaxial[0])
    start_s, end_s = (hour_ns + REFRESH_NS - 1) * 1e-9, (hour_ns + REFRESH_NS) * 1e-9
    return Outcome(abs(got * 1e9 - 1.0), abs((end_s - start_s) * 1e9 - 1.0))


_DECIMALS = "antiderivatives in 80 digits"
_LARGEST = "of the largest entry"


def _case(name: str, primal: PanelOptics, dual: PanelOptics) -> Case:
    return Case(name, _LARGEST, _DECIMALS, 1e-14, panels(primal, dual))


CASES = (
    _case("equal time constants", PanelOptics(0.004, 0.004), PanelOptics(0.004, 0.004)),
    _case(
        "time constants 1e-12 apart",
        PanelOptics(0.004, 0.004 * (1 + 1e-12), 1 / 500),
        PanelOptics(0.004 * (1 - 1e-12), 0.004, 1 / 300),
    ),
    _case(
        "rise of 1e-12 s", PanelOptics(1e-12, 0.003, 1 / 500), PanelOptics(0.012, 1e-12, 1 / 300)
    ),
    _case("no rise but a fall", PanelOptics(0.0, 0.003), PanelOptics(0.012, 0.0, 1 / 50)),
    _case("time constants of 5e-324 s", PanelOptics(5e-324, 5e-324), PanelOptics(5e-324, 0.005)),
    _case(
        "rise and fall of a million seconds",
        PanelOptics(1e6, 1e6, 0.5),
        PanelOptics(1e6, 0.004, 0.5),
    ),
    Case(
        "panels 1e-9 of a refresh apart",
        _LARGEST,
        _DECIMALS,
        1e-14,
        billionth,
    ),
    Case(
        "decay over 1e-9 of a refresh",
        "relative",
        "80 digits",
        1e-15,
        billionth_alone,
        "1 - exp(-x)",
    ),
    Case(
        "one nanosecond of light after an hour",
        "relative",
        "one nanosecond",
        1e-12,
        late_nanosecond,
        "difference of times in s",
    ),
)
