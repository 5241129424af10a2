"""What is said of a look for mirrors that nobody asked for, and the plans that come with it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
import scipy

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.errors import RequestError
from pdcd.pictures.learn import PilotFindings
from pdcd.planning.defaults import resolve_defaults
from pdcd.planning.guided import decide_after_pilot
from pdcd.planning.make import plan_request, plan_with_prior
from pdcd.planning.plan import Plan
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.record import ShotRecord
from pdcd.watch import Watch
from tests.unit.planning.test_measured import config

GRID = (6, 8)
CELLS = 48
NONE = scipy.sparse.csr_array((CELLS, CELLS))
SOME = scipy.sparse.csr_array(np.eye(CELLS, k=1))


def camera(file_s: float = 0.0) -> CameraInfo:
    return CameraInfo("", "", "modern", np.ones(3), (100,), (), readout_s=file_s)


def plan_of(rig: Config | None = None, **fields: Any) -> Plan:
    request = CaptureRequest(**{"goal": "indirect", "window": "whole", **fields})
    return plan_request(request, rig or Config(), GRID, camera(), 0.0)


def learned(sharpness: float, links: Any = NONE) -> PilotFindings:
    return PilotFindings(links, (links, links, links), None, sharpness, np.zeros((CELLS, 3)))


def record(name: str, open_ns: int, close_ns: int) -> ShotRecord:
    return ShotRecord(
        name=name, window="whole", raw=f"{name}.dng", sha256="0" * 64, size_bytes=1, iso=100,
        f_number=8.0, open_ns=open_ns, close_ns=close_ns, end_ns=(1, 1), refreshes=3, missed=0,
        source="mock", verified=True,
    )  # fmt: skip


def after(
    plan: Plan, found: PilotFindings, shots: list[ShotRecord], *, scouts: bool = False
) -> Any:
    return decide_after_pilot(
        plan, found, shots, scouts=scouts, seed=0, limit_s=60.0, watch=Watch()
    )


@pytest.mark.parametrize(
    ("found", "scouts", "outcome", "words"),
    [
        (learned(0.149), True, "stopped", "no mirrors (sharpness 0.15, limit 0.15): 28 codes"),
        (
            learned(0.3, SOME), False, "guided",
            "sharp paths, which are kept apart (sharpness 0.3, limit 0.15): 16 codes",
        ),
        (
            learned(0.3), False, "no use",
            "sharp light without a map (sharpness 0.3, limit 0.15): 16 codes",
        ),
    ],
)  # fmt: skip
def test_what_a_look_found_and_cost_is_told(
    found: PilotFindings, scouts: bool, outcome: str, words: str
) -> None:
    plan = plan_with_prior(CaptureRequest(goal="indirect", codes=32, pilot=16), Config(), GRID)
    shots = [
        record("white", 0, 10**9),
        record("pilot-0001", 10**9, 3 * 10**9),
        record("pilot-0002", 4 * 10**9, 5 * 10**9 + 5 * 10**8),
        record("coded", 6 * 10**9, 9 * 10**9),
    ]
    asked = after(plan, found, shots, scouts=scouts)
    assert (asked.outcome, asked.told) == (outcome, "")  # who asked for it knows
    gone = after(replace(plan, unasked=True), found, shots, scouts=scouts)
    assert gone.told == f"{words} in 1 exposure; the look took 2 RAW files and 3.5 s"
    assert gone.outcome == outcome and gone.plan.reasons[-1] == f"pilot: {gone.told}"
    parts = plan_with_prior(
        CaptureRequest(goal="indirect", codes=48, pilot=16, parts=4), Config(), GRID
    )
    told = after(replace(parts, unasked=True), found, shots).told
    assert ": 32 codes in 4 exposures; the look took" in told


def test_scouts_that_see_sharp_paths_change_nothing() -> None:
    plan = plan_with_prior(CaptureRequest(goal="indirect", codes=32, pilot=16), Config(), GRID)
    assert after(plan, learned(0.3, SOME), [], scouts=True) is None


def test_a_plain_request_has_two_plans_with_the_same_reasons() -> None:
    plan = plan_of()
    other = plan.otherwise
    assert other is not None and plan.unasked and other.unasked
    assert (plan.how.codes, plan.how.pilot, plan.how.parts) == (128, 16, 7)
    assert (other.how.codes, other.how.pilot, other.how.parts) == (124, 4, 6)
    assert other.otherwise is None and plan.schedule == other.schedule
    for found in (plan, other):
        assert sum(reason.startswith("pilot: ") for reason in found.reasons) == 1
        assert sum(reason.startswith("parts: ") for reason in found.reasons) == 1
    asked = plan_with_prior(
        CaptureRequest(goal="indirect", window="whole", codes=128, pilot=16, parts=7),
        Config(), GRID, 0.0,
    )  # fmt: skip
    alone = plan_with_prior(
        CaptureRequest(goal="indirect", window="whole", codes=124, parts=1), Config(), GRID, 0.0
    )
    assert alone.otherwise is None
    named = [reason for reason in asked.reasons if not reason.startswith("black exposures: ")]
    assert list(plan.reasons[: len(named)]) == named


@pytest.mark.parametrize(
    ("fields", "first", "reason"),
    [
        ({}, (128, 16, 7), "7 exposures of 16 codes each, 0.96 s more in all"),
        ({"parts": 1}, (128, 16, 1), "one exposure; 1 of 124 where"),
        ({"pilot": 0}, (None, 0, 8), "8 exposures of 16 codes each"),
        ({"pilot": 16}, (None, 16, 7), "7 exposures of 16 codes each"),
        ({"codes": 100}, (96, 16, 5), "5 exposures of 16 codes each, 4 of 84 being left out"),
        ({"codes": 80}, (80, 16, 4), "4 exposures of 16 codes each"),
        ({"pilot": "auto", "parts": "auto"}, (128, 16, 7), "6 of 20 where there are no mirrors"),
        ({"pilot": "auto", "codes": 64}, (64, 16, 1), "1 of 60 where"),
        ({"parts": "auto", "pilot": 16}, (None, 16, 7), "7 exposures of 16 codes"),
        ({"pilot": 0, "codes": 64}, (64, 0, 4), "4 exposures of 16 codes"),
        ({"codes": 64}, (64, 16, 1), "the error of the codes is not in the error bars"),
        ({"codes": 63}, (63, 0, 1), "the error of the codes is not in the error bars"),
    ],
)
def test_codes_pilot_and_parts_that_are_left_open(
    fields: dict[str, Any], first: tuple[int | None, int, int], reason: str
) -> None:
    """Each file costs twice 50 ms on black, and the shutter's lag of 60 ms."""
    request = CaptureRequest(**{"goal": "indirect", **fields})
    found = resolve_defaults(request, Config(), GRID, camera())
    asked = found.request
    assert (asked.codes, asked.pilot, asked.parts) == first
    assert reason in " ".join(found.reasons)


def test_the_cost_of_files_goes_by_all_that_each_waits_for() -> None:
    """Four photos of a look may take as long as the codes: 6.4 s."""
    request = CaptureRequest(goal="indirect")

    def pilot(rig: Config, file_s: float) -> Any:
        return resolve_defaults(request, rig, GRID, camera(file_s)).request.pilot

    assert pilot(Config(), 1.43) == 16 and pilot(Config(), 1.45) == 0
    settling = config(rig={"settle_s": 0.15})
    assert pilot(settling, 1.23) == 16 and pilot(settling, 1.25) == 0
    late = config(trigger={"lag_s": 0.26})
    assert pilot(late, 1.23) == 16 and pilot(late, 1.25) == 0
    swift = config(schedule={"guards": "none"})
    third_s = 128 / 60.0 / 4.0
    assert pilot(swift, third_s - 0.17) == 16 and pilot(swift, third_s - 0.15) == 0


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"parts": "auto", "seconds": 5.0}, "beside an error, a time or a method"),
        ({"pilot": "auto", "error": 0.1}, "beside an error, a time or a method"),
        ({"pilot": "auto", "method": "multi-image"}, "beside an error, a time or a method"),
    ],
)
def test_what_goes_with_nothing_else_is_refused(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(RequestError, match=words) as caught:
        resolve_defaults(CaptureRequest(**{"goal": "indirect", **fields}), Config(), GRID, camera())
    assert "leave them out" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"goal": "fraction", "p": 0.5}, "as it helps indirect, direct, far and near light"),
        ({"goal": "diagonal"}, "as it helps indirect, direct, far and near light"),
        ({"prior": "decay:3"}, "as it helps indirect, direct, far and near light"),
        ({"codes": 63}, "as 63 codes are too few"),
        ({"codes": 66}, "as 66 codes are too few"),
        ({"codes": 64, "parts": 4}, "as 64 codes in 4 parts are too few"),
    ],
)
def test_a_pilot_that_cannot_be_had_is_none_and_it_is_said_why(
    fields: dict[str, Any], why: str
) -> None:
    request = CaptureRequest(**{"goal": "indirect", "pilot": "auto", "parts": 1, **fields})
    found = resolve_defaults(request, Config(), GRID, camera())
    assert (found.request.pilot, found.otherwise) == (0, None)
    assert found.request.parts == fields.get("parts", 1)
    assert len(found.reasons) == 1 and found.reasons[0].startswith(f"pilot: none, {why}")


def test_a_map_is_made_of_no_more_cells_than_can_be_matched() -> None:
    request = CaptureRequest(goal="indirect")
    assert resolve_defaults(request, Config(), (64, 64), camera()).request.pilot == 16
    assert resolve_defaults(request, Config(), (64, 65), camera()).request.pilot == 0


@pytest.mark.parametrize(
    ("family", "codes", "used", "parts"),
    [
        ("hadamard", 256, 256, 8), ("hadamard", 127, 120, 6), ("hadamard", 112, 112, 7),
        ("hadamard", 72, 64, 4), ("hadamard", 64, 64, 4), ("hadamard", 60, 60, 1),
        ("balanced", 72, 72, 4), ("balanced", 68, 64, 4), ("balanced", 62, 62, 1),
        ("bernoulli", 144, 144, 8), ("rademacher", 108, 108, 6),
    ],
)  # fmt: skip
def test_parts_have_sixteen_codes_at_least_and_whole_pairs(
    family: Any, codes: int, used: int, parts: int
) -> None:
    """Named or configured; a few codes are left out where all cannot be split."""
    asked = CaptureRequest(goal="indirect", pilot=0)
    named = msgspec.structs.replace(asked, codes=codes, family=family)
    rig = config(schedule={"codes": codes, "family": family})
    for request, bench in ((named, Config()), (asked, rig)):
        found = resolve_defaults(request, bench, GRID, camera())
        assert (found.request.codes or codes, found.request.parts) == (used, parts)
        left_out = f"{codes - used} of {codes} being left out"
        assert (left_out in found.reasons[0]) == (used < codes) and found.otherwise is None


def test_families_of_their_own_structure_are_not_split() -> None:
    request = CaptureRequest(goal="fraction", p=0.2, codes=84, family="singer", parts="auto")
    found = resolve_defaults(request, Config(), GRID, camera())
    assert found.request.parts == 1
    assert "84 singer codes cannot be split into four or more" in found.reasons[0]
