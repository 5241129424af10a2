"""What a mock bench really is: the file of its truth, and what is refused in it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from pdcd.bench import config
from pdcd.bench.grey import curve_of
from pdcd.bench.placed import panels_of
from pdcd.bench.reading import read_toml
from pdcd.bench.tables import BenchConfig, Config
from pdcd.bench.truth import BenchTruth, load_bench_truth, read_bench_truth

EXAMPLE = Path(__file__).parents[3] / "config" / "truth.toml"


def told(folder: Path, text: str) -> list[str]:
    """All faults of a truth."""
    path = folder / "truth.toml"
    path.write_text(text)
    return [fault.message for fault in read_bench_truth(path, Config())[1]]


def test_without_a_file_all_is_as_believed() -> None:
    assert load_bench_truth(Config()) == BenchTruth()
    assert BenchTruth().of(Config()) == Config()


def test_the_example_is_sound_and_changes_what_it_says() -> None:
    believed = Config(bench=BenchConfig(truth=str(EXAMPLE)))
    truth, faults = read_bench_truth(EXAMPLE, believed)
    assert faults == []
    true = truth.of(believed)
    assert (true.projector.rise_s, true.mask.place.turn_deg) == (0.0015, 181.3)
    assert true.mask.refresh_hz == believed.mask.refresh_hz
    assert true.scene.ambient == 0.01
    assert (true.trigger.lag_s, true.trigger.jitter_s) == (0.116, 0.003)
    assert panels_of(true) != panels_of(believed)


def test_the_example_names_every_table_and_key() -> None:
    given = read_toml(EXAMPLE, "it", "")
    left_out = {"phase_s", "jitter_s", "contrast", "offset_px", "dead_rows", "dead_columns"}
    left_out |= {"samples", "blur_taps", "dark", "full_well", "scan_bands", "falloff"}
    left_out |= {"responsivity_e", "lut", "tagged_s", "ambient_from", "stretched", "stretch"}
    left_out |= {"stops", "clipped"}
    for table in msgspec.structs.fields(BenchTruth):
        known = {f.name for f in msgspec.structs.fields(type(getattr(BenchTruth(), table.name)))}
        assert set(given[table.name]) <= known <= set(given[table.name]) | left_out


def test_a_panel_of_limited_range_shows_levels_beyond_it_as_black_and_white(tmp_path: Path) -> None:
    (tmp_path / "truth.toml").write_text("[mask]\nclipped = [16, 235]\ngamma = 2.0\n")
    believed = Config(bench=BenchConfig(truth=str(tmp_path / "truth.toml")))
    true = load_bench_truth(believed).of(believed)
    curve = curve_of(true.mask)
    assert curve is not None and true.projector.lut is None
    light = curve.light
    assert (light[:17] == 0.0).all() and (light[235:] == 1.0).all()
    # Gamma comes after it, in steps of 8 bits.
    levels = np.arange(17, 235)
    assert light[levels] == pytest.approx(((levels - 16) / 219) ** 2, abs=2e-5)


def test_a_truth_lies_beside_its_configuration(tmp_path: Path) -> None:
    (tmp_path / "truth.toml").write_text("[mask]\nrise_s = 0.5\n")
    (tmp_path / "rig.toml").write_text('[bench]\ntruth = "truth.toml"\n')
    loaded = config.load_config(tmp_path / "rig.toml")
    assert load_bench_truth(loaded).of(loaded).mask.rise_s == 0.5


def test_all_faults_are_told_at_once(tmp_path: Path) -> None:
    faults = told(
        tmp_path,
        """
        [mask]
        rise_ms = 4.0
        fall_s = -1.0
        dead_rows = [1200]
        clipped = [235, 16]
        contrast = 0.5
        scan_s = 0.2
        place = { homography = [1, 0, 0, 0, 1, 0, 0, 0, 0] }
        [projector]
        gamma = 0.0
        offset_px = [1.0, 0.0]
        [camera]
        blurr = 1.0
        [scene]
        blur_taps = 4
        [sensor]
        prnu = 2.0
        [lens]
        f = 1.0
        """,
    )
    words = [
        "mask.rise_ms: no such key; is rise_s meant?",
        "mask.fall_s:",
        "mask.dead_rows: lines are counted 0 to 1199",
        "mask.clipped: black lies below white",
        "mask.contrast: white over black exceeds 1",
        "mask.scan_s: rows that are set 0.2 s apart",
        "mask.place: the map of the mask",
        "projector.gamma:",
        "projector.offset_px: the mask is offset",
        "camera.blurr: no such key",
        "scene.blur_taps: must be odd",
        "sensor.prnu:",
        "lens: no such key",
    ]
    for word in words:
        assert sum(fault.startswith(word) for fault in faults) == 1, (word, faults)
    assert len(faults) == len(words)


def test_rows_and_blur_are_as_believed_where_nothing_is_said(tmp_path: Path) -> None:
    """They are words of the configuration, too; the truth has its own for what it changes."""
    replace = msgspec.structs.replace
    base = Config()
    base = replace(
        base,
        mask=replace(base.mask, scan_s=0.009, scan_bands=5, blur_px=0.7),
        projector=replace(base.projector, scan_s=-0.004),
    )
    (tmp_path / "none.toml").write_text("[camera]\nsamples = 2\n")
    (tmp_path / "said.toml").write_text(
        "[mask]\nscan_s = 0.0\n[projector]\nscan_bands = 3\n[scene]\nblur_px = 1.5\n"
    )
    believed, said = (
        read_bench_truth(tmp_path / name, base)[0].of(base) for name in ("none.toml", "said.toml")
    )
    assert believed == base
    assert (said.mask.scan_s, said.mask.scan_bands, said.mask.blur_px) == (0.0, 5, 1.5)
    assert (said.projector.scan_s, said.projector.scan_bands) == (-0.004, 3)
