"""What a request and a rig come to in a plan, field by field, and what is refused on the way."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import Config
from pdcd.errors import Cancelled, ConfigError, RequestError
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import read_pattern_levels
from pdcd.planning.bench_fit import resolve_window
from pdcd.planning.make import make_plan
from pdcd.planning.plan import Plan, average_pair_light
from pdcd.planning.schedule_fit import find_quietest_schedule, resolve_slot
from pdcd.protocol.request import CaptureRequest
from pdcd.watch import Watch
from tests.unit.planning.test_measured import config

GRID = (6, 8)
LIGHT = np.linspace(0.1, 1.0, 48).reshape(GRID).tolist()


def request_of(**fields: Any) -> CaptureRequest:
    return msgspec.convert({"goal": "indirect", "codes": 8, "window": "whole", **fields},
                           CaptureRequest)  # fmt: skip


def plan_of(rig: Config | None = None, **fields: Any) -> Plan:
    return make_plan(request_of(**fields), rig or Config(), GRID)


@pytest.mark.parametrize(
    ("fields", "words", "hint"),
    [
        ({"pilot": 32, "codes": 64, "family": "balanced"}, "cannot guide balanced", "hadamard"),
        ({"family": "isolation", "method": "multi-image"}, "does not isolate", "hadamard"),
        ({"family": "confocal", "method": "nayar"}, "does not isolate", "hadamard"),
        ({"goal": "transport", "family": "isolation"}, "its own patterns, not by iso", "family"),
        ({"goal": "transport", "family": "confocal"}, "own patterns, not by conf", "family"),
        ({"family": "isolation", "parts": 2, "codes": 16}, "no codes to split", "parts"),
        ({"repeat": 2, "parts": 2, "codes": 16}, "one piece can be repeated", "repeat"),
        ({"repeat": 2, "method": "multi-image"}, "one piece can be repeated", "repeat"),
        ({"pilot": 10, "codes": 10}, "a pilot of 10 leaves none of 10 codes", "smaller pilot"),
        ({"pilot": 16, "codes": 8}, "a pilot of 16 leaves none of 8 codes", "smaller pilot"),
        ({"goal": "white", "smooth": True}, "no photo of indirect light", "leave out smooth"),
        ({"goal": "indirect", "grey_masks": False}, "no photo of far light", "leave out grey"),
        ({"exposure_s": 0.39}, r"0.39 s is shorter .* 8 codes \(0.4 s\)", "fewer"),
    ],
)  # fmt: skip
def test_what_contradicts_itself_is_refused(fields: dict[str, Any], words: str, hint: str) -> None:
    with pytest.raises(RequestError, match=words) as caught:
        plan_of(**fields)
    assert hint in str(caught.value.hint)


def test_a_family_that_is_named_is_not_replaced() -> None:
    with pytest.raises(RequestError, match="hadamard"):
        plan_of(goal="fraction", p=0.2, codes=100, family="hadamard")
    assert plan_of(goal="fraction", p=0.2, codes=21, family="singer").family == "singer"
    with pytest.raises(RequestError, match="goal fraction"):
        plan_of(codes=21, family="singer")


def test_a_pilot_of_all_codes_has_another_plan_for_a_scene_without_mirrors() -> None:
    plan = plan_of(codes=16, pilot=16)
    other = plan.otherwise
    assert other is not None and other.otherwise is None
    assert (plan.how.coded, other.how.coded, other.how.pilot, other.how.codes) == (0, 12, 4, 16)
    assert plan_of(codes=32, pilot=16).otherwise is None
    timed = config(schedule={"guards": "auto"})
    late = make_plan(request_of(codes=16, pilot=16), timed, GRID, 0.004)
    assert late.otherwise is not None and late.schedule == late.otherwise.schedule == "lag"
    # Its photos show the pilot's own codes, and are what the time of a pass goes by.
    assert plan.passes == 1
    for seconds, passes in ((0.8, 1), (1.6, 2)):
        assert plan_of(codes=16, pilot=16, exposure_s=seconds).passes == passes


def test_why_there_are_that_many_codes_is_said_where_the_light_decides() -> None:
    plan = plan_of(goal="fraction", p=0.25, equal_brightness=True)
    assert plan.how.codes == 16 and plan.reasons[0] == (
        "16 codes: matched cells are lit in 4 of them, as they would be at p = 1/2"
    )
    plain = plan_of(goal="fraction", p=0.25)
    assert plain.how.codes == 8
    assert not any("codes:" in reason for reason in plain.reasons)


def test_buckets_are_those_of_the_camera_for_pairs_alone() -> None:
    two = config(camera={"buckets": 2})
    assert plan_of(two, goal="direct", method="pairs").how.buckets == 2
    assert plan_of(two, goal="direct").how.buckets == 1


def test_what_a_request_leaves_open_is_the_configuration_s() -> None:
    rig = config(
        schedule={"codes": 12, "window": "quarter", "guards": True, "family": "balanced"},
        camera={"iso": 400},
        rig={"settle_s": 0.07},
    )
    plan = make_plan(CaptureRequest(goal="indirect"), rig, GRID)
    assert (plan.how.codes, plan.window, plan.schedule) == (12, "quarter", "full")
    assert (plan.family, plan.iso, plan.settle_s, plan.row_hz) == ("balanced", 400, 0.07, 60.0)
    assert (plan.p, plan.passes, plan.delay_s, plan.smooth) == (0.5, 1, 0.0, False)
    assert plan.how.pilot == 0 and plan.how.white and plan.look is not None
    asked = request_of(guards=False, family="bernoulli", white=False, black_level="mask", seed=3)
    plan = make_plan(asked, rig, GRID)
    assert (plan.how.codes, plan.window, plan.schedule) == (8, "whole", "none")
    assert (plan.family, plan.how.white, plan.how.black_level) == ("bernoulli", False, "mask")
    assert plan.look is None


@pytest.mark.parametrize("rows", [3, -3])
def test_a_mask_that_is_sent_its_frames_later_or_earlier_costs_that_time(rows: int) -> None:
    plan = plan_of(config(display={"mask_delay_refreshes": rows}))
    assert plan.delay_s == pytest.approx(3 / 60.0)
    shot = plan.recipe.shots[0]
    bare_s = plan.refreshes(shot) / 60.0 + 2.0 * plan.settle_s
    assert plan.exposure_s(shot) == pytest.approx(bare_s + 3 / 60.0)


def test_a_share_of_lit_cells_is_the_program_s() -> None:
    assert plan_of(goal="fraction", p=0.25).p == 0.25
    assert plan_of(goal="white").p == 0.5


def test_seeds_make_other_codes_and_the_same_ones_again() -> None:
    primal = [np.asarray(plan_of(seed=seed).patterns["coded"][0]).tobytes() for seed in (1, 2, 1)]
    assert primal[0] == primal[2] != primal[1]


def test_a_white_shot_lasts_as_long_as_gathers_the_light_of_codes() -> None:
    for fields, slots in (({}, 8), ({"exposure_s": 0.8}, 16), ({"parts": 2, "codes": 16}, 8)):
        plan = plan_of(**fields)
        name = next(iter(plan.patterns))
        light = average_pair_light(plan.patterns[name], Lattice(GRID, plan.window).lattice_cells)
        assert plan.white_slots == max(1, round(slots * light))
    assert plan_of(goal="white").white_slots == 8
    assert plan_of(codes=2).white_slots == 1  # never none
    assert plan_of(goal="white", codes=12).white_slots == 12


def test_exposures_hold_whole_passes_within_the_limit() -> None:
    """Eight codes of three refreshes: 0.4 s a pass, and 0.1 s on black."""
    for seconds, passes in ((0.4, 1), (0.79, 1), (0.8, 2), (1.2, 3)):
        assert plan_of(exposure_s=seconds).passes == passes
    assert plan_of(exposure_s=1.6, window="quarter").passes == 1
    assert plan_of(exposure_s=3.2, window="quarter").passes == 2
    longest = max(plan_of().exposure_s(shot) for shot in plan_of().recipe.shots)
    plan_of(config(limits={"max_exposure_s": longest}))
    for limit_s in (longest - 1e-6, 0.39):
        with pytest.raises(
            RequestError, match=r"the plan needs an exposure of .* limit is"
        ) as found:
            plan_of(config(limits={"max_exposure_s": limit_s}))
        assert "limits.max_exposure_s" in str(found.value.hint)


def test_parts_and_single_photos_share_the_codes_among_exposures() -> None:
    """What is too long for one exposure fits in several."""
    limit = config(limits={"max_exposure_s": 0.95})
    with pytest.raises(RequestError, match="needs an exposure"):
        plan_of(limit, codes=32)
    assert plan_of(limit, codes=32, parts=2).how.parts == 2
    assert len(plan_of(limit, codes=32, goal="direct", method="multi-image").recipe.stack) == 32


def test_a_schedule_goes_by_what_is_asked_for_first() -> None:
    quick = {"rise_s": 2e-4, "fall_s": 2e-4}
    timed = config(projector=quick, mask=quick, schedule={"guards": "auto"})
    for lag_s in (0.004, -0.004):
        assert resolve_slot(request_of(), timed, lag_s).schedule == find_quietest_schedule(
            timed, lag_s
        )
    assert resolve_slot(request_of(guards="both"), timed, 0.004).schedule == "both"
    assert resolve_slot(request_of(guards=False), timed, 0.004).schedule == "none"
    named = config(projector=quick, mask=quick, schedule={"guards": "full"})
    assert resolve_slot(request_of(), named, 0.004).schedule == "full"
    untimed = config(schedule={"guards": "auto"})
    assert resolve_slot(request_of(), untimed, 0.004).schedule == "lag"
    assert resolve_slot(request_of(), untimed, -0.004).schedule == "lead"
    assert resolve_slot(request_of(), untimed, None).schedule == "full"


def test_cells_are_at_least_a_pixel_of_the_projector() -> None:
    request = request_of()
    for grid in ((768, 4), (4, 1024)):
        assert resolve_window(request, Config(), grid) == "whole"
    for grid in ((769, 4), (4, 1025)):
        with pytest.raises(ConfigError, match="finer than the projector's pixels") as caught:
            resolve_window(request, Config(), grid)
        assert caught.value.device == "projector" and caught.value.hint
    rough = config(schedule={"window": "quarter"})
    assert resolve_window(CaptureRequest(goal="white"), rough, GRID) == "quarter"
    assert resolve_window(request, rough, GRID) == "whole"


def test_bit_planes_show_black_and_white_alone() -> None:
    planes = config(display={"planes_per_refresh": 24})
    plan_of(planes)
    with pytest.raises((RequestError, ConfigError)):
        plan_of(planes, goal="illuminated", illumination=LIGHT)
    assert plan_of(goal="illuminated", illumination=LIGHT).patterns


@pytest.mark.parametrize(
    ("tables", "asked", "grey", "told"),
    [
        ({}, None, True, "more evenly"),
        ({"mask": {"gamma": 2.2}, "bench": {"truth": "x.toml"}}, None, False, "nobody measured"),
        (
            {
                "mask": {"gamma": 2.2},
                "bench": {"truth": "x.toml"},
                "calibration": {"typed": {"mask.gamma": "1.8"}},
            },
            None,
            True,
            "more evenly",
        ),
        ({"mask": {"lut": (0.0, 0.2, 1.0)}, "bench": {"truth": "x.toml"}}, None, True, "more even"),
        ({"projector": {"gamma": 2.2}, "bench": {"truth": "x.toml"}}, None, False, "nobody"),
        ({"display": {"planes_per_refresh": 24}}, None, False, "bit planes"),
        ({}, False, False, ""),
        ({"bench": {"truth": "x.toml"}}, True, True, ""),
    ],
)
def test_masks_of_far_light_are_grey_where_their_light_was_measured(
    tables: dict[str, Any], asked: bool | None, grey: bool, told: str
) -> None:
    rig, grid = config(**tables), (12, 16)
    for goal in ("long-range", "short-range"):
        request = request_of(goal=goal, radius=2, codes=32, grey_masks=asked)
        plan = make_plan(request, rig, grid)
        assert plan.how.grey_masks is grey
        assert plan.patterns["far"][0].dtype == np.uint8
        assert (plan.patterns["far"][1].dtype == np.float32) is grey
        lines = [line for line in plan.reasons if line.startswith("masks of far light")]
        assert [told in line for line in lines] == [True] * bool(told)
    unconcerned = make_plan(request_of(goal="indirect"), rig, grid)
    assert not unconcerned.how.grey_masks
    assert not any(line.startswith("masks of far") for line in unconcerned.reasons)


@pytest.mark.parametrize(
    ("goal", "radius", "shot", "seen"),
    [
        ("long-range", 2, "far", "whole"),
        ("short-range", 1, "far", "whole"),
        ("short-range", 1, "coded", "quarter"),
        # Beyond a radius of 0 there is direct light to be kept apart.
        ("long-range", 0, "far", "quarter"),
    ],
)
def test_light_from_beyond_a_radius_is_seen_through_whole_cells(
    goal: str, radius: int, shot: str, seen: str
) -> None:
    asked: dict[str, Any] = {"goal": goal, "radius": radius, "codes": 32, "exposure_s": 60.0}
    plan = plan_of(window="quarter", **asked)
    found = next(one for one in plan.recipe.shots if one.name == shot)
    assert plan.window == "quarter" and plan.window_of(found) == seen
    lattice = Lattice(GRID, seen)
    first = read_pattern_levels(plan.patterns[found.program][1], 0, lattice.lattice_cells)
    assert first.size == lattice.lattice_cells
    told = any("whole cells, as no light" in line for line in plan.reasons)
    assert told is (radius > 0)
    assert not any("whole cells, as" in line for line in plan_of(**asked).reasons)
    # Which takes a quarter of the time: four times as many passes in what was asked for.
    if goal == "long-range":
        assert plan.passes == pytest.approx(
            plan_of(**asked).passes / (4 if radius == 0 else 1), 0.3
        )


def test_whoever_waits_hears_of_every_program_and_may_end_the_work() -> None:
    heard: list[tuple[float, float]] = []
    watch = Watch(step=lambda done, total: heard.append((done, total)))
    make_plan(request_of(codes=16, parts=2), Config(), GRID, watch=watch)
    assert heard == [(1.0, 2.0), (2.0, 2.0)]

    def ended() -> None:
        raise Cancelled("nobody waits")

    with pytest.raises(Cancelled):
        make_plan(request_of(), Config(), GRID, watch=Watch(ended))


@pytest.mark.parametrize(
    ("fields", "smooth"),
    [
        ({}, True),
        ({"family": "balanced"}, False),
        ({"family": "bernoulli", "smooth": True}, True),
        ({"smooth": False}, False),
        ({"goal": "long-range", "radius": 1}, True),
        ({"goal": "long-range", "radius": 1, "family": "balanced"}, False),
        ({"goal": "short-range", "radius": 1}, True),
        ({"goal": "short-range", "radius": 1, "family": "balanced"}, False),
        ({"goal": "diagonal"}, False),
        ({"goal": "fraction", "p": 0.5}, False),
        ({"goal": "white"}, False),
    ],
)
def test_smooth_light_is_corrected_where_it_can_be(fields: dict[str, Any], smooth: bool) -> None:
    assert plan_of(**fields).smooth is smooth
