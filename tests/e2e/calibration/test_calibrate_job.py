"""A calibration as a job: its folder, its use, and how it fails."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pdcd.bench import calibration as kept
from pdcd.bench.calibration import read_calibration
from pdcd.bench.choosing import find_newest_calibration
from pdcd.bench.config import load_config
from pdcd.bench.measured import apply_calibration
from pdcd.bench.origins import trace_origins
from pdcd.capture.again import recompute_calibration
from pdcd.cli.main import main
from pdcd.errors import DecodeError
from pdcd.protocol.events import StepEnded
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from pdcd.runs.verify_calibration import verify_calibration
from tests.taken import calibrate, started, take_with

pytestmark = pytest.mark.whole

BENCH = """
[rig]
name = "turned"
[projector]
size_px = [256, 192]
[mask]
size_px = [400, 300]
fall_s = 0.004
[camera]
profile = "450d"
frame_quads = [300, 200]
{camera}
[scene]
kind = "{scene}"
grid = [6, 8]
{options}
[bench]
truth = "truth.toml"
[server]
state_dir = "state"
"""
TRUTH = """
[mask.place]
turn_deg = 1.0
scale = 1.04
offset_px = [1.0, -2.0]
[camera.place]
scale = 1.08
"""


def bench(folder: Path, scene: str = "card", **parts: str) -> Path:
    """The file of a small mock bench that is not what it believes."""
    (folder / "truth.toml").write_text(TRUTH)
    path = folder / "bench.toml"
    filled = {"camera": "", "options": "", **parts}
    path.write_text(BENCH.format(scene=scene, **filled))
    return path


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, CaptureResult]]:
    """A bench that was calibrated once."""
    path = bench(tmp_path_factory.mktemp("bench"), scene="open-book")
    with started(load_config(path)) as engine:
        found = calibrate(engine, "geometry")
        result = found.result
        assert result.state == "done", result.error
        assert [e.step for e in found.heard if isinstance(e, StepEnded)] == ["meter", "geometry"]
        # It goes on by what it found, before its own scene again.
        assert engine._config.calibration.sha256 == result.manifest_sha256
        assert engine._rig.scene is not None and engine._rig.scene.name == "open-book"
        manifest = take_with(engine, "20260101T000001Z-0001", goal="white", codes=4).manifest
        assert manifest.config["calibration"]["sha256"] == result.manifest_sha256
        assert manifest.config["mask"]["place"]["map"]["residual"]
    yield path, result


def test_the_record_says_what_was_measured_and_how(done: tuple[Path, CaptureResult]) -> None:
    record, digest = read_calibration(Path(str(done[1].folder)))
    assert digest == done[1].manifest_sha256 and record.verdict != "bad"
    assert [step.name for step in record.steps] == ["meter", "geometry"]
    assert set(record.measured) == {
        "projector.place.map", "mask.place.map", "camera.place.map", "mask.offset_px",
        "projector.field_px", "camera.blur_quads",
    }  # fmt: skip
    photos = [photo for step in record.steps for photo in step.photos]
    assert len(photos) >= 7 and all(photo.iso == 100 and photo.f_number for photo in photos)
    assert record.identity.camera_model == "mock 450d" and record.identity.flip == 0


def test_it_is_whole_and_every_change_is_found(
    done: tuple[Path, CaptureResult], tmp_path: Path
) -> None:
    folder = Path(str(done[1].folder))
    found = verify_calibration(folder, manifest_sha256=done[1].manifest_sha256)
    assert found.whole and found.job == done[1].job, found
    rng = np.random.default_rng(1)
    copy = tmp_path / "copy"
    copied(folder, copy)
    for file in sorted(p for p in copy.rglob("*") if p.is_file()):
        data = bytearray(file.read_bytes())
        at = int(rng.integers(len(data)))
        data[at] ^= 1 << int(rng.integers(8))
        whole = file.read_bytes()
        file.write_bytes(data)
        assert not verify_calibration(copy).whole, (file, at)
        file.write_bytes(whole)
    assert verify_calibration(copy).whole
    (copy / "more").write_text("")
    assert [finding.what for finding in verify_calibration(copy).findings] == ["unknown"]


@pytest.mark.long
def test_it_is_computed_again_bit_for_bit(
    done: tuple[Path, CaptureResult], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(str(done[1].folder))
    report = recompute_calibration(folder)
    assert report.identical and "maps.npz" in {item.name for item in report.items}
    assert main(["calibrate", "--again", str(folder)]) == 0
    assert "DIFFERS" not in capsys.readouterr().out
    copy = tmp_path / "copy"
    copied(folder, copy)
    photo = next((copy / "raw").glob("geometry-dots-mask*"))
    data = bytearray(photo.read_bytes())
    data[-1] ^= 1
    photo.write_bytes(data)
    with pytest.raises(DecodeError):
        recompute_calibration(copy)


def test_a_script_reads_what_it_needs_from_the_last_line_and_the_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = bench(tmp_path), tmp_path / "elsewhere"
    words = ["--local", "--json", "--config", str(path)]
    assert main(["calibrate", "geometry", *words, "--out", str(out)]) == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    folder = Path(last["folder"])
    assert (last["state"], last["passed"], folder.parent) == ("done", True, out)
    config = json.loads((folder / kept.RECORD).read_text())["config"]
    assert config["camera"] == {"place": {"map": "maps.npz"}, "blur_quads": 0.0}
    assert config["mask"]["offset_px"] == [0.0, 0.0]
    # The next one with the same state folder goes by it, wherever it lies.
    assert apply_calibration(load_config(path)).calibration.use == str(folder)
    assert main(["capture", "white", "--codes", "4", *words]) == 0
    taken = json.loads(capsys.readouterr().out.splitlines()[-1])
    manifest = read_manifest(Path(taken["folder"]))
    assert manifest.config["calibration"]["sha256"] == last["manifest_sha256"]
    shutil.rmtree(folder)
    assert apply_calibration(load_config(path)).mask.place.map is None


def test_a_lens_cap_is_named_and_nothing_changes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = bench(tmp_path, options="options = {albedo = 1e-12}", camera="noise = 'full'")
    assert main(["calibrate", "geometry", "--local", "--json", "--config", str(path)]) == 5
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (last["state"], last["passed"]) == ("failed", False)
    assert last["error"]["kind"] == "calibration" and "lens cap" in last["error"]["hint"]
    folder = Path(last["folder"])
    assert folder.name.endswith(".partial")
    assert find_newest_calibration(folder.parent, load_config(path)) is None
    assert main(["calibrate", "geometry", "--out", str(tmp_path)]) == 2
    assert "--local" in capsys.readouterr().err


def copied(folder: Path, copy: Path) -> None:
    """A copy that may be written."""
    shutil.copytree(folder, copy)
    for path in copy.rglob("*"):
        path.chmod(0o700)


def test_measured_values_are_told_from_typed_ones_and_defaults(
    done: tuple[Path, CaptureResult],
) -> None:
    path, _ = done
    typed = load_config(path)
    used = apply_calibration(typed)
    assert used.mask.place.map is not None and typed.mask.place.map is None
    told = {o.key: o for o in trace_origins(path, typed)}
    assert told["mask.place"].how == "measured" and "by geometry" in told["mask.place"].words
    assert told["mask.fall_s"].how == "typed" and told["mask.rise_s"].how == "default"
