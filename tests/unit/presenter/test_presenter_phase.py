"""Phase and slip of two outputs from their vblank counts, against counts made by a formula."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pdcd.presenter import phase
from pdcd.presenter.messages import Rect
from pdcd.presenter.phase import compare_vblanks, is_from_timer


def stamps(period_s: float, first_s: float, *, count: int = 20, noise_s: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(3)
    msc = 4711 + 3 * np.arange(count)
    seconds = 1000.0 + first_s + 3 * np.arange(count) * period_s
    seconds += noise_s * rng.standard_normal(count)
    return np.stack([np.rint(seconds * 1e9).astype(np.int64), msc], axis=1)


@pytest.mark.parametrize("lag_s", [-0.008, -0.003, 0.0, 0.0001, 0.005, 0.0083])
def test_lag_is_that_of_the_nearest_vblank(lag_s: float) -> None:
    # The mask is asked a second later, 60 whole refreshes on.
    found = compare_vblanks(stamps(1 / 60, 0.0), stamps(1 / 60, 1.0 + lag_s, noise_s=2e-5))
    assert found is not None
    assert found.lag_s == pytest.approx(lag_s, abs=5e-5)
    assert found.period_s == pytest.approx((1 / 60, 1 / 60), rel=1e-4)


def test_a_timer_of_whole_milliseconds_is_no_screen() -> None:
    timer = stamps(1 / 60, 0.0)
    odd = np.arange(20) % 2  # neighbours, so that no beat with the millisecond hides it
    timer -= np.stack([16_666_667 * odd, odd], axis=1)
    timer[:, 0] = -(-timer[:, 0] // 1_000_000) * 1_000_000
    assert is_from_timer(timer)
    assert not is_from_timer(stamps(1 / 60, 0.0, noise_s=2e-5))
    assert compare_vblanks(stamps(1 / 60, 0.0), timer) is None


PERIOD_NS = 16_000_000


class Vblanks:
    """Counts vblanks of one output."""

    def __init__(self, lag_ns: int = 0, scatter_ns: int = 0, last: int = 10**9) -> None:
        self.ns = self.msc = 0
        self.asked = self.waits = 0
        self.lag_ns, self.scatter_ns, self.last = lag_ns, scatter_ns, last

    def ask(self, msc: int) -> None:
        self.asked += 1
        self.msc = msc or 500

    def wait(self, kind: int, timeout_s: float) -> bool:
        self.waits += 1
        odd = self.waits % 2
        self.ns = 10**12 + self.msc * PERIOD_NS + self.lag_ns + odd * self.scatter_ns
        if self.asked == 1:
            self.ns += 7_000_000  # answered at once, between two vblanks
        return self.waits <= self.last

    def close(self) -> None: ...


def measured(monkeypatch: pytest.MonkeyPatch, *sources: Vblanks) -> phase.VblankPhase | None:
    """The phase of two outputs, by windows of which nothing else is looked at."""
    waiting = list(sources)
    root = SimpleNamespace(create_window=lambda *place, **how: SimpleNamespace(id=1))
    screen = SimpleNamespace(root=root, root_depth=24)
    display = SimpleNamespace(screen=lambda: screen, sync=lambda: None)
    monkeypatch.setattr(phase, "open_x_connection", lambda name: display)
    monkeypatch.setattr(phase, "close_x_connection", lambda display: None)
    monkeypatch.setattr(phase, "PresentEvents", lambda name, number: waiting.pop(0))
    place = Rect(0, 0, 4, 3)
    return phase.measure_vblank_phase(":7", (place, place))


def test_the_phase_is_that_of_the_windows_vblanks(monkeypatch: pytest.MonkeyPatch) -> None:
    projector, mask = Vblanks(), Vblanks(3_000_000)
    found = measured(monkeypatch, projector, mask)
    assert found is not None
    assert found.lag_s == pytest.approx(0.003)
    assert found.period_s == pytest.approx((0.016, 0.016))


def test_a_timer_is_told_after_eight_samples_and_silence_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    timer, mask = Vblanks(scatter_ns=400_000), Vblanks()
    assert measured(monkeypatch, timer, mask) is None
    assert timer.asked == 9
    silent = Vblanks(last=3)
    assert measured(monkeypatch, Vblanks(), silent) is None
    assert silent.waits == 4
