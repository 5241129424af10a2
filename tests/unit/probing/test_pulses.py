"""Pulses in closed form against the realised matrix, and what schedules let through."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.timing.programmes import SETS, WHITES, Programme, expand_programmes
from pdcd.calibration.timing.strips import StripReadings
from pdcd.calibration.timing.timing_model import PanelTimes, PhotoLog, StripModel
from pdcd.panels.frames import Frames
from pdcd.panels.schedule import SLOTS
from pdcd.probing.panel import PanelOptics
from pdcd.probing.pulses import PanelResponse, compute_code_separation, compute_pulse_product
from pdcd.probing.realised import collect_factors, compute_factors
from pdcd.words import ScheduleName
from tests.frame_logs import make_log

T = 1.0 / 60.0


def ran(count: int) -> PhotoLog:
    # Whole nanoseconds a refresh, so that the log's rounding is no part of the comparison.
    log = make_log(count, start_ns=100_000_000, refresh_ns=round(T * 1e9))
    return PhotoLog(log, 0, int(log.end_ns[0]) + 500_000_000)


def through_s(
    programmes: tuple[Programme, ...], ran: PhotoLog, times: PanelTimes, lag_s: float
) -> NDArray[np.float64]:
    """Seconds for which light got through the strips, (K,), by the realised matrix: a cell each."""
    count, rows = len(programmes), int(ran.log.primal_shown.max(initial=-1)) + 1
    patterns = [np.packbits(side.T, axis=1) for side in expand_programmes(programmes)]
    index = (np.arange(rows) % programmes[0].of).astype(np.int32)
    frames = Frames(
        patterns[0], patterns[1], index, index, np.zeros(rows, np.uint8), index,
        np.zeros(rows, np.bool_), (1, count), (1, count), "whole",
    )  # fmt: skip
    projector, mask = times.answers
    found = compute_factors(
        frames,
        ran.log,
        PanelOptics(float(projector.rise_s), float(projector.fall_s), 0.0),
        PanelOptics(float(mask.rise_s), float(mask.fall_s), 0.0, round(lag_s * 1e9)),
        open_ns=ran.open_ns,
        close_ns=ran.close_ns,
    )
    return np.asarray(collect_factors(found).coaxial)


def reading_of(programmes: tuple[Programme, ...]) -> StripReadings:
    none = np.zeros((1, len(programmes)))
    return StripReadings(none, none, np.array([0.5]), 1.0, programmes)


def test_beginning_and_end_of_an_exposure_are_as_the_realised_matrix_has_them() -> None:
    times = PanelTimes(np.array([0.002, 0.003, 0.004, 0.008]), np.zeros(2), np.array([0.0052]))
    programmes = (*SETS[0], WHITES)
    model = StripModel([reading_of(programmes)], [ran(60)], round(T * 1e9) * 1e-9)
    without_end = model.shape(times)[0, 0]
    model.correct(times)
    light = through_s(programmes, ran(60), times, 0.0052)
    np.testing.assert_allclose(model.shape(times)[0, 0], light / light[-1], rtol=0, atol=1e-5)
    assert np.abs(without_end - light / light[-1]).max() > 1e-3


@pytest.mark.parametrize("lag_s", [0.004, -0.011])
@pytest.mark.parametrize(
    "taus_s",
    [(0.002, 0.003, 0.004, 0.008), (0.001, 0.001, 0.003, 0.003), (0.006, 0.0005, 0.012, 0.002)],
)
def test_the_closed_form_is_the_realised_matrix(lag_s: float, taus_s: tuple[float, ...]) -> None:
    """Two exposures, one ten periods longer: the difference has no beginning and no end."""
    times = PanelTimes(np.array(taus_s), np.zeros(2), np.array([lag_s]))
    programmes = (*SETS[0], *SETS[1])
    short, long = (through_s(programmes, ran(count), times, lag_s) for count in (60, 120))
    refresh = round(T * 1e9) * 1e-9
    want = (
        compute_pulse_product(*times.answers, *expand_programmes(programmes), lag_s, refresh)
        * 60
        * refresh
    )
    np.testing.assert_allclose(long - short, want, rtol=0, atol=1e-8)
    assert want.max() > 0.9  # seconds


@pytest.mark.parametrize("name", list(SLOTS))
@pytest.mark.parametrize("late", [-1.3, -0.8, -0.3, 0.0, 0.4, 0.9])
def test_panels_that_switch_at_once_leak_as_their_slots_overlap(
    name: ScheduleName, late: float
) -> None:
    """Against overlaps of intervals, in refreshes."""
    lit, opened = (np.flatnonzero(side) for side in SLOTS[name])
    slot = len(SLOTS[name][0])

    def overlap(codes_later: int) -> float:
        first = opened[0] + codes_later * slot + late
        both = min(lit[-1] + 1.0, first + opened.size) - max(lit[0], first)
        return max(0.0, float(both))

    kept = compute_code_separation(
        name, PanelResponse(0.0, 0.0), PanelResponse(0.0, 0.0), late * T, T
    )
    own = overlap(0)
    if own == 0.0:
        assert kept.light < 1e-4
        return
    assert kept.light == pytest.approx(own, abs=1e-4)
    assert kept.leak == pytest.approx(sum(overlap(k) for k in range(-4, 5) if k) / own, abs=1e-4)
