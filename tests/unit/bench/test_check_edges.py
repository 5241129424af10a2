"""Faults between keys: the last value that is sound, and the first that is not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.checks import check_config, find_cross_faults, find_rate_fault
from pdcd.bench.tables import (
    CameraConfig,
    Config,
    DisplayConfig,
    PanelConfig,
    RigConfig,
    SceneConfig,
    ScheduleConfig,
    ServerConfig,
)
from pdcd.bench.truth import BenchTruth, TruePanel, TrueScene, find_scan_fault, read_bench_truth

MASK_PX = (1600, 1200)


def keys(config: Config) -> list[tuple[str, ...]]:
    return [fault.keys for fault in find_cross_faults(config)]


def mask(**told: Any) -> PanelConfig:
    return PanelConfig(**{"size_px": MASK_PX, **told})


def test_refresh_rates_may_differ_by_a_two_thousandth() -> None:
    for hz, sound in ((1000.5, True), (999.5, True), (1000.51, False), (999.49, False)):
        config = Config(
            projector=PanelConfig(size_px=(1024, 768), refresh_hz=1000.0),
            mask=mask(refresh_hz=hz),
            display=DisplayConfig(driver="x11"),
        )
        fault = find_rate_fault(config)
        assert (fault is None) == sound and (check_config(config) == []) == sound
        assert sound or fault is not None
        if fault is not None:
            assert fault.keys == ("projector.refresh_hz", "mask.refresh_hz")
            assert keys(config) == [fault.keys]
        mock = msgspec.structs.replace(config, display=DisplayConfig())
        assert check_config(mock) == []  # mock panels may slip


def test_either_panel_may_be_out_of_phase_by_a_refresh() -> None:
    for name, size in (("projector", (1024, 768)), ("mask", MASK_PX)):
        for phase_s, sound in ((0.25, True), (-0.25, True), (0.26, False), (-0.26, False)):
            panel = PanelConfig(size_px=size, refresh_hz=4.0, phase_s=phase_s)
            config = msgspec.structs.replace(Config(), **{name: panel})
            found = keys(config)
            assert found == ([] if sound else [(f"{name}.phase_s", f"{name}.refresh_hz")])


@pytest.mark.parametrize(
    ("scan_s", "skew_s", "sound"),
    [(0.05, 0.0, True), (-0.05, 0.0, True), (0.03, 0.02, True), (0.03, -0.021, False),
     (-0.051, 0.0, False), (0.0, 0.9, True)],
)  # fmt: skip
def test_rows_are_black_before_the_shutter_closes(
    scan_s: float, skew_s: float, sound: bool
) -> None:
    panel = mask(scan_s=scan_s, skew_s=skew_s)
    fault = find_scan_fault("mask", panel, 0.05)
    assert (fault is None) == sound
    if fault is not None:
        assert fault.keys == ("mask.scan_s", "rig.settle_s")
        assert f"set {abs(scan_s):g} s apart" in fault.message


@pytest.mark.parametrize("told", [{"contrast": 900.0}, {"rise_s": 0.001}, {"fall_s": 0.001}])
def test_a_sensor_of_two_buckets_is_its_own_mask(told: dict[str, float]) -> None:
    two = CameraConfig(buckets=2)
    (found,) = keys(Config(camera=two, mask=mask(**told)))
    assert found == ("camera.buckets", "mask.contrast", "mask.rise_s", "mask.fall_s")
    assert keys(Config(camera=two, mask=mask())) == []
    assert keys(Config(mask=mask(**told))) == []


def test_the_last_path_of_a_socket_has_107_bytes() -> None:
    for length, sound in ((107, True), (108, False)):
        config = Config(server=ServerConfig(socket="/" + "x" * (length - 1)))
        assert keys(config) == ([] if sound else [("server.socket",)])
    wide = Config(server=ServerConfig(socket="/" + "\u00e9" * 54))  # two bytes each
    assert keys(wide) == [("server.socket",)]


def starts(at: int, moved: float) -> tuple[float, ...]:
    """24 even planes of which one begins later by so many of their lengths."""
    return tuple((plane + (moved if plane == at else 0.0)) / 24.0 for plane in range(24))


@pytest.mark.parametrize(
    ("measured", "sound"),
    [
        (starts(5, 0.39), True), (starts(5, 0.41), False), (starts(5, -0.39), True),
        (starts(5, -0.41), False), (starts(23, 0.39), True), (starts(23, 0.41), False),
        (starts(0, 0.39), True), (starts(0, 0.41), False), (starts(5, 0.0)[:23], False),
    ],
)  # fmt: skip
def test_planes_last_about_equally_long(measured: tuple[float, ...], sound: bool) -> None:
    config = Config(display=DisplayConfig(planes_per_refresh=24, plane_starts=measured))
    expected = [] if sound else [("display.plane_starts", "display.planes_per_refresh")]
    assert keys(config) == expected


def test_cells_have_a_pixel_of_each_panel_or_as_many_as_their_window_needs() -> None:
    small = PanelConfig(size_px=(64, 48))

    def found(grid: tuple[int, int], window: str, projector: PanelConfig = small) -> list[str]:
        schedule = ScheduleConfig(grid=grid, window=window)  # type: ignore[arg-type]
        return check_config(Config(projector=projector, schedule=schedule))

    assert found((48, 64), "whole") == []
    (message,) = found((48, 65), "whole")
    assert "48 x 65 cells leave 0.985 pixels a cell on the projector; 1 are needed" in message
    assert found((12, 16), "quarter") == []
    (message,) = found((12, 17), "quarter")
    assert message.endswith("on the projector; 4 are needed by the quarter window")
    mask_too = Config(
        projector=small, mask=PanelConfig(size_px=(64, 40)), scene=SceneConfig(grid=(48, 64))
    )
    (message,) = check_config(mask_too)
    assert "pixels a cell on the mask" in message


def test_a_window_covers_an_offset_of_its_guard() -> None:
    """A quarter window of cells of 16 pixels covers four."""
    for offset, sound in ((4.0, True), (4.01, False)):
        rig, schedule = RigConfig(misregistration_px=offset), ScheduleConfig(window="quarter")
        found = keys(Config(rig=rig, schedule=schedule))
        assert bool(found) != sound
        assert not found or found[0][1] == "schedule.window"
    whole = ScheduleConfig(window="whole")
    assert keys(Config(rig=RigConfig(misregistration_px=9.0), schedule=whole)) == []
    # The smaller side of a cell counts.
    high = Config(
        rig=RigConfig(misregistration_px=3.0),
        schedule=ScheduleConfig(window="quarter", grid=(96, 64)),
    )
    assert len(keys(high)) == 1


def test_a_scene_of_a_file_needs_it_and_its_cells_are_not_known_yet(tmp_path: Path) -> None:
    path = tmp_path / "t.npz"
    np.savez(path, x=1)
    assert keys(Config(scene=SceneConfig(kind="matrix", path=str(path)))) == []
    assert keys(Config(scene=SceneConfig(kind="matrix"))) == [("scene.kind", "scene.path")]
    fine = SceneConfig(kind="matrix", path=str(path), grid=(4800, 64))
    assert keys(Config(scene=fine))[0][0] == "scene.grid"
    gone = SceneConfig(kind="matrix", path=str(tmp_path / "gone"))
    assert keys(Config(scene=gone)) == [("scene.path",)]


def test_a_plane_needs_a_bench_off_the_axis_and_an_inverse() -> None:
    plane = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    assert keys(Config(rig=RigConfig(arrangement="off-axis", plane=plane))) == []
    assert keys(Config(rig=RigConfig(plane=plane))) == [("rig.plane", "rig.arrangement")]
    flat = (1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert keys(Config(rig=RigConfig(arrangement="off-axis", plane=flat))) == [("rig.plane",)]
    # Every corner of the field must be somewhere.
    for far in ((1.0, 0.0, -1.0), (0.0, 1.0, -1.0), (1.0, 1.0, -2.0), (1.0, 1.0, 0.0)):
        beyond = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, *far)
        found = keys(Config(rig=RigConfig(arrangement="off-axis", plane=beyond)))
        assert found == [("rig.plane",)]


def told(folder: Path, text: str) -> list[str]:
    path = folder / "truth.toml"
    path.write_text(text)
    return [fault.message for fault in read_bench_truth(path, Config())[1]]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[mask]\ndead_rows = [0, 1199]\ndead_columns = [1599]", ""),
        ("[mask]\ndead_rows = [0, 1200]", "mask.dead_rows: lines are counted 0 to 1199"),
        ("[mask]\ndead_columns = [1600]", "mask.dead_columns: lines are counted 0 to 1599"),
        ("[projector]\ndead_rows = [768]", "projector.dead_rows: lines are counted 0 to 767"),
        ("[mask]\ncontrast = 1.01", ""),
        ("[mask]\ncontrast = 1.0", "mask.contrast: white over black exceeds 1"),
        ("[mask]\nscan_s = 0.05", ""),
        ("[mask]\nscan_s = 0.051", "mask.scan_s: rows that are set 0.051 s apart"),
        ("[mask]\nphase_s = 0.0166", ""),
        ("[mask]\nphase_s = -0.0167", "mask.phase_s: -0.0167 s is more than one refresh"),
        ("[scene]\nblur_taps = 7", ""),
        ("[scene]\nblur_taps = 8", "scene.blur_taps: must be odd"),
        ("[mask]\noffset_px = [1.0, 0.0]", ""),
        ("[projector]\noffset_px = [0.0, 0.0]", "projector.offset_px: the mask is offset"),
        ("[mask]\nlut = [0.0, 0.5]", "mask.lut: "),
        ("[mask]\nskew_s = inf", "mask.skew_s: must be a finite number"),
    ],
)
def test_a_truth_at_the_edge_and_beyond(tmp_path: Path, text: str, says: str) -> None:
    found = told(tmp_path, text)
    assert len(found) == bool(says) and all(message.startswith(says) for message in found)


def test_what_is_said_of_the_truth_takes_the_place_of_what_is_believed() -> None:
    believed = Config(mask=mask(lut=(0.0, 1.0), gamma=2.0, skew_s=0.001))
    gamma = BenchTruth(mask=TruePanel(gamma=1.8)).of(believed).mask
    assert (gamma.gamma, gamma.lut, gamma.skew_s) == (1.8, None, 0.001)
    both = BenchTruth(mask=TruePanel(gamma=1.8, lut=(0.0, 0.5, 1.0))).of(believed).mask
    assert (both.gamma, both.lut) == (1.8, (0.0, 0.5, 1.0))
    assert BenchTruth(mask=TruePanel(rise_s=0.0)).of(believed).mask == believed.mask
    scene = TrueScene(blur_px=2.0, ambient=0.25)
    true = BenchTruth(scene=scene, projector=TruePanel(rise_s=0.5)).of(believed)
    assert (true.mask.blur_px, true.scene.ambient, true.projector.rise_s) == (2.0, 0.25, 0.5)
    assert true.mask.lut == (0.0, 1.0) and true.trigger == believed.trigger


@pytest.mark.parametrize("table", ["projector", "mask", "trigger"])
@pytest.mark.parametrize("times", [1.0, 1.002, 1e300])
def test_times_in_another_unit_are_told(table: str, times: float) -> None:
    """Milliseconds in the place of seconds; and no number that arithmetic cannot bear."""
    name, most = ("lag_s", 60.0) if table == "trigger" else ("fall_s", 1.0)
    value = times * most
    old = getattr(Config(), table)
    config = msgspec.structs.replace(
        Config(), **{table: msgspec.structs.replace(old, **{name: value})}
    )
    told = [(f"{table}.{name}",)] if value > most else []
    assert keys(config) == told
    assert all(f"more than {most:g} seconds" in text for text in check_config(config))


@pytest.mark.parametrize(
    ("table", "key", "sound", "wrong"),
    [
        ("projector", "refresh_hz", (1e-3, 1e6), (1e-4, 1.1e6, 1e300)),
        ("mask", "refresh_hz", (1e-3, 1e6), (1e-4, 1.1e6, 1e300)),
        ("camera", "f_number", (1e-2, 1e4), (1e-300, 0.009, 1e300)),
    ],
)
def test_rates_and_apertures_that_no_device_has_are_told(
    table: str, key: str, sound: tuple[float, ...], wrong: tuple[float, ...]
) -> None:
    old = getattr(Config(), table)
    for value in (*sound, *wrong):
        changed = {table: msgspec.structs.replace(old, **{key: value})}
        found = keys(msgspec.structs.replace(Config(), **changed))
        assert found == ([(f"{table}.{key}",)] if value in wrong else [])
