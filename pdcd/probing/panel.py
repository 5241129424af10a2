"""How one panel responds: black leak, first-order rise and fall, skew.

Between two changes of its target a pixel follows ``level + deviation * exp(-t / tau)``, with one
time constant towards white and one towards black. A panel's whole exposure is therefore a list of
spans, each a constant and at most two decaying fields; `Trajectory` yields them in order without
ever holding all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.grey import curve_of
from pdcd.bench.tables import PanelConfig
from pdcd.panels.curve import Curve

_SHORTEST_S = 1e-300
"""Time constants below this one count as it: their rates would be beyond the range of float64."""


@dataclass(frozen=True)
class PanelOptics:
    """Optics of one panel: time constants in s, black over white, delay of the light in ns, and the
    curve from level to light; None: levels are taken as light."""

    rise_s: float = 0.0
    fall_s: float = 0.0
    leak: float = 0.0
    skew_ns: int = 0
    curve: Curve | None = None

    @classmethod
    def from_config(cls, config: PanelConfig) -> PanelOptics:
        """The panel that [projector] or [mask] describes."""
        leak = 0.0 if config.contrast is None else 1.0 / config.contrast
        skew_ns = round(config.skew_s * 1e9)
        return cls(config.rise_s, config.fall_s, leak, skew_ns, curve_of(config))

    def later(self, delay_ns: int) -> PanelOptics:
        """The panel as seen by rows whose light comes `delay_ns` later."""
        return replace(self, skew_ns=self.skew_ns + delay_ns) if delay_ns else self

    @property
    def rates(self) -> Floats:
        """Decay rates in 1/s of the fields of a span: 0 for the constant, then the others."""
        taus = [self.rise_s] if self.rise_s == self.fall_s else [self.rise_s, self.fall_s]
        if self.rise_s == self.fall_s == 0.0:
            taus = []
        # If one of the constants is zero its field is always zero, and any rate will do.
        return np.array([0.0] + [1.0 / max(t, _SHORTEST_S) if t > 0.0 else 1.0 for t in taus])


def vblank_lag_s(projector: PanelConfig, mask: PanelConfig) -> float:
    """By how much the mask's vblank follows the projector's nearest one; negative: it leads."""
    period_s = 1.0 / min(projector.refresh_hz, mask.refresh_hz)
    return (mask.phase_s - projector.phase_s + 0.5 * period_s) % period_s - 0.5 * period_s


def offset_cells(
    projector: PanelConfig, mask: PanelConfig, grid: tuple[int, int]
) -> tuple[float, float]:
    """Misregistration of the mask in cells (rows, cols), from its offset in projector pixels."""
    right_px, down_px = mask.offset_px
    width_px, height_px = projector.field_size_px
    return down_px * grid[0] / height_px, right_px * grid[1] / width_px


def blur_cells(
    projector: PanelConfig, mask: PanelConfig, grid: tuple[int, int]
) -> tuple[float, float]:
    """Blur of the light on the mask in cells (rows, cols), from projector pixels."""
    width_px, height_px = projector.field_size_px
    return mask.blur_px * grid[0] / height_px, mask.blur_px * grid[1] / width_px


class Trajectory:
    """The spans of one panel during an exposure, in order.

    Parameters
    ----------
    panel : Panel
    starts_ns : (S,) int64
        Start of each span, from the opening of the shutter, ascending, first 0; a panel is at
        rest on black before.
    targets : callable
        ``targets(s) -> (P,) float64``: the level 0..1 that span s asks each of the P pixels for.
    """

    def __init__(
        self,
        panel: PanelOptics,
        starts_ns: NDArray[np.int64],
        pixels: int,
        targets: Callable[[int], Floats],
    ) -> None:
        self._panel = panel
        self._fields = int(panel.rates.size)
        self._starts_ns = starts_ns
        self._targets = targets
        self._state = np.full(pixels, panel.leak)
        self._held = np.empty((0, self.fields, pixels))
        self._first = 0

    @property
    def fields(self) -> int:
        """Fields of one span: 1, 2 or 3."""
        return self._fields

    @property
    def spans(self) -> int:
        """Spans of the exposure."""
        return int(self._starts_ns.size)

    @property
    def pixels(self) -> int:
        """Pixels of the panel, P."""
        return int(self._state.size)

    @property
    def reached(self) -> int:
        """The first span that no call has taken yet."""
        return self._first + len(self._held)

    def take(self, start: int, stop: int) -> Floats:
        """Fields of spans start..stop-1, (stop - start, fields, P) float64.

        Each call continues where the last one stopped, or one span before that.
        """
        out = np.empty((stop - start, self.fields, self._state.size))
        kept = self._held[start - self._first :]
        out[: len(kept)] = kept
        for span in range(start + len(kept), stop):
            self._advance(span, out[span - start])
        # The last span may reach into the next call; the copy frees the rest.
        self._held, self._first = out[-1:].copy(), stop - 1
        return out

    def _advance(self, span: int, fields: Floats) -> None:
        """Write the fields of the next span and move the state to its end."""
        panel = self._panel
        asked = self._targets(span)
        level = fields[0]
        np.multiply(asked, 1.0 - panel.leak, out=level)
        level += panel.leak
        if panel.leak:
            level[asked == 1.0] = 1.0  # exactly, in spite of rounding: full light has no leak
        if self.fields == 1:
            return
        rising = level >= self._state
        # A zero time constant jumps: nothing of the deviation is left.
        deviation = np.subtract(self._state, level, out=fields[1])
        if panel.rise_s == 0.0:
            deviation[rising] = 0.0
        if panel.fall_s == 0.0:
            deviation[~rising] = 0.0
        if self.fields == 3:
            np.multiply(deviation, ~rising, out=fields[2])
            deviation *= rising
        if span + 1 < self.spans:
            elapsed_s = (self._starts_ns[span + 1] - self._starts_ns[span]) * 1e-9
            left = np.exp(-panel.rates[1:] * elapsed_s)
            self._state = level + left @ fields[1:]


class RecentSpans:
    """The latest spans of a trajectory, to be taken more than once until they are forgotten."""

    def __init__(self, track: Trajectory) -> None:
        self._track = track
        self._fields = np.empty((0, track.fields, track.pixels))
        self._first = 0

    @property
    def fields(self) -> int:
        """Fields of one span."""
        return self._track.fields

    @property
    def pixels(self) -> int:
        """Pixels of the panel, P."""
        return self._track.pixels

    @property
    def reached(self) -> int:
        """The first span that no call has taken yet."""
        return self._first + len(self._fields)

    def take(self, start: int, stop: int) -> Floats:
        """Fields of spans start..stop-1, (stop - start, fields, P) float64: a view.

        start : not beyond `reached`, and not forgotten.
        """
        if stop > self.reached:
            more = self._track.take(self.reached, stop)
            self._fields = np.concatenate([self._fields, more]) if len(self._fields) else more
        return self._fields[start - self._first : stop - self._first]

    def forget(self, before: int) -> None:
        """Free the spans before this one."""
        gone = min(before, self.reached) - self._first
        if gone > 0:
            self._fields, self._first = self._fields[gone:].copy(), self._first + gone


class StoredSpans:
    """All spans of a trajectory, to be taken in any order and more than once."""

    def __init__(self, track: Trajectory) -> None:
        self._fields = track.take(0, track.spans)

    @property
    def fields(self) -> int:
        """Fields of one span."""
        return int(self._fields.shape[1])

    @property
    def pixels(self) -> int:
        """Pixels of the panel, P."""
        return int(self._fields.shape[2])

    @property
    def reached(self) -> int:
        """Any span may be taken: the end."""
        return len(self._fields)

    def take(self, start: int, stop: int) -> Floats:
        """Fields of spans start..stop-1, (stop - start, fields, P) float64: a view."""
        return self._fields[start:stop]


def compute_decay_integral(rate: Floats, duration_s: Floats) -> Floats:
    """Integral of exp(-rate t) over 0..duration, elementwise; the duration where the rate is 0.

    `expm1` keeps full precision for intervals far shorter than the time constant.
    """
    safe = np.where(rate > 0.0, rate, 1.0)
    return np.where(rate > 0.0, -np.expm1(-safe * duration_s) / safe, duration_s)
