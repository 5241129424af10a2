"""A check finds what has changed on a bench, and cries no wolf."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.placed import panels_of
from pdcd.bench.truth import load_bench_truth
from pdcd.calibration.check.check_step import NO_LAG, REFERENCE_KEPT
from pdcd.calibration.figures import Verdict
from pdcd.calibration.script import StepOutcome
from pdcd.capture.worker.calibrating import read_arrays, write_arrays
from pdcd.panels.map import map_between
from tests.e2e.calibration.check_rig import (
    CHANGES,
    SKEW_S,
    Change,
    Truth,
    calibrated,
    later,
    verdicts,
)
from tests.e2e.calibration.hands import Hands
from tests.sampled import sampled
from tests.unit.calibration.scripted import preview_of

pytestmark = pytest.mark.whole

GOOD, REFIT, BAD = Verdict.GOOD, Verdict.DOUBTFUL, Verdict.BAD
THEN = Truth()


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Hands:
    return calibrated(THEN, tmp_path_factory.mktemp("reference"))


@pytest.mark.parametrize("change", sampled([Change("nothing", {"seed": 11}), *CHANGES], 3))
def test_what_changed_is_found_and_nothing_else(
    reference: Hands, tmp_path: Path, change: Change
) -> None:
    outcome = later(reference, tmp_path, change.of(THEN)).run_check()
    assert verdicts(outcome) == change.found
    assert change.said in " ".join(outcome.advice)
    assert preview_of(outcome)[:4] == b"\x89PNG"
    if BAD in change.found.values():
        assert not outcome.maps
        assert not outcome.words


@pytest.mark.long
def test_a_small_change_is_taken_into_account_once(reference: Hands, tmp_path: Path) -> None:
    turned = later(reference, tmp_path, replace(THEN, turn_deg=0.8, skew_s=SKEW_S + 3e-4))
    outcome = turned.run_check()
    assert verdicts(outcome) == {"mask.place": REFIT, "mask.skew_s": REFIT}
    assert all("taken into account" in text for text in outcome.advice)
    config = turned.session.config
    assert outcome.words["mask.skew_s"].value == pytest.approx(
        reference.session.config.mask.skew_s + 3e-4, abs=3e-5
    )
    true = panels_of(load_bench_truth(turned.config).of(turned.config))
    points = np.random.default_rng(1).uniform(0.1, 0.9, (100, 2)) * config.mask.size_px
    wanted = map_between(true.mask.map, true.projector.map, points)
    got = map_between(turned.session.found("mask"), turned.session.found("projector"), points)
    assert np.quantile(np.hypot(*(got - wanted).T), 0.95) < 0.05
    assert verdicts(turned.run_check()) == {}


def test_without_a_timing_the_lag_is_left_out_and_said(reference: Hands, tmp_path: Path) -> None:
    one = later(reference, tmp_path, THEN)
    one.session.arrays = {
        key: value for key, value in one.session.arrays.items() if "timing" not in key
    }
    outcome = one.run_check()
    assert outcome.advice == (NO_LAG,)
    assert "mask.skew_s" not in {figure.name for figure in outcome.figures}
    one.session.arrays = {}
    assert one.run_check().advice == (REFERENCE_KEPT, NO_LAG)
    # As the next calibration gets to know it.
    write_arrays(tmp_path / "arrays.npz", one.session.arrays)
    one.session.arrays = read_arrays(tmp_path / "arrays.npz")
    assert one.run_check().advice == (NO_LAG,)


def test_new_maps_ask_for_a_new_reference(reference: Hands, tmp_path: Path) -> None:
    one = later(reference, tmp_path, THEN)
    one.session.learn("geometry", StepOutcome(maps={"mask": one.session.found("mask")}))
    assert one.run_check().advice == (REFERENCE_KEPT,)
