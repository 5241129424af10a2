"""What the schedules of one to three refreshes a code keep apart of what they promise."""

from __future__ import annotations

import pytest

from pdcd.codes.make import make_codes
from pdcd.panels.frames import Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import SLOTS, build_frames
from pdcd.planning.schedule_fit import list_tolerant_schedules
from pdcd.probing.panel import PanelOptics
from pdcd.probing.realised import Factors, collect_factors, compute_factors
from pdcd.words import ScheduleName
from tests import bench_rig
from tests.frame_logs import make_log

T_NS = 16_000_000
GRID = (2, 3)

PROMISED = {
    "none": (0.0, 0.0),
    "both": (-1.0, 1.0),
    "lag": (0.0, 1.0),
    "lead": (-1.0, 0.0),
    "tail": (-1.0, 2.0),
    "full": (-1.0, 1.0),
    "wide": (-1.0, 2.0),
}
SKEWS = (-1.0, -0.6, -0.25, 0.0, 0.25, 0.6, 1.0, 1.4, 2.0)


def frames_of(schedule: ScheduleName, window: str = "whole") -> Frames:
    codes = make_codes("bernoulli", Lattice(GRID, window).shape, 6, dual="complement", seed=2)
    return build_frames(bench_rig.pairs(codes), GRID, window=window, schedule=schedule, passes=1)


def realised(frames: Frames, skew: float) -> Factors:
    """By panels that switch at once, the mask that many refreshes late."""
    log = make_log(len(frames), start_ns=40_000_000, refresh_ns=T_NS)
    late = PanelOptics(skew_ns=round(skew * T_NS))
    close_ns = int(log.end_ns[0]) + 60_000_000
    return collect_factors(
        compute_factors(frames, log, PanelOptics(), late, open_ns=0, close_ns=close_ns)
    )


@pytest.mark.parametrize("skew", SKEWS)
@pytest.mark.parametrize("schedule", SLOTS)
def test_direct_light_is_exactly_zero_where_promised_and_only_there(
    schedule: ScheduleName, skew: float
) -> None:
    low, high = PROMISED[schedule]
    window = "quarter" if skew in (-1.0, 1.4) else "whole"
    got = realised(frames_of(schedule, window), skew)
    if low <= skew <= high:
        assert got.coaxial.max() == 0.0
    else:
        assert got.coaxial.max() > 0.0


@pytest.mark.parametrize("lag", [-1.0, 0.0, 0.6, 1.0, 1.7])
def test_what_is_called_tolerant_keeps_all_direct_light_out(lag: float) -> None:
    """Beyond one refresh nothing does: a mask that late wants `mask_delay_refreshes`."""
    assert list_tolerant_schedules(None) == ("full",)
    for schedule in list_tolerant_schedules(lag):
        got = realised(frames_of(schedule), lag)
        if abs(lag) <= 1.0:
            assert got.coaxial.max() == 0.0 and got.total_s > 0.0
