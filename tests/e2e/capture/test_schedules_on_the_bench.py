"""Schedules, the mask's delay and packed planes on the mock bench, from configuration to photo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.checks import find_cross_faults
from pdcd.bench.tables import (
    CameraConfig,
    Config,
    DisplayConfig,
    FaultsConfig,
    PanelConfig,
    RigConfig,
    SceneConfig,
)
from pdcd.capture.engine import Engine
from pdcd.capture.rig import Rig
from pdcd.codes.make import make_codes
from pdcd.errors import ConfigError
from pdcd.panels.frames import BLACK, FrameLog
from pdcd.panels.schedule import build_frames
from pdcd.probing.panel import PanelOptics
from pdcd.probing.realised import collect_factors, compute_factors
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from pdcd.words import GuardsName
from tests import bench_rig
from tests.taken import started

T_S = 1.0 / 60.0
SETTLED = CameraConfig(noise="none", f_number=4.0)


def mask(**given: Any) -> PanelConfig:
    return PanelConfig(size_px=(1600, 1200), **given)


def planned(folder: Path, request: CaptureRequest, **tables: Any) -> PlanSummary:
    return Engine.from_config(bench_rig.config(folder, **tables)).plan(request)


def captured(folder: Path, request: CaptureRequest, **tables: Any) -> CaptureResult:
    folder.mkdir(exist_ok=True)
    with started(bench_rig.config(folder, **{"camera": SETTLED, **tables})) as engine:
        return bench_rig.capture(engine, request)


def direct_left(result: CaptureResult) -> float:
    """Largest weight of direct light in the coded photo, over that of indirect light."""
    assert result.state == "done" and result.folder is not None, result.error
    return read_manifest(Path(result.folder)).realised["coded"]["diagonal_max"]


@pytest.mark.parametrize(
    ("panel", "schedule"),
    [
        ({}, "lag"),
        ({"phase_s": 0.012}, "lead"),  # 4.7 ms before the projector's next vblank
        ({"skew_s": 0.003}, "lag"),
        ({"skew_s": -0.003}, "lead"),
        ({"phase_s": 0.005, "skew_s": -0.009}, "lead"),
        ({"skew_s": 0.020}, "full"),  # beyond what any two-refresh schedule bears
        ({"refresh_hz": 59.9}, "full"),  # no lag that lasts
        ({"jitter_s": 0.001}, "full"),  # of either sign
    ],
)
def test_auto_takes_the_sign_that_the_display_measures(
    panel: dict[str, float], schedule: str, tmp_path: Path
) -> None:
    request = CaptureRequest(goal="indirect", codes=8, white=False, guards="auto")
    tables = {"mask": mask(**panel)}
    assert planned(tmp_path, request, **tables).schedule == schedule
    result = captured(tmp_path, request, **tables)
    assert result.summary["refreshes"] == 8 * (3 if schedule == "full" else 2)
    if abs(panel.get("skew_s", 0.0)) < T_S and "refresh_hz" not in panel:
        assert direct_left(result) == 0.0


def test_a_slow_mask_has_closed_before_the_next_code(tmp_path: Path) -> None:
    """A tenth of what the guards of `full` leave: a black projector under `tail` for the same time
    and light, another refresh of the code's own light under `wide`, which `auto` takes."""
    tables = {
        "mask": mask(rise_s=0.004, fall_s=0.006, skew_s=0.001),
        "projector": PanelConfig(size_px=(1024, 768), rise_s=0.0005, fall_s=0.0005),
    }
    left, light = {}, {}
    shown: tuple[tuple[GuardsName, int], ...] = (("full", 24), ("tail", 24), ("auto", 32))
    for guards, refreshes in shown:
        request = CaptureRequest(goal="indirect", codes=8, white=False, guards=guards)
        result = captured(tmp_path / guards, request, **tables)
        left[guards] = direct_left(result)
        light[guards] = planned(tmp_path, request, **tables).light_share
        assert result.summary["refreshes"] == refreshes
    assert planned(tmp_path, request, **tables).schedule == "wide"
    assert 0.0 < left["auto"] < 0.1 * left["full"] and 0.0 < left["tail"] < 0.1 * left["full"]
    assert light["tail"] == light["full"]


def test_the_wrong_sign_leaks(tmp_path: Path) -> None:
    request = CaptureRequest(goal="indirect", codes=8, white=False, guards="lead")
    assert direct_left(captured(tmp_path, request, mask=mask(phase_s=0.005))) > 0.1


@pytest.mark.parametrize("late", [2, -1])
def test_a_latency_of_whole_refreshes_is_taken_out(late: int, tmp_path: Path) -> None:
    request = CaptureRequest(goal="indirect", codes=8, white=False, guards="none")
    panel = mask(skew_s=late * T_S)
    assert direct_left(captured(tmp_path, request, mask=panel)) > 0.1
    cured = DisplayConfig(mask_delay_refreshes=-late)
    rig = Rig(bench_rig.config(tmp_path, mask=panel, display=cured))
    assert rig.mask_lag_s() == pytest.approx(0.0, abs=1e-12)
    result = captured(tmp_path / "cured", request, mask=panel, display=cured)
    # The light of a refresh begins within a ns of rounding of the other panel's.
    assert direct_left(result) < 1e-6
    assert result.summary["missed_refreshes"] == 0
    image = np.load(Path(str(result.folder)) / "probe.npz")["image"]
    sound = captured(tmp_path / "sound", request)
    want = np.load(Path(str(sound.folder)) / "probe.npz")["image"]
    np.testing.assert_allclose(image, want, rtol=1e-3)


def test_a_delayed_mask_is_balanced_too(tmp_path: Path) -> None:
    """A late refresh moves both streams; the mask's is the one that counts."""
    tables: dict[str, Any] = {"mask": mask(skew_s=2 * T_S)}
    request = CaptureRequest(goal="indirect", codes=8, white=False)
    ideal = captured(
        tmp_path / "a", request, **tables, display=DisplayConfig(mask_delay_refreshes=-2)
    )
    faults = FaultsConfig(late={"6": 1})
    result = captured(
        tmp_path / "b", request, **tables,
        rig=RigConfig(on_miss="balance"),
        display=DisplayConfig(mask_delay_refreshes=-2, faults=faults),
    )  # fmt: skip
    got, want = (np.load(Path(str(r.folder)) / "probe.npz")["image"] for r in (result, ideal))
    np.testing.assert_allclose(got, want, rtol=2e-3)
    assert direct_left(result) < 1e-6


# --- 24 bit planes of one picture -------------------------------------------------------------

DLP = DisplayConfig(planes_per_refresh=24)


def test_1440_codes_a_second(tmp_path: Path) -> None:
    request = CaptureRequest(
        goal="indirect", codes=1440, pilot=0, parts=1, guards=False, white=False
    )
    summary = planned(tmp_path, request, display=DLP, rig=RigConfig(settle_s=0.0))
    assert summary.refreshes == 1440
    assert summary.seconds == pytest.approx(1.0, abs=1e-9)
    result = captured(tmp_path, request, display=DLP)
    assert direct_left(result) < 1e-5
    shot = read_manifest(Path(str(result.folder))).run.shots[0]
    assert (shot.end_ns[0] - shot.open_ns) * 1e-9 == pytest.approx(1.0, abs=0.1)


def play(folder: Path, display: DisplayConfig, count: int = 30, **tables: Any) -> FrameLog:
    rig = Rig(bench_rig.config(folder, display=display, **tables))
    rig.connect()
    codes = make_codes("balanced", bench_rig.GRID, count, dual="complement")
    rig.display.load(
        build_frames(
            bench_rig.pairs(codes), bench_rig.GRID, window="whole", schedule="none", passes=1
        )
    )
    return rig.display.play(lambda *_: None, lambda: False)


def test_planes_follow_each_other_within_a_refresh(tmp_path: Path) -> None:
    """30 patterns are one picture and six planes of the next; then both panels are black."""
    log = play(tmp_path, DLP)
    np.testing.assert_array_equal(log.primal_shown, range(30))
    vblank = log.primal_ns[0] + np.array([0, 1e9 / 60])
    want = [vblank[k // 24] + (k % 24) * 1e9 / 1440 for k in range(30)]
    np.testing.assert_allclose(log.primal_ns, want, rtol=0, atol=2)
    assert log.end_ns[0] == pytest.approx(vblank[1] + 6e9 / 1440, abs=2)


UNEVEN = tuple(np.cumsum([0.002] + [0.9 / 24, 1.1 / 24] * 12)[:-1].tolist())
"""Planes that last nine and eleven tenths of the mean in turn; the first begins late."""


def test_planes_of_unequal_length_are_what_the_matrix_says(tmp_path: Path) -> None:
    """Each code counts as long as its plane lasts: a dense sum over measured times."""
    display = DisplayConfig(planes_per_refresh=24, plane_starts=UNEVEN)
    count, grid = 48, bench_rig.GRID
    log = play(tmp_path, display, count=count)
    codes = make_codes("balanced", grid, count, dual="complement")
    frames = build_frames(bench_rig.pairs(codes), grid, window="whole", schedule="none", passes=1)
    end_ns = int(log.end_ns.max())
    found = collect_factors(
        compute_factors(
            frames,
            log,
            PanelOptics(),
            PanelOptics(),
            open_ns=int(log.primal_ns[0]) - 1,
            close_ns=end_ns,
        )
    )
    lasts_s = np.tile([0.9, 1.1], count // 2) / 1440.0
    want = (codes.dual.T * lasts_s) @ codes.primal
    # Stamps are whole nanoseconds.
    np.testing.assert_allclose(found.dense(), want, rtol=1e-9, atol=count * 1e-9)
    assert not found.coaxial.any()


def test_a_plan_tells_of_planes_and_refuses_those_that_cannot_be(tmp_path: Path) -> None:
    display = DisplayConfig(planes_per_refresh=24, plane_starts=UNEVEN)
    request = CaptureRequest(
        goal="indirect", codes=48, pilot=0, parts=1, guards=False, black_level="none"
    )
    (reason,) = planned(tmp_path, request, display=display).reasons
    assert reason == "24 planes a refresh, of 0.625 to 0.764 ms, as measured: 1440 a second"
    backwards = (*UNEVEN[:22], UNEVEN[23], UNEVEN[22])
    for starts in (UNEVEN[:23], backwards, (*UNEVEN[:23], UNEVEN[22] + 0.01)):
        wrong = Config(display=DisplayConfig(planes_per_refresh=24, plane_starts=starts))
        assert any("display.plane_starts" in fault.keys for fault in find_cross_faults(wrong))


def test_a_picture_that_comes_late_is_preceded_by_the_last_one_again(tmp_path: Path) -> None:
    faulty = DisplayConfig(planes_per_refresh=24, faults=FaultsConfig(late={"1": 2}))
    log = play(tmp_path, faulty)
    np.testing.assert_array_equal(log.dual_shown, [*range(24)] * 3 + [*range(24, 30)])
    assert log.missed.tolist() == [0] * 72 + [2] + [0] * 5
    balanced = play(tmp_path, faulty, rig=RigConfig(on_miss="balance"))
    shown = balanced.dual_shown[balanced.dual_shown != BLACK]
    assert np.bincount(shown).tolist() == [3] * 30


def test_a_lost_picture_is_the_last_one_again(tmp_path: Path) -> None:
    faulty = DisplayConfig(planes_per_refresh=24, faults=FaultsConfig(dropped=(1,)))
    log = play(tmp_path, faulty, count=72)
    np.testing.assert_array_equal(log.primal_shown, [*range(24), *range(24), *range(48, 72)])
    balanced = play(tmp_path, faulty, count=72, rig=RigConfig(on_miss="balance"))
    shown = balanced.dual_shown[balanced.dual_shown != BLACK]
    assert np.bincount(shown).tolist() == [2] * 72


def test_grey_levels_are_refused(tmp_path: Path) -> None:
    kernel = ((0.0, 0.25, 0.0), (0.25, 0.5, 0.25), (0.0, 0.25, 0.0))
    request = CaptureRequest(goal="filtered", kernel=kernel, codes=8)
    with pytest.raises(ConfigError, match="grey levels"):
        planned(tmp_path, request, display=DLP)
    rig = Rig(bench_rig.config(tmp_path, display=DLP))
    grey = np.full((2, 12), 0.5, dtype=np.float32)
    with pytest.raises(ConfigError, match="grey levels"):
        rig.display.load(
            build_frames((grey, grey), bench_rig.GRID, window="whole", schedule="full", passes=1)
        )


def test_a_delay_of_refreshes_is_one_of_whole_pictures(tmp_path: Path) -> None:
    late = DisplayConfig(planes_per_refresh=24, mask_delay_refreshes=-1)
    log = play(tmp_path, late, mask=mask(skew_s=T_S))
    assert len(log) == 54
    np.testing.assert_array_equal(log.dual_shown[:30], range(30))
    np.testing.assert_array_equal(log.primal_shown[24:], range(30))
    with pytest.raises(ConfigError, match="grid"):
        play(tmp_path, late, scene=SceneConfig(kind="open-book", grid=(6, 8)))
