"""The error budget of a photo against what photos of the mock bench really err, over seeds, scenes
and faults that are put in on purpose."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import pdcd
from pdcd.api.run import Run
from pdcd.bench.stops import AbsoluteScale, Stop
from pdcd.calibration.sensor.body import format_profile
from pdcd.pictures.darkroom import Darkroom
from pdcd.sensor.profile import load_profile
from pdcd.verdict.error_budget import ErrorRow, make_error_budget
from tests.reference_run import RUN

pytestmark = pytest.mark.whole

SEEDS = (1, 2, 3)
LAG = {"rise_s": 0.003, "fall_s": 0.005}


def take(
    seed: int = 1,
    *,
    goal: Any = "indirect",
    codes: int = 128,
    parts: int = 4,
    **tables: dict[str, Any],
) -> Run:
    given: dict[str, dict[str, Any]] = {
        "projector": {"size_px": [128, 96]},
        "mask": {"size_px": [128, 96]},
        "camera": {"frame_quads": [64, 48], "seed": seed},
        "scene": {"kind": "open-book", "grid": [12, 16]},
        "limits": {"min_free_bytes": 0},
    }
    for name, more in tables.items():
        given[name] = {**given.get(name, {}), **more}
    with pdcd.local(given) as bench:
        return bench.capture(goal, codes=codes, seed=seed, pilot=0, parts=parts, progress=False)


def rows_of(run: Run) -> dict[str, ErrorRow]:
    return {row.name: row for row in run.error_budget(progress=False)}


def share(run: Run, name: str) -> float:
    found = rows_of(run)[name].share
    assert found is not None
    return found


def over_seeds(*, seeds: tuple[int, ...] = SEEDS, **asked: Any) -> tuple[float, dict[str, float]]:
    """RMS over seeds: of the true error of quads, and of each row that is known."""
    runs = [take(seed, **asked) for seed in seeds]
    true = [run.rms_error_quads for run in runs]
    told = [{name: row.share for name, row in rows_of(run).items()} for run in runs]
    names = [name for name, found in told[0].items() if found is not None]
    return float(np.sqrt(np.mean(np.square(np.array(true, float))))), {
        name: float(np.sqrt(np.mean([np.square(one[name] or 0.0) for one in told])))
        for name in names
    }


@pytest.mark.parametrize("scene", ["open-book", "wax-disk"])
def test_the_sum_of_all_causes_is_what_photos_err(scene: str) -> None:
    true, told = over_seeds(scene={"kind": scene})
    assert 0.7 < told["all"] / true < 1.5
    parts = [told[name] for name in told if name != "all"]
    assert told["all"] == pytest.approx(float(np.hypot.reduce(parts)), rel=1e-6)


def test_read_noise_is_in_the_row_of_noise(tmp_path: Path) -> None:
    """Of a sensor whose profile says that it is noisy."""
    profile = load_profile("modern")
    noisy = [msgspec.structs.replace(row, read_noise_e=150.0) for row in profile.rows]
    path = tmp_path / "noisy.toml"
    path.write_text(format_profile(msgspec.structs.replace(profile, rows=tuple(noisy))))
    quiet = over_seeds(seeds=(1, 2))
    loud = over_seeds(seeds=(1, 2), camera={"profile": str(path)})
    grown = np.sqrt(loud[0] ** 2 - quiet[0] ** 2)
    told = np.sqrt(loud[1]["noise"] ** 2 - quiet[1]["noise"] ** 2)
    assert loud[0] > 1.5 * quiet[0]
    assert told == pytest.approx(grown, rel=0.2)


def test_more_codes_make_the_row_of_codes_as_small_as_they_make_the_error() -> None:
    """The true error without its noise, over seeds of codes."""
    found = {}
    for codes in (64, 256):
        true, told = over_seeds(codes=codes)
        found[codes] = np.sqrt(true**2 - told["noise"] ** 2), told["codes"]
        assert 0.7 < found[codes][1] / found[codes][0] < 1.5
    (few, told_few), (many, told_many) = found[64], found[256]
    assert few > 2.0 * many
    assert told_few / told_many == pytest.approx(few / many, rel=0.4)


@pytest.mark.parametrize("skew_s", [0.0003, 0.002])
@pytest.mark.parametrize("real", [1.0, 0.8, 1.2])
def test_what_slow_panels_let_through_is_off_by_the_row_of_timing(
    skew_s: float, real: float, tmp_path: Path
) -> None:
    """Parts tell how far it is off, whether the mask is as slow as believed, quicker or slower."""
    truth = tmp_path / "truth.toml"
    truth.write_text("[mask]\n" + "".join(f"{key} = {real * s}\n" for key, s in LAG.items()))
    true, told = over_seeds(mask={**LAG, "skew_s": skew_s}, bench={"truth": str(truth)})
    assert 0.7 < told["all"] / true < 1.5
    if real == 1.0:
        assert told["timing"] < told["codes"]
    else:
        assert told["timing"] > told["codes"]


@pytest.mark.parametrize(("real", "contrast"), [(0.9, 100.0), (1.0, 67.0)])
def test_light_of_the_room_and_through_black_is_not_taken_for_that_of_slow_panels(
    real: float, contrast: float, tmp_path: Path
) -> None:
    """Of a mask that leaks in a lit room, and is quicker than believed, or leaks by half more."""
    truth = tmp_path / "truth.toml"
    times = "".join(f"{key} = {real * s}\n" for key, s in LAG.items())
    truth.write_text(f"[mask]\n{times}contrast = {contrast}\n")
    true, told = over_seeds(
        seeds=(1, 2),
        mask={**LAG, "skew_s": 0.0003, "contrast": 100.0},
        scene={"ambient": 0.05},
        bench={"truth": str(truth)},
    )
    assert 0.7 < told["all"] / true < 1.5


def test_the_row_of_maps_grows_as_the_error_of_a_mask_that_lies_elsewhere(tmp_path: Path) -> None:
    """It is the error bars' own figure: lines along borders tell of most of that error, blocks of
    two fifths of a larger one."""
    panels: dict[str, Any] = {"size_px": [1024, 768]}
    asked: dict[str, Any] = {"projector": panels, "mask": panels}
    asked["camera"] = {"frame_quads": [128, 96], "seed": 1}
    assert share(take(**asked), "maps") < 0.01
    true, told = [], []
    for offset_px in (3.0, 6.0):  # of cells of 64 pixels
        truth = tmp_path / f"{offset_px}.toml"
        truth.write_text(f"[mask.place]\noffset_px = [{offset_px}, 0.0]\n")
        run = take(**asked, bench={"truth": str(truth)})
        assert run.verdict == "bad"
        assert run.rms_error_quads is not None
        true.append(run.rms_error_quads)
        told.append(share(run, "maps"))
    assert told[0] < told[1]
    assert 0.6 < told[0] / true[0] < 1.5 and 0.3 < told[1] / true[1] < 1.5


def test_what_nobody_knows_has_no_number() -> None:
    rows = rows_of(pdcd.open(RUN))
    assert [*rows] == ["scale", "stops", "maps", "timing", "codes", "noise", "all"]
    assert {name for name, row in rows.items() if row.share is None} == {"scale", "maps"}
    assert all((row.share is None) == (row.rms is None) for row in rows.values())
    assert "without scale, maps" in rows["all"].source
    few = rows_of(take(parts=1))
    assert few["codes"].share is None
    assert few["all"].share == pytest.approx(few["noise"].share, rel=0.01)


def test_a_budget_is_no_less_than_what_error_bars_have() -> None:
    """Of an answer of two photos nobody tells how much direct light got through; what error bars
    have of that is in the budget all the same."""
    run = take(goal="direct", projector=LAG, mask=LAG | {"skew_s": 0.003})
    assert share(run, "timing") > 0.0
    assert run.rms_sigma is not None
    assert share(run, "all") >= 0.99 * run.rms_sigma


def test_scale_and_stops_are_what_the_calibration_states() -> None:
    """A scale and a stop that are off by so much make all of the picture brighter by as much."""
    run = pdcd.open(RUN)
    record = msgspec.structs.replace(
        run.manifest.run,
        scale=AbsoluteScale("as of a calibration", 0.05),
        stops=(Stop(8.0, 8.0, 0.02),),
    )
    darkroom = Darkroom(run.folder, record)
    rows = {row.name: row for row in make_error_budget(record, darkroom.decoded())}
    assert rows["scale"].share == pytest.approx(0.05)
    assert rows["stops"].share == pytest.approx(0.02, rel=1e-3)
    light = float(np.sqrt(np.mean(run.pictures["indirect"].astype(float) ** 2)))
    assert rows["scale"].rms == pytest.approx(0.05 * light, rel=1e-4)
    assert rows["all"].share is not None
    assert rows["all"].share > float(np.hypot(0.05, 0.02))
