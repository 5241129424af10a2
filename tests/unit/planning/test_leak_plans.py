"""Plans after a look at a dark photo: what is added, for which shots, and when nothing can be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from pdcd.bench.tables import Config
from pdcd.errors import RequestError
from pdcd.planning.look import DarkFrames, with_black_exposures
from pdcd.planning.make import make_plan
from pdcd.planning.memory import MemoryLimitError
from pdcd.planning.plan import LeakProbe, Plan
from pdcd.protocol.plan_summary import LeakErrors
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.record import ShotRecord
from tests.unit.planning.test_measured import config

GRID = (3, 4)


def plan_of(rig: Config | None = None, **fields: Any) -> Plan:
    request = CaptureRequest(**{"goal": "indirect", "codes": 8, "window": "whole", **fields})
    return make_plan(request, rig or Config(), GRID)


def leaks(ambient: float = 0.0, mask: float = 0.0) -> LeakErrors:
    both = ambient + mask
    return LeakErrors(ambient=ambient, mask=mask, both=both, floor=1e-4, limit=0.01, raw=())


def record(name: str, refreshes: int, level: float | None = 1.0) -> ShotRecord:
    return ShotRecord(
        name=name, window="whole", raw=f"{name}.dng", sha256="0" * 64, size_bytes=1, iso=100,
        f_number=8.0, open_ns=0, close_ns=1, end_ns=(1, 1), refreshes=refreshes, missed=0,
        source="mock", verified=True, level=level,
    )  # fmt: skip


def taken_of(plan: Plan, later: int = 0) -> list[ShotRecord]:
    return [record(shot.name, plan.refreshes(shot) + later) for shot in plan.recipe.shots]


@pytest.mark.parametrize(
    ("found", "level", "names"),
    [
        (leaks(ambient=0.02), "ambient", {"white-black-primal", "coded-black-primal"}),
        (leaks(mask=0.02), "mask", {"white-black-dual", "coded-black-dual"}),
    ],
)
def test_the_black_exposures_that_leaks_call_for_join_the_shots(
    found: LeakErrors, level: str, names: set[str]
) -> None:
    plan = plan_of()
    after = with_black_exposures(plan, found, Config(), taken_of(plan))
    before = {shot.name for shot in plan.recipe.shots}
    assert {shot.name for shot in after.recipe.shots} - before == names
    assert after.how.black_level == level and plan.how.black_level == "none"
    assert after.look is None and after.leaks == found
    assert after.patterns is plan.patterns and after.passes == plan.passes
    said = [reason for reason in after.reasons if reason.startswith("black exposures: ")]
    assert len(said) == 1 and said[0].startswith(
        f"black exposures: {level}, decided after a look at dark photos: "
    )
    black = next(shot for shot in after.recipe.shots if shot.name in names and "coded" in shot.name)
    coded = next(shot for shot in plan.recipe.shots if shot.name == "coded")
    assert after.refreshes(black) == plan.refreshes(coded)


def test_where_time_or_memory_leaves_no_room_nothing_is_added() -> None:
    plan = plan_of()
    full = replace(plan, look=LeakProbe(0.01, may_add=False))
    with pytest.raises(RequestError, match="leaves no room"):
        with_black_exposures(full, leaks(0.02), Config(), ())
    assert (
        with_black_exposures(replace(plan, look=None), leaks(0.02), Config(), ()).leaks is not None
    )
    tight = config(limits={"work_bytes": 1})
    with pytest.raises(MemoryLimitError, match="3 x 4 cells"):
        with_black_exposures(plan, leaks(0.02), tight, ())


@pytest.mark.parametrize("delay", [0, 2, -2])
def test_white_shots_stay_as_long_as_they_were(delay: int) -> None:
    """After a pilot that ended early, they were planned for fewer codes."""
    rig = config(display={"mask_delay_refreshes": delay})
    plan = plan_of(rig)
    rows = 3 * (plan.white_slots + 5)
    records = [record("white", rows + abs(delay)), record("other", 99, level=0.5)]
    after = with_black_exposures(plan, leaks(0.02), rig, records)
    assert after.white_slots == plan.white_slots + 5
    records[0] = record("white", rows + abs(delay) + 1)
    with pytest.raises(RequestError, match="more often than planned"):
        with_black_exposures(plan, leaks(0.02), rig, records)


@pytest.mark.parametrize("delay", [0, 2, -2])
@pytest.mark.parametrize(("more", "level"), [(1, 1.0), (-1, 1.0), (0, 0.5), (0, None), (3, None)])
def test_codes_that_were_shown_otherwise_than_planned_have_no_black_exposure(
    more: int, level: float | None, delay: int
) -> None:
    rig = config(display={"mask_delay_refreshes": delay})
    plan = plan_of(rig, white=False)
    coded = plan.recipe.shots[0]
    rows = plan.refreshes(coded) + abs(delay)
    assert (
        with_black_exposures(plan, leaks(0.02), rig, [record(coded.name, rows)]).leaks is not None
    )
    with pytest.raises(RequestError, match="unequally often"):
        with_black_exposures(plan, leaks(0.02), rig, [record(coded.name, rows + more, level)])


def test_a_dark_photo_pauses_for_as_long_as_panels_settle() -> None:
    """At least two refreshes, and whole ones."""
    for settle_s, pause in ((0.0, 2), (0.02, 2), (0.034, 3), (0.05, 3), (0.051, 4)):
        plan = plan_of(config(rig={"settle_s": settle_s}), codes=128)
        dark = DarkFrames.of(plan)
        assert dark.pause == len(dark.frames(lit=True)) - 2 * dark.rows == pause
    frames = dark.frames(lit=True)
    assert not frames.shift.any() and not frames.code.any()
    assert frames.shift.size == frames.code.size == len(frames)
    assert (frames.grid, frames.lattice, frames.window) == (GRID, GRID, "whole")
    assert len(frames.primal_patterns) == len(frames.dual_patterns) == 0
