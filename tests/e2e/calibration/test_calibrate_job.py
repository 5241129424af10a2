"""A calibration as a job: its folder, its use, and how it fails."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from pdcd.bench import calibration as kept
from pdcd.bench.calibration import read_calibration
from pdcd.bench.choosing import CALIBRATIONS_FOLDER, find_newest_calibration
from pdcd.bench.config import load_config
from pdcd.bench.measured import apply_calibration
from pdcd.bench.origins import trace_origins
from pdcd.bench.tables import CalibrationConfig, Config
from pdcd.capture.again import recompute_calibration
from pdcd.capture.bench_check import find_calibration_doubts
from pdcd.capture.engine import Engine
from pdcd.capture.rig import Rig
from pdcd.cli.main import main
from pdcd.errors import ConfigError, DecodeError
from pdcd.protocol.events import Event, StepEnded
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from pdcd.runs.verify_calibration import verify_calibration

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
{more}
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
    filled = {"camera": "", "options": "", "more": "", **parts}
    path.write_text(BENCH.format(scene=scene, **filled))
    return path


def calibrate(engine: Engine, *steps: str, job: str = "20260101T000000Z-0001") -> CaptureResult:
    heard: list[Event] = []
    result = engine.calibrate(
        msgspec.convert({"steps": steps}, CalibrateRequest),
        job=job,
        emit=heard.append,
        cancelled=lambda: False,
    )
    assert [e.step for e in heard if isinstance(e, StepEnded)][1:] == (
        list(steps) if result.state == "done" else []
    )
    return result


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, CaptureResult]]:
    """A bench that was calibrated once."""
    path = bench(tmp_path_factory.mktemp("bench"), scene="open-book")
    engine = Engine.from_config(load_config(path))
    engine.start()
    try:
        result = calibrate(engine, "geometry")
        assert result.state == "done", result.error
        # It goes on by what it found, before its own scene again.
        assert engine._config.calibration.sha256 == result.manifest_sha256
        assert engine._rig.scene is not None and engine._rig.scene.name == "open-book"
        taken = engine.capture(
            CaptureRequest(goal="white", codes=4),
            job="20260101T000001Z-0001",
            emit=lambda _: None,
            cancelled=lambda: False,
        )
        assert taken.state == "done", taken.error
        manifest = read_manifest(Path(str(taken.folder)))
        assert manifest.config["calibration"]["sha256"] == result.manifest_sha256
        assert manifest.config["mask"]["place"]["map"]["residual"]
    finally:
        engine.stop()
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
    assert found.whole and found.job == "20260101T000000Z-0001", found
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


def test_one_that_failed_did_not_pass(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = bench(tmp_path, options="options = {albedo = 1e-12}")
    assert main(["calibrate", "geometry", "--local", "--json", "--config", str(path)]) == 5
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (last["state"], last["passed"]) == ("failed", False)
    assert main(["calibrate", "geometry", "--out", str(tmp_path)]) == 2
    assert "--local" in capsys.readouterr().err


def copied(folder: Path, copy: Path) -> None:
    """A copy that may be written."""
    shutil.copytree(folder, copy)
    for path in copy.rglob("*"):
        path.chmod(0o700)


def with_table(config: Config, **table: object) -> Config:
    return msgspec.structs.replace(config, calibration=msgspec.convert(table, CalibrationConfig))


def test_measured_values_stand_in_the_place_of_typed_ones(
    done: tuple[Path, CaptureResult],
) -> None:
    path, result = done
    typed = load_config(path)
    used = apply_calibration(typed)
    assert used.mask.place.map is not None and typed.mask.place.map is None
    assert used.mask.fall_s == 0.004 and apply_calibration(used) == used
    assert apply_calibration(with_table(typed, use="none")).mask.place.map is None
    kept_ = apply_calibration(with_table(typed, keep=["mask.place.map"]))
    assert kept_.mask.place.map is None and kept_.camera.place.map is not None
    by_path = apply_calibration(with_table(typed, use=str(result.folder)))
    assert by_path.mask.place == used.mask.place
    with pytest.raises(ConfigError, match="not the one with the digest"):
        apply_calibration(with_table(typed, sha256="0" * 64))
    told = {o.key: o for o in trace_origins(path, typed)}
    assert told["mask.place"].how == "measured" and "by geometry" in told["mask.place"].words
    assert told["mask.fall_s"].how == "typed" and told["mask.rise_s"].how == "default"


def test_one_of_another_bench_is_passed_over_or_refused(done: tuple[Path, CaptureResult]) -> None:
    path, result = done
    config = load_config(path)
    other = msgspec.structs.replace(
        config, mask=msgspec.structs.replace(config.mask, size_px=(800, 600))
    )
    assert apply_calibration(other) == other
    with pytest.raises(ConfigError, match=r"another bench: mask\.size_px"):
        apply_calibration(with_table(other, use=str(result.folder)))
    with pytest.raises(ConfigError, match="cannot be used"):
        apply_calibration(with_table(config, use=str(path.parent)))


def test_damaged_and_bad_ones_are_not_the_latest(
    done: tuple[Path, CaptureResult], tmp_path: Path
) -> None:
    config, folder = load_config(done[0]), Path(str(done[1].folder))
    record, _ = read_calibration(folder)

    def keep(name: str, verdict: str, line: bytes | None = None) -> Path:
        made = tmp_path / name
        made.mkdir()
        left_out = {"geometry": "bad"} if verdict == "bad" else {}
        told = msgspec.structs.replace(record, name=name, verdict=verdict, left_out=left_out)
        data = kept.encode_calibration(told)
        (made / kept.RECORD).write_bytes(data)
        (made / kept.CALIBRATION_DIGEST).write_bytes(line or kept.format_digest_line(data))
        return made

    good = keep("a", "doubtful")
    assert find_newest_calibration(tmp_path, config) == good
    bad = keep("b", "bad")
    assert (
        find_newest_calibration(tmp_path, config) == good
        and find_newest_calibration(tmp_path, config, bad=True) == bad
    )
    keep("c", "good", b"0" * 64 + b"  calibration.json\n")
    keep("d.partial", "good")
    assert find_newest_calibration(tmp_path, config) == good


def test_a_capture_says_that_a_check_after_its_calibration_was_bad(
    done: tuple[Path, CaptureResult],
) -> None:
    path, result = done
    folder = Path(str(result.folder))
    rig = Rig(apply_calibration(load_config(path)))
    assert not list(find_calibration_doubts(rig.config, rig, 100))
    record, _ = read_calibration(folder)
    later = folder.parent / "29990101T000000Z-0001"
    later.mkdir()
    data = kept.encode_calibration(msgspec.structs.replace(record, name=later.name, verdict="bad"))
    (later / kept.RECORD).write_bytes(data)
    (later / kept.CALIBRATION_DIGEST).write_bytes(kept.format_digest_line(data))
    try:
        (told,) = find_calibration_doubts(rig.config, rig, 100)
        assert later.name in told and "calibrate again" in told
        aged = msgspec.structs.replace(rig.config.calibration, max_age_days=1e-9, check="always")
        old = list(
            find_calibration_doubts(msgspec.structs.replace(rig.config, calibration=aged), rig, 100)
        )
        assert len(old) == 2 and "days old" in old[1]
    finally:
        shutil.rmtree(later)


def test_a_lens_cap_is_named_and_nothing_changes(tmp_path: Path) -> None:
    path = bench(tmp_path, options="options = {albedo = 1e-12}", camera="noise = 'full'")
    engine = Engine.from_config(load_config(path))
    engine.start()
    try:
        result = calibrate(engine, "geometry")
        assert result.state == "failed" and result.error is not None
        assert result.error["kind"] == "calibration" and "lens cap" in str(result.error["hint"])
        assert str(result.folder).endswith(".partial")
        assert engine._config.calibration.sha256 is None
    finally:
        engine.stop()
    assert (
        find_newest_calibration(tmp_path / "state" / CALIBRATIONS_FOLDER, load_config(path)) is None
    )


def test_no_step_of_that_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "geometri", "--local"]) == 2
    assert "steps are" in capsys.readouterr().err
