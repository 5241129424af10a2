"""Phase and slip of two outputs from their vblank counts, against counts made by a formula."""

from __future__ import annotations

import numpy as np
import pytest

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
