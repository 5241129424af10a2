"""Missed refreshes under each policy: what the photo then is, and what the run says of it."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import (
    CameraConfig,
    DisplayConfig,
    FaultsConfig,
    PanelConfig,
    RigConfig,
    TriggerConfig,
)
from pdcd.capture.engine import Engine
from pdcd.capture.rig import Rig
from pdcd.codes.make import make_codes
from pdcd.errors import SyncError
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import build_frames
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from tests import bench_rig

SETTLED = CameraConfig(noise="none", f_number=4.0)
"""No test exposures, which would have the faults too."""

FAULTS = {
    "late": FaultsConfig(late={"5": 2}),
    "late at the end": FaultsConfig(late={"24": 1}),
    "dropped": FaultsConfig(dropped=(10,)),
    "stale mask": FaultsConfig(stale_mask=(4, 13)),
    "stale projector and late": FaultsConfig(stale_projector=(7,), late={"20": 1}),
    "two passes": FaultsConfig(late={"2": 1, "38": 1}),
}


def photo(folder: Path, faults: FaultsConfig, window: str, **tables: Any) -> NDArray[np.float64]:
    """Light of one ideal exposure of 8 codes, (N,), without a sensor."""
    folder.mkdir(exist_ok=True)
    config = bench_rig.config(folder, display=DisplayConfig(faults=faults), **tables)
    rig = Rig(config)
    rig.connect()
    codes = make_codes(
        "balanced", Lattice(bench_rig.GRID, window).shape, 8, dual="complement", seed=3
    )
    frames = build_frames(
        bench_rig.pairs(codes), bench_rig.GRID, window=window, schedule="full", passes=1
    )
    rig.display.load(frames)
    open_ns = rig.shutter.open()
    rig.clock.sleep_until_ns(open_ns + 50_000_000)
    log = rig.display.play(lambda *_: None, lambda: False)
    rig.clock.sleep_until_ns(int(log.end_ns.max()) + 50_000_000)
    rig.shutter.close()
    return bench_rig.bench_of_rig(rig).photo()[:, 1]


@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize("lag_s", [0.0, 0.004, -0.006])
@pytest.mark.parametrize("faults", FAULTS)
def test_a_balanced_photo_is_the_sound_one_times_a_number(
    faults: str, lag_s: float, window: str, tmp_path: Path
) -> None:
    tables: dict[str, Any] = {
        "mask": PanelConfig(size_px=(1600, 1200), skew_s=lag_s),
    }
    sound = photo(tmp_path / "sound", FaultsConfig(), window, **tables)
    rig = RigConfig(on_miss="balance", retries=5)
    got = photo(tmp_path / "got", FAULTS[faults], window, rig=rig, **tables)
    times = round(float(np.mean(got / sound)))
    np.testing.assert_allclose(got, times * sound, rtol=1.3e-7)  # refreshes last whole ns


def test_with_refreshes_of_whole_nanoseconds_it_is_so_to_rounding(tmp_path: Path) -> None:
    panels = {
        "projector": PanelConfig(size_px=(1024, 768), refresh_hz=62.5),
        "mask": PanelConfig(size_px=(1600, 1200), refresh_hz=62.5),
    }
    sound = photo(tmp_path / "sound", FaultsConfig(), "whole", **panels)
    faults = FaultsConfig(late={"5": 2}, dropped=(10,), stale_mask=(13,))
    rig = RigConfig(on_miss="balance", retries=5)
    got = photo(tmp_path / "got", faults, "whole", rig=rig, **panels)
    flagged = photo(tmp_path / "flag", faults, "whole", rig=RigConfig(on_miss="flag"), **panels)
    np.testing.assert_allclose(got, 3.0 * sound, rtol=1e-12)
    ratio = flagged / sound
    assert ratio.max() / ratio.min() > 1.05


def test_a_display_that_cannot_balance_gives_up(tmp_path: Path) -> None:
    """Each of two further passes has a late refresh of its own."""
    faults = FaultsConfig(late={"5": 1, "26": 1, "47": 1})
    with pytest.raises(SyncError, match="2 further passes do not"):
        photo(tmp_path, faults, "whole", rig=RigConfig(on_miss="balance", retries=2))


def run(folder: Path, faults: FaultsConfig, rig: RigConfig, **fields: Any) -> CaptureResult:
    folder.mkdir(exist_ok=True)
    tables: dict[str, Any] = {
        "display": DisplayConfig(faults=faults), "rig": rig, "camera": SETTLED,
        **fields.pop("tables", {}),
    }  # fmt: skip
    engine = Engine.from_config(bench_rig.config(folder, **tables))
    engine.start()
    try:
        request = CaptureRequest(goal="indirect", white=False, **fields)
        return bench_rig.capture(engine, request)
    finally:
        assert bench_rig.are_panels_black(bench_rig.bench_of(engine))
        assert not bench_rig.bench_of(engine).shutter_open
        engine.stop()


def image(result: CaptureResult) -> NDArray[np.float64]:
    assert result.state == "done", result.error
    return np.asarray(np.load(Path(str(result.folder)) / "probe.npz")["image"])


def test_abort_takes_the_exposure_again(tmp_path: Path) -> None:
    sound = image(run(tmp_path / "sound", FaultsConfig(), RigConfig()))
    faults = FaultsConfig(late={"5": 1}, exposures=2)
    result = run(tmp_path / "again", faults, RigConfig(on_miss="abort", retries=2))
    np.testing.assert_allclose(image(result), sound, rtol=1e-6)
    folder = Path(str(result.folder))
    raws = sorted(p.name for p in (folder / "raw").iterdir())
    assert raws == [
        "coded-discarded-1.dng", "coded-discarded-2.dng", "coded.dng", "look-dark.dng"
    ]  # fmt: skip
    manifest = read_manifest(folder)
    assert [shot.level for shot in manifest.run.shots] == [1.0]
    assert sum("discarded" in warning for warning in manifest.warnings) == 2
    with (folder / "frames.csv").open() as file:
        names = {row["shot"] for row in csv.DictReader(file)}
    assert names == {"coded", "coded-discarded-1", "coded-discarded-2"}
    assert result.summary["missed_refreshes"] == 0


@pytest.mark.parametrize("retries", [0, 1])
def test_abort_gives_up_after_its_retries(retries: int, tmp_path: Path) -> None:
    faults = FaultsConfig(late={"5": 1}, exposures=2)
    result = run(tmp_path, faults, RigConfig(on_miss="abort", retries=retries))
    assert result.state == "failed" and result.error is not None
    assert result.error["kind"] == "sync"
    assert f"spoilt {retries + 1} times" in str(result.error["message"])


@pytest.mark.parametrize("policy", ["abort", "balance", "flag"])
def test_a_stretched_guard_costs_nothing_but_time(policy: str, tmp_path: Path) -> None:
    sound = image(run(tmp_path / "sound", FaultsConfig(), RigConfig()))
    faults = FaultsConfig(late={"4": 2, "9": 1})  # before the mask opens; between two codes
    result = run(tmp_path / "late", faults, RigConfig(on_miss=policy, retries=0))  # type: ignore[arg-type]
    np.testing.assert_allclose(image(result), sound, rtol=1e-6)
    assert result.summary["missed_refreshes"] == 3
    manifest = read_manifest(Path(str(result.folder)))
    assert any("without harm" in warning for warning in manifest.warnings)


def test_balance_repairs_a_whole_run(tmp_path: Path) -> None:
    sound = image(run(tmp_path / "sound", FaultsConfig(), RigConfig()))
    faults = FaultsConfig(late={"5": 1}, stale_mask=(13,))
    result = run(tmp_path / "balance", faults, RigConfig(on_miss="balance"))
    np.testing.assert_allclose(image(result), sound, rtol=1e-3)  # 14-bit RAW files, other exposure
    folder = Path(str(result.folder))
    shot = read_manifest(folder).run.shots[0]
    assert shot.level == 2.0 and shot.refreshes > 24
    with (folder / "frames.csv").open() as file:
        rows = [int(row["row"]) for row in csv.DictReader(file)]
    assert rows[:24] == list(range(24)) and rows[24] == -1


def test_flag_reports_unequal_weights(tmp_path: Path) -> None:
    faults = FaultsConfig(late={"5": 1}, stale_mask=(13,))
    result = run(tmp_path, faults, RigConfig(on_miss="flag"))
    assert result.state == "done"
    manifest = read_manifest(Path(str(result.folder)))
    assert manifest.run.shots[0].level is None
    assert manifest.realised["coded"]["off_rms"] > 0.0
    told = "2 refreshes were missed; codes were lit 0 to 2 times as long as planned"
    assert any(told in warning for warning in manifest.warnings)


def test_balance_takes_again_what_no_pass_can_undo(tmp_path: Path) -> None:
    """Without guards a stale mask stays open under another code's light."""
    rig = RigConfig(on_miss="balance", retries=1)
    once = run(tmp_path / "1", FaultsConfig(stale_mask=(3,), exposures=1), rig, guards=False)
    assert once.state == "done"
    assert (Path(str(once.folder)) / "raw" / "coded-discarded-1.dng").exists()
    always = run(tmp_path / "2", FaultsConfig(stale_mask=(3,)), rig, guards=False)
    assert always.error is not None and always.error["kind"] == "sync"
    assert "another code" in str(always.error["message"])


def test_photos_that_are_subtracted_show_their_codes_equally_often(tmp_path: Path) -> None:
    """Ambient light and leaks gather over all of an exposure: the one that needed a further pass is
    taken again."""
    tables: dict[str, Any] = {
        "scene": bench_rig.matrix_scene(tmp_path, ambient=0.3),
        "mask": PanelConfig(size_px=(1600, 1200), contrast=50.0),
        "projector": PanelConfig(size_px=(1024, 768), contrast=100.0),
        "trigger": TriggerConfig(jitter_s=0.0),
    }
    black: dict[str, Any] = {"black_level": "both", "tables": tables}
    sound = image(run(tmp_path / "sound", FaultsConfig(), RigConfig(), **black))
    faults = FaultsConfig(late={"5": 1}, exposures=1)
    mended = image(run(tmp_path / "b", faults, RigConfig(on_miss="balance"), **black))
    # What is left is leaking light while the panels wait for their first vblank.
    error = np.abs(mended - sound).max()
    assert error < 5e-3 * float(sound.max())
    flagged = image(run(tmp_path / "f", faults, RigConfig(on_miss="flag"), **black))
    assert np.abs(flagged - sound).max() > 4.0 * error
