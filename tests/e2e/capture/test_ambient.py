"""Plain captures in ambient light: mirrors are found all the same, and its noise is averaged."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, LimitsConfig, SceneConfig, ServerConfig
from pdcd.capture.salvage import decode_partial
from pdcd.pages.report.write import write_report
from pdcd.protocol.events import Event, ShotArmed
from pdcd.runs.folder import read_manifest
from pdcd.runs.verify import verify_run
from tests.taken import Taken, request_of, started, take

pytestmark = pytest.mark.whole

Grid = tuple[int, int]

COARSE, FINE = (12, 16), (24, 32)


def bench(folder: Path, scene: str, ambient: float, grid: Grid = COARSE, **camera: Any) -> Config:
    return Config(
        scene=SceneConfig(kind=scene, grid=grid, ambient=ambient),
        camera=CameraConfig(**camera),
        limits=LimitsConfig(min_free_bytes=0),
        server=ServerConfig(state_dir=str(folder / "state")),
    )


def off(made: Taken) -> float:
    """RMS error of the picture over the RMS of what the scene's own transport makes of full
    light."""
    scene = made.engine._rig.scene
    assert scene is not None
    truth = scene.split()[1].reshape(made.image.shape)
    return float(np.sqrt(np.mean((made.image - truth) ** 2) / np.mean(truth**2)))


def check_that_it_went_on(made: Taken) -> None:
    """Before, the pilot ended, and codes met the paths of the mirror."""
    run = made.manifest.run
    assert run.how.pilot == 16 and run.how.late and run.dark is not None
    assert "sharp paths, which are kept apart" in str(made.summary["decided"])
    assert any("it goes on, as ambient light had hidden" in text for text in made.warnings)
    # The codes that were shown before are no shots, but lie there.
    names = [shot.name for shot in run.shots]
    assert "coded" not in names and "coded-late" in names and "raw/coded.dng" in made.result.files


@pytest.mark.long
@pytest.mark.parametrize("scene", ["mirror-and-vase", "disco-ball"])
def test_ambient_light_hides_no_mirror(scene: str, tmp_path: Path) -> None:
    """Without noise: in one exposure, and down to what rounding leaves."""
    made = take(bench(tmp_path, scene, 0.3, FINE, noise="none"))
    check_that_it_went_on(made)
    assert off(made) < 0.003


def test_a_run_that_went_on_is_whole_and_decoded_bit_for_bit(tmp_path: Path) -> None:
    made = take(bench(tmp_path, "mirror-and-vase", 0.3))
    run = made.manifest.run
    assert run.how.pilot == 16 and run.how.late and run.dark is not None
    assert any("it goes on, as ambient light had hidden" in text for text in made.warnings)
    error = off(made)
    assert error < 0.02
    assert verify_run(made.folder).whole and made.decodes_the_same()
    assert write_report(made.folder).exists()
    plan = made.manifest.plan
    shots = sum(shot["exposures"] for shot in plan["shots"])
    assert shots == plan["raw_files"] == made.summary["shots"]
    assert 0.7 < made.summary["rms_sigma"] / error < 1.5


def test_an_open_book_in_ambient_light_is_averaged(tmp_path: Path) -> None:
    """Before: 5.6 %."""
    made = take(bench(tmp_path, "open-book", 0.3, FINE))
    error, leaks = off(made), made.manifest.plan["leaks"]
    times = leaks["times"]
    assert error < 0.02 and times > 5 and made.manifest.run.how.parts == 6 * times
    assert leaks["noise"] == pytest.approx(error, rel=0.15)
    assert f"{times} times as many exposures" in str(made.summary["decided"])
    assert not any("darken the room" in text for text in made.warnings)
    # Of all its exposures the verdict names the one with most light that was not asked for.
    (stray,) = (text for text in made.quality.reasons if "stray light" in text)
    assert "room's light is 41" in stray
    assert made.decodes_the_same()


def test_what_is_too_bright_for_that_is_said(tmp_path: Path) -> None:
    made = take(bench(tmp_path, "open-book", 1.0, readout_s=3.0))
    noise = made.manifest.plan["leaks"]["noise"]
    assert noise > 0.02 and noise == pytest.approx(off(made), rel=0.3)
    assert any("darken the room" in text for text in made.warnings)


def test_a_dark_bench_keeps_every_bit(tmp_path: Path) -> None:
    """All pictures are those without a look, and nothing is decided about light. In one exposure:
    then the dark photo comes last, and noise is the same."""
    config = bench(tmp_path, "mirror-and-vase", 0.0, readout_s=1.0)
    plain = take(config, black_level="none", out=str(tmp_path / "plain"))
    looked = take(config, out=str(tmp_path / "looked"))
    one, other = plain.manifest, looked.manifest
    assert other.run.how == one.run.how and other.run.dark is None
    for name in (name for name in plain.result.files if name.startswith("linear/")):
        assert other.files[name].sha256 == one.files[name].sha256
    assert looked.summary["shots"] == plain.summary["shots"]
    assert "noise" not in str(looked.summary["decided"])
    assert "darken" not in " ".join(looked.warnings)


def test_of_an_interrupted_run_what_came_before_is_left_out(tmp_path: Path) -> None:
    armed: list[Event] = []

    def emit(event: Event) -> None:
        if isinstance(event, ShotArmed):
            armed.append(event)

    with started(bench(tmp_path, "mirror-and-vase", 0.3, f_number=8.0)) as engine:
        result = engine.capture(
            request_of(), job="job", emit=emit, cancelled=lambda: len(armed) > 40
        )
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
