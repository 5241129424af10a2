"""Plain captures in ambient light: mirrors are found all the same, and its noise is averaged."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, LimitsConfig, SceneConfig, ServerConfig
from pdcd.capture.engine import Engine
from pdcd.capture.salvage import decode_partial
from pdcd.pages.report.write import write_report as write_report
from pdcd.pictures.decode import decode_folder
from pdcd.protocol.events import Event, ShotArmed
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, Quality
from pdcd.runs.folder import read_manifest
from pdcd.runs.record import Manifest
from pdcd.runs.verify import verify_run
from tests.sampled import sampled

GRID = (24, 32)


def bench(folder: Path, scene: str, ambient: float, **camera: Any) -> Config:
    return Config(
        scene=SceneConfig(kind=scene, grid=GRID, ambient=ambient),
        camera=CameraConfig(**camera),
        limits=LimitsConfig(min_free_bytes=0),
        server=ServerConfig(state_dir=str(folder / "state")),
    )


def take(config: Config, shots: int = 10_000, **fields: Any) -> tuple[CaptureResult, float]:
    """Capture, cancelled after so many exposures; and the RMS error of the picture over the RMS of
    what the scene's own transport makes of full light (NaN of a run without one)."""
    armed = []

    def emit(event: Event) -> None:
        if isinstance(event, ShotArmed):
            armed.append(event)

    engine = Engine.from_config(config)
    engine.start()
    try:
        request = CaptureRequest(**{"goal": "indirect", **fields})
        result = engine.capture(request, job="job", emit=emit, cancelled=lambda: len(armed) > shots)
    finally:
        engine.stop()
    scene = engine._rig.scene
    assert result.folder is not None and scene is not None, result.error
    if result.state != "done":
        return result, float("nan")
    with np.load(Path(result.folder) / "probe.npz", allow_pickle=False) as data:
        image = data["image"]
    truth = scene.split()[1].reshape(image.shape)
    return result, float(np.sqrt(np.mean((image - truth) ** 2) / np.mean(truth**2)))


def manifest_of(result: CaptureResult) -> Manifest:
    assert result.folder is not None
    return read_manifest(Path(result.folder))


def decided(result: CaptureResult) -> str:
    text = result.summary["decided"]
    assert isinstance(text, str)
    return text


@pytest.mark.parametrize("scene", sampled(["mirror-and-vase", "disco-ball"], 2))
def test_ambient_light_hides_no_mirror(scene: str, tmp_path: Path) -> None:
    """Without noise: before, the pilot ended, and codes met the paths of the mirror."""
    result, error = take(bench(tmp_path, scene, 0.3, noise="none"))
    run = manifest_of(result).run
    assert run.how.pilot == 16 and run.how.late and run.dark is not None
    assert error < 0.003
    assert "sharp paths, which are kept apart" in decided(result)
    assert any("it goes on, as ambient light had hidden" in text for text in result.warnings)
    # The codes that were shown before are no shots, but lie there.
    names = [shot.name for shot in run.shots]
    assert "coded" not in names and "coded-late" in names and "raw/coded.dng" in result.files


def test_a_run_that_went_on_is_whole_and_decoded_bit_for_bit(tmp_path: Path) -> None:
    result, error = take(bench(tmp_path, "mirror-and-vase", 0.3))
    assert result.folder is not None and error < 0.02
    folder = Path(result.folder)
    assert verify_run(folder).whole
    assert decode_folder(folder).identical
    assert write_report(folder).exists()
    plan = manifest_of(result).plan
    shots = sum(shot["exposures"] for shot in plan["shots"])
    assert shots == plan["raw_files"] == result.summary["shots"]
    sigma = result.summary["rms_sigma"]
    assert isinstance(sigma, float) and 0.7 < sigma / error < 1.5


def test_an_open_book_in_ambient_light_is_averaged(tmp_path: Path) -> None:
    """Before: 5.6 %."""
    result, error = take(bench(tmp_path, "open-book", 0.3))
    manifest = manifest_of(result)
    assert error < 0.02
    times = manifest.plan["leaks"]["times"]
    assert times > 5 and manifest.run.how.parts == 6 * times
    assert manifest.plan["leaks"]["noise"] == pytest.approx(error, rel=0.15)
    assert f"{times} times as many exposures" in decided(result)
    assert not any("darken the room" in text for text in result.warnings)
    # Of all its exposures the verdict names the one with most light that was not asked for.
    quality = result.summary["quality"]
    assert isinstance(quality, Quality)
    (stray,) = (text for text in quality.reasons if "stray light" in text)
    assert "room's light is 41" in stray
    assert result.folder is not None and decode_folder(Path(result.folder)).identical


def test_what_is_too_bright_for_that_is_said(tmp_path: Path) -> None:
    result, error = take(bench(tmp_path, "open-book", 1.0, readout_s=3.0))
    leaks = manifest_of(result).plan["leaks"]
    assert leaks["noise"] > 0.02 and leaks["noise"] == pytest.approx(error, rel=0.3)
    assert any("darken the room" in text for text in result.warnings)


def test_a_dark_bench_keeps_every_bit(tmp_path: Path) -> None:
    """All pictures are those without a look, and nothing is decided about light. In one exposure:
    then the dark photo comes last, and noise is the same."""
    config = bench(tmp_path, "mirror-and-vase", 0.0, readout_s=1.0)
    plain, _ = take(config, black_level="none", out=str(tmp_path / "plain"))
    result, _ = take(config, out=str(tmp_path / "looked"))
    one, other = manifest_of(plain), manifest_of(result)
    assert other.run.how == one.run.how and other.run.dark is None
    for name in plain.files:
        if name.startswith("linear/"):
            assert other.files[name].sha256 == one.files[name].sha256
    assert result.summary["shots"] == plain.summary["shots"]
    assert "noise" not in decided(result) and "darken" not in " ".join(result.warnings)


def test_of_an_interrupted_run_what_came_before_is_left_out(tmp_path: Path) -> None:
    config = bench(tmp_path, "mirror-and-vase", 0.3, f_number=8.0)
    result, _ = take(config, shots=40)
    assert result.state == "cancelled" and result.folder is not None
    partial = Path(result.folder)
    found = decode_partial(partial)
    made = read_manifest(Path(found.folder))
    assert found.state == "partial" and made.run.how.late
    names = {shot.name for shot in made.run.shots}
    assert "coded-1" not in names and {"coded-1-late", "pilot-0016"} <= names
    # Without the photo of the ambient light the map is made with it.
    shutil.rmtree(found.folder)
    (partial / "raw" / "look-ambient.dng").unlink()
    again = decode_partial(partial)
    assert any("look-ambient" in text for text in again.lost)
    assert read_manifest(Path(again.folder)).run.dark is None
