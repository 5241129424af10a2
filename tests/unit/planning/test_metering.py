"""The aperture from test exposures."""

from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import read_pattern_levels
from pdcd.planning.make import make_plan
from pdcd.planning.metering import (
    SEEN,
    TARGET,
    choose_next_aperture,
    choose_test_pairs,
    compare_stops,
    measure_peak_share,
    pick_aperture,
    predict_peak_share,
)
from pdcd.protocol.request import CaptureRequest
from pdcd.sensor.cells import CellMap
from pdcd.sensor.profile import load_profile
from pdcd.sensor.raw import read_raw
from tests import bench_rig
from tests.taken import take

STOPS = tuple(2.0 ** (k / 6.0) for k in range(49))


@pytest.mark.parametrize("light", [1e-3, 0.1, 1.0, 30.0, 3e3])
def test_settles_just_below_the_target(light: float) -> None:
    """`light`: share of saturation at f/1 in the test; the real exposure has ten times more."""
    f_number, settled, tests = 8.0, False, 0
    while not settled:
        peak = min(light / f_number**2, 1.0)
        f_number, settled = choose_next_aperture(STOPS, f_number, peak, 10.0 * peak)
        tests += 1
    final = 10.0 * light / f_number**2
    assert tests <= 6
    assert final <= TARGET * (1 + 1e-9)
    assert final >= TARGET / 2 ** (1 / 3) * (1 - 1e-9) or f_number == 1.0


def test_a_clipped_photo_is_taken_again_four_stops_narrower() -> None:
    """And is what there is where the lens closes no further."""
    assert choose_next_aperture(STOPS, 4.0, 0.96, 0.1) == (16.0, False)
    assert choose_next_aperture(STOPS, max(STOPS), 1.0, 1.0) == (max(STOPS), True)
    stops = (1.0, 2.0, 4.0, 16.0)
    assert [pick_aperture(stops, f) for f in (0.5, 2.0, 2.1, 99.0)] == [1.0, 2.0, 4.0, 16.0]


def test_peak_share() -> None:
    planes = np.array([[[10.0]], [[40.0]], [[-3.0]], [[20.0]]], dtype=np.float32)
    assert measure_peak_share(planes, np.array([[False]]), 80.0) == 0.5
    assert measure_peak_share(planes, np.array([[True]]), 80.0) == 1.0


def test_expected_share_counts_each_cell_by_its_own_ratio() -> None:
    """Cells of 2 x 2 quads: the brightest of the test was open twice as often as its fair share."""
    planes = np.zeros((4, 4, 6), dtype=np.float32)
    planes[1, 0, 0], planes[2, 3, 5] = 40.0, 30.0
    ratio = np.full((2, 3), 8.0)
    ratio[0, 0] = 4.0
    cells = CellMap.block((2, 3), (4, 6))
    assert predict_peak_share(planes, ratio, 100.0, cells) == pytest.approx(2.4)


@pytest.mark.parametrize(
    ("goal", "fields", "window"),
    [("indirect", {}, "quarter"), ("fraction", {"p": 0.125}, "whole"),
     ("long-range", {"radius": 1}, "quarter")],
)  # fmt: skip
def test_light_from_everywhere_is_metered_exactly(
    goal: str, fields: dict[str, Any], window: str, tmp_path: Path
) -> None:
    """A scene in which every cell lights every other one alike, so that a cell's photo is the sum
    over its open codes of the lit share of all: what the real exposure gathers over the test's."""
    grid = (12, 16)
    request = CaptureRequest(goal=goal, codes=128, window=window, exposure_s=60.0, **fields)  # type: ignore[arg-type]
    plan = make_plan(request, bench_rig.config(tmp_path), grid)
    shot = next(s for s in plan.recipe.shots if s.name == plan.recipe.main or s.name == "coded")
    pairs, ratio = choose_test_pairs(plan.sequence(shot))
    primal, dual = plan.patterns[shot.program]
    lattice = Lattice(grid, plan.window_of(shot))
    quarters = [(0, 0)] if lattice.window == "whole" else [(0, 0), (0, 1), (1, 0), (1, 1)]
    light = np.zeros((2, *grid))
    for k, (down, right) in itertools.product(range(len(primal)), quarters):
        lit = read_pattern_levels(primal, k, lattice.lattice_cells).mean()
        mask = read_pattern_levels(dual, k, lattice.lattice_cells).reshape(lattice.shape)
        seen_now = lit * mask[down : down + grid[0], right : right + grid[1]]
        light[1] += seen_now * plan.passes
        light[0] += seen_now * (k < pairs)
    seen = light[0] > SEEN * light[1] * pairs / len(primal) / plan.passes
    assert pairs == 16 and plan.passes > 1 and seen.mean() > 0.5
    assert np.allclose((light[0] * ratio)[seen], light[1][seen])
    assert np.all((light[0] * ratio)[~seen] <= light[1][~seen] * (1.0 + 1e-9))


@pytest.mark.parametrize(
    ("goal", "codes", "pairs"),
    [("indirect", 512, 16), ("long-range", 512, 64), ("long-range", 8, 8)],
)
def test_codes_of_far_light_are_too_unlike_for_a_few_to_tell(
    goal: str, codes: int, pairs: int, tmp_path: Path
) -> None:
    # Masks of black and white take no time to be chosen.
    far: dict[str, Any] = {"radius": 2, "grey_masks": False} if goal == "long-range" else {}
    request = CaptureRequest(goal=goal, codes=codes, window="whole", **far)  # type: ignore[arg-type]
    plan = make_plan(request, bench_rig.config(tmp_path), (12, 16))
    shot = next(s for s in plan.recipe.shots if s.name == plan.recipe.main or s.name == "coded")
    assert choose_test_pairs(plan.sequence(shot))[0] == pairs


@pytest.mark.long
@pytest.mark.parametrize("name", ["corner_32x24", "disco-ball", "wax-disk"])
def test_the_photo_fills_the_sensor_as_it_is_meant_to(name: str, tmp_path: Path) -> None:
    """Within the third of a stop that the lens steps by, and what 16 codes cannot tell of sharp
    paths; counting all cells alike it would be a stop too dark on the smooth scenes."""
    peaks = []
    for seed in range(3):
        folder = tmp_path / str(seed)
        folder.mkdir()
        made = take(bench_rig.config(folder, scene=bench_rig.scene_of(name)), codes=128, seed=seed)
        run = made.manifest.run
        shot = next(s for s in run.shots if s.name == "coded")
        saturation_dn = run.profile.saturation_dn(shot.iso)
        raw = read_raw(made.folder / shot.raw, saturation_dn=saturation_dn)
        peaks.append(measure_peak_share(raw.planes, raw.saturated, saturation_dn))
    low = 0.8 if name == "disco-ball" else 0.5
    assert max(peaks) < TARGET * 1.1
    assert min(peaks) > TARGET * 2.0**-low


@pytest.mark.parametrize(
    ("dim_dn", "ratio"), [(500.0, 2.0), (8.0, 2.0), (7.0, None), (0.0, None), (-0.5, None)]
)
def test_stops_are_compared_where_light_tells_more_than_what_is_engraved(
    dim_dn: float, ratio: float | None
) -> None:
    """A black level that is cut to whole numbers is off by 0.29 DN, 4 % of 7.2 DN."""
    profile = load_profile("modern")
    one, other = (
        SimpleNamespace(
            planes=np.full((4, 200, 200), dn, np.float32),
            saturated=np.zeros((200, 200), np.bool_),
            masked=False,
        )
        for dn in (2.0 * dim_dn, dim_dn)
    )
    found: Any = compare_stops(one, other, profile, 100, 1.0)  # type: ignore[arg-type]
    if ratio is None:
        assert found is None
    else:
        assert found[0] == pytest.approx(ratio) and found[1] < 0.05
