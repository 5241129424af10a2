"""The planner by wanted error or time: what it refuses, and what it settles on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, LimitsConfig, PanelConfig, SceneConfig
from pdcd.capture.engine import Engine
from pdcd.cli.main import main
from pdcd.codes.pilot.codes import MATCHED
from pdcd.errors import RequestError
from pdcd.planning.choose import choose_plan
from pdcd.planning.defaults import is_search_needed
from pdcd.planning.given import read_request_arrays
from pdcd.planning.outlook import ErrorEstimate, RigSetting
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CaptureRequest
from tests import bench_rig
from tests.bench_rig import from_path
from tests.places import DATA

NOISY = CameraConfig(noise="full")
MIRROR = SceneConfig(kind="matrix", path=str(DATA / "mirror_32x24.npz"))


SMALL = SceneConfig(kind="wax-disk", grid=(9, 12))


def plan(folder: Path, request: CaptureRequest, **tables: Any) -> PlanSummary:
    given = {"camera": NOISY, "scene": MIRROR, **tables}
    return Engine.from_config(bench_rig.config(folder, **given)).plan(request)


def setting(config: Config) -> RigSetting:
    engine = Engine.from_config(config)
    rig = engine._rig
    return RigSetting(config, rig.look_at_camera(), engine._profile, rig.mask_lag_s())


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"error": 0.1, "seconds": 9.0}, "both"),
        ({"error": 0.1, "codes": 64}, "codes"),
        ({"error": 0.1, "pilot": 32}, "pilot"),
        ({"error": 0.1, "repeat": 2}, "repeat"),
        ({"seconds": 9.0, "exposure_s": 2.0}, "exposure_s"),
        ({"seconds": 9.0, "method": "nayar"}, "coded"),
        ({"error": 0.1, "family": "isolation"}, "coded"),
        ({"goal": "transport", "error": 0.1}, "its entries"),
        ({"goal": "transport", "seconds": 9.0}, "its entries"),
        ({"confidence": 0.9}, "confidence"),
    ],
)
def test_contradictions_are_refused(fields: dict[str, Any], what: str) -> None:
    with pytest.raises(RequestError, match=what) as caught:
        is_search_needed(CaptureRequest(**{"goal": "indirect", **fields}))
    assert caught.value.hint


def test_explicit_requests_are_left_alone() -> None:
    assert not is_search_needed(CaptureRequest(goal="indirect", codes=64, pilot=32))


@pytest.mark.long
def test_an_error_out_of_reach_is_refused_with_what_is_in_reach(tmp_path: Path) -> None:
    tables: dict[str, Any] = {
        "scene": SMALL,
        "limits": LimitsConfig(min_free_bytes=0, max_exposure_s=60.0),
    }
    with pytest.raises(RequestError, match=r"0\.01 % cannot be had.*codes.*sensor") as caught:
        plan(tmp_path, CaptureRequest(goal="indirect", error=1e-4), **tables)
    words = str(caught.value.hint).split()
    reachable = float(words[2]) / 100.0
    summary = plan(tmp_path, CaptureRequest(goal="indirect", error=reachable), **tables)
    assert summary.prediction is not None and summary.prediction.bound <= reachable


@pytest.mark.long
def test_limits_refuse_what_they_must(tmp_path: Path) -> None:
    short = LimitsConfig(min_free_bytes=0, max_exposure_s=0.5)
    with pytest.raises(RequestError, match=r"cannot be had.*0\.5 s"):
        plan(tmp_path, CaptureRequest(goal="indirect", error=0.001), limits=short, scene=SMALL)
    with pytest.raises(RequestError, match=r"no plan fits into 0\.1 s"):
        plan(tmp_path, CaptureRequest(goal="indirect", seconds=0.1))


@pytest.mark.long
def test_a_leak_is_measured_where_that_pays(tmp_path: Path) -> None:
    """Dark frames take half of the time, and a mask of 300 : 1 leaves 6 % without them."""
    leaking = PanelConfig(size_px=(1600, 1200), rise_s=0.001, fall_s=0.002, contrast=300.0)
    tables: dict[str, Any] = {
        "scene": SceneConfig(kind="open-book", grid=(24, 32)),
        "limits": LimitsConfig(min_free_bytes=0, max_exposure_s=60.0),
    }
    request = CaptureRequest(goal="indirect", error=0.03)

    def blacks(**more: Any) -> set[str]:
        shots = plan(tmp_path, request, **tables, **more).shots
        return {shot.name for shot in shots if "black" in shot.name}

    assert blacks(mask=leaking) == {"coded-black-dual", "white-black-dual"}
    assert not blacks()
    request = msgspec.structs.replace(request, error=0.1)
    assert not blacks(mask=leaking)
    request = msgspec.structs.replace(request, black_level="both")
    assert len(blacks(mask=leaking)) == 6
    request = msgspec.structs.replace(request, error=0.03, black_level="none")
    with pytest.raises(RequestError, match="3 % cannot be had"):
        blacks(mask=leaking)


def test_no_codes_that_take_long_are_chosen_for_plans_that_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []

    def woven(lattice: tuple[int, int], count: int, *_: Any) -> np.ndarray:
        calls.append(count)
        return np.ones((count, lattice[0] * lattice[1]))

    monkeypatch.setattr("pdcd.planning.pairs.make_joint_codes", woven)
    far: dict[str, Any] = {"goal": "long-range", "radius": 1}
    plan(tmp_path, CaptureRequest(**far, seconds=5.0), scene=SMALL)
    assert not calls
    plan(tmp_path, CaptureRequest(**far, codes=16), scene=SMALL)
    assert calls == [16]


def test_confidence_costs_time(tmp_path: Path) -> None:
    """Between a coin toss and near certainty lies more light."""
    sums = [
        plan(tmp_path, CaptureRequest(goal="indirect", error=0.04, confidence=c, family="balanced"))
        for c in (0.5, 0.999999)
    ]
    assert sums[0].prediction and sums[1].prediction
    assert sums[0].prediction.bound == pytest.approx(sums[0].prediction.error)
    assert sums[1].prediction.bound > sums[1].prediction.error
    assert sums[1].prediction.error <= sums[0].prediction.error


@pytest.mark.long
def test_a_mirror_gets_a_pilot_where_nothing_else_will_do(tmp_path: Path) -> None:
    """Exposures of 2 s hold about 100 codes, too few without a pilot (see test_pilot)."""
    short = LimitsConfig(min_free_bytes=0, max_exposure_s=2.0)
    easy = plan(tmp_path, CaptureRequest(goal="indirect", error=0.05), limits=short)
    hard = plan(tmp_path, CaptureRequest(goal="indirect", error=0.012), limits=short)
    assert easy.pilot == 0
    assert hard.pilot in MATCHED and hard.raw_files > hard.pilot
    assert hard.prediction is not None and hard.prediction.bound <= 0.012


@pytest.mark.parametrize(
    ("mask", "guards"),
    [
        ({}, False),
        ({"skew_s": 0.002}, True),
        ({"jitter_s": 1e-4}, True),
        ({"phase_s": 0.001}, True),
    ],
)
def test_guards_go_where_panels_are_in_step(
    mask: dict[str, float], guards: bool, tmp_path: Path
) -> None:
    panel = PanelConfig(size_px=(1600, 1200), **mask)  # type: ignore[arg-type]
    summary = plan(tmp_path, CaptureRequest(goal="indirect", error=0.05), mask=panel)
    assert summary.guards is guards


def test_a_dim_rig_gets_longer_exposures_or_gain(tmp_path: Path) -> None:
    """A thousandth of the light at the widest aperture there is: more passes, or a higher ISO."""
    dim = CameraConfig(noise="full", responsivity_e=(48.0, 86.0, 56.0), profile="mark2")
    bright = plan(tmp_path, CaptureRequest(goal="indirect", error=0.05))
    summary = plan(tmp_path, CaptureRequest(goal="indirect", seconds=60.0), camera=dim)
    assert summary.prediction is not None
    assert bright.passes == 1
    assert summary.passes > 1 or summary.prediction.iso > 100


def test_a_fixed_aperture_that_saturates_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="saturates"):
        plan(
            tmp_path,
            CaptureRequest(goal="indirect", error=0.05),
            camera=CameraConfig(noise="full", f_number=1.0),
            scene=SMALL,
        )


def test_unknown_scenes_are_guessed(tmp_path: Path) -> None:
    config = bench_rig.config(tmp_path, camera=NOISY)
    rig, grid = setting(config), (24, 32)
    few, many = (
        choose_plan(CaptureRequest(goal="indirect", error=e), rig, grid, None).plan
        for e in (0.05, 0.01)
    )
    assert few.prediction and many.prediction
    assert many.prediction.bound <= 0.01 < few.prediction.bound <= 0.05
    assert many.how.coded > few.how.coded
    assert "50 paths" in few.prediction.prior
    with pytest.raises(RequestError, match="unknown scene"):
        choose_plan(CaptureRequest(goal="long-range", radius=1, error=0.05), rig, grid, None)


def test_a_prior_file_stands_for_the_scene(tmp_path: Path) -> None:
    rig, grid = setting(bench_rig.config(tmp_path, camera=NOISY)), (24, 32)
    files = {"prior": from_path(Path(str(MIRROR.path)))}
    asked, given = read_request_arrays(CaptureRequest(goal="indirect", error=0.02), files, grid)
    known = choose_plan(asked, rig, grid, None, given=given)
    same = plan(tmp_path, CaptureRequest(goal="indirect", error=0.02))
    assert known.plan.prediction is not None and same.prediction is not None
    assert known.plan.prediction.prior == "file mirror_32x24.npz"
    assert known.plan.prediction.bound <= 0.02
    assert known.plan.how.coded < same.codes  # the codes avoid the paths of the prior
    assert known.plan.prior == "file mirror_32x24.npz" and same.prior is None
    with pytest.raises(RequestError, match="24 x 32 cells, the rig of 3 x 4"):
        choose_plan(asked, rig, (3, 4), None, given=given)


def test_the_bound_is_kept_as_often_as_it_says() -> None:
    """Mean squares of 20 000 drawn pictures of 300 pixels: code errors that stay, noise that does
    not."""
    rng = np.random.default_rng(0)
    pixels, repeat = 300, 3
    code, sensor = 0.02 * rng.standard_normal(pixels), 0.01 * (1.0 + rng.random(pixels))
    estimate = ErrorEstimate(
        code=float(np.sqrt(np.mean(code**2))),
        sensor=float(np.sqrt(np.mean(sensor**2))),
        code_var=0.0,
        cross_var=float(4.0 * np.sum(code**2 * sensor**2)) / pixels**2,
        sensor_var=float(2.0 * np.sum(sensor**4)) / pixels**2,
        headroom=1.0,
    )
    noise = sensor / np.sqrt(repeat) * rng.standard_normal((20_000, pixels))
    drawn = np.sqrt(np.mean((code + noise) ** 2, axis=1))
    assert estimate.error(repeat) == pytest.approx(np.sqrt(np.mean(drawn**2)), rel=1e-3)
    for confidence in (0.5, 0.9, 0.95):
        kept = np.mean(drawn <= estimate.bound(confidence, repeat))
        assert kept == pytest.approx(confidence, abs=0.012)


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["plan", "indirect", "--local", "--error", "0.03", "--confidence", "0.9"]
    file = tmp_path / "rig.toml"
    file.write_text('[scene]\nkind = "wax-disk"\ngrid = [12, 16]\n')
    assert main([*options, "--config", str(file)]) == 0
    table = capsys.readouterr().out
    assert "RMS error" in table and "scene wax-disk" in table and "with 90 %" in table
    assert main([*options, "--config", str(file), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    summary = msgspec.convert(answer, PlanSummary)
    assert summary.prediction is not None and summary.prediction.bound <= 0.03
    assert main([*options, "--config", str(file), "--seconds", "3"]) == 2
    assert "both" in capsys.readouterr().err
