"""Verdicts in a lit room, steady or switched, and on a field that lies partly beside the mask."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import pdcd
from pdcd.bench.tables import (
    BenchConfig,
    CameraConfig,
    Config,
    LimitsConfig,
    PanelConfig,
    SceneConfig,
)
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import Quality
from tests.bench.captures import take_into

GRID = (12, 16)
QUADS = (96, 72)
CODED, BLACK = 7, 8
"""Exposures of such a run: two test exposures, a dark photo, white, two looks, codes, a dark
photo."""


def bright(folder: Path, room: float = 0.0, indirect: float = 0.3) -> SceneConfig:
    """Cells of random brightness up to the edges, which no light below zero would give away."""
    rng = np.random.default_rng(5)
    cells = GRID[0] * GRID[1]
    transport = indirect * rng.uniform(0.5, 1.0, (cells, cells)) / cells
    transport += np.diag(rng.uniform(0.5, 1.0, cells))
    np.savez(folder / "scene.npz", transport=transport, grid=np.array(GRID))
    return SceneConfig(kind="matrix", path=str(folder / "scene.npz"), ambient=room)


class Judged(NamedTuple):
    """error : RMS of the known quads, over the truth. scaled : of means over cells, one common
    factor apart. covered : share of these whose sigma covers the truth."""

    quality: Quality
    error: float
    scaled: float
    covered: float


def judged(
    folder: Path, scene: SceneConfig, truth: str, codes: int = 128, parts: int = 1
) -> Judged:
    """A plain capture against the bench's own truth."""
    (folder / "truth.toml").write_text(truth)
    config = Config(
        projector=PanelConfig(size_px=(256, 192)),
        mask=PanelConfig(size_px=(320, 240)),
        scene=scene,
        camera=CameraConfig(frame_quads=QUADS),
        bench=BenchConfig(truth=str(folder / "truth.toml")),
        limits=LimitsConfig(min_free_bytes=0),
    )
    request = CaptureRequest(goal="indirect", codes=codes, pilot=0, parts=parts, window="quarter")
    result, taken = take_into(folder, config, request)
    run, quality = pdcd.open(taken), result.summary["quality"]
    assert run.truth is not None and isinstance(quality, Quality)
    known = np.isfinite(run.sigma) & np.isfinite(run.truth)
    found, true, bars = run.image[known], run.truth[known], run.sigma[known]
    scale = float(found @ true / (found @ found))
    error = float(np.sqrt(np.sum((scale * found - true) ** 2) / np.sum(true**2)))
    quads = result.summary["rms_error_quads"]
    assert isinstance(quads, float)
    return Judged(quality, quads, error, float(np.mean(np.abs(found - true) <= 1.96 * bars)))


@pytest.mark.parametrize("room", [0.02, 0.05, 0.2])
def test_a_steady_room_is_good_up_to_a_twentieth_of_white(tmp_path: Path, room: float) -> None:
    scene = SceneConfig(kind="milky-bottle", grid=GRID)
    quality, error, _, covered = judged(tmp_path, scene, f"[scene]\nambient = {room}\n")
    assert error < 0.05 and covered > 0.9
    if room <= 0.05:
        assert (quality.verdict, quality.reasons) == ("good", ())
    else:
        assert quality.verdict == "doubtful"
        assert "room's light is" in quality.reasons[0] and "darken the room" in quality.reasons[0]


@pytest.mark.parametrize(
    ("before", "after", "photo"),
    [(0.0, 0.02, BLACK), (0.0, 0.15, BLACK), (0.02, 0.0, BLACK), (0.2, 0.0, CODED)],
)
def test_a_room_that_is_switched_amid_the_run_is_not_good(
    tmp_path: Path, before: float, after: float, photo: int
) -> None:
    truth = f"[scene]\nambient = {after}\nambient_from = {photo}\n"
    quality, _, scaled, _ = judged(tmp_path, bright(tmp_path, before), truth, 64)
    assert quality.verdict != "good"
    assert any("was not the same before and after" in reason for reason in quality.reasons)
    assert quality.verdict == "doubtful" or scaled > 0.03


@pytest.mark.parametrize(
    ("before", "photo"), [*((0.0, k) for k in range(2, 15)), *((0.02, k) for k in (11, 13, 17))]
)
def test_a_room_that_is_switched_on_after_any_photo_of_parts_is_not_good(
    tmp_path: Path, before: float, photo: int
) -> None:
    """Two test exposures, a dark photo, white, two looks, a part, a dark photo, three parts, a dark
    photo; a run that sees the room, as those do that begin in a lit one, adds black exposures."""
    truth = f"[scene]\nambient = {before + 0.03}\nambient_from = {photo}\n"
    quality, error, _, _ = judged(tmp_path, bright(tmp_path, before), truth, 64, parts=4)
    assert quality.verdict == "doubtful" or error < 0.03


def test_all_pictures_of_a_direct_run_in_a_lit_room_share_one_scale(tmp_path: Path) -> None:
    """The room is no error of direct light worth black exposures; without them it was in the white
    photo once and in the indirect one twice. The matrix itself says how much light there is."""
    scene = bright(tmp_path, 0.0)
    truth = "[scene]\nambient = 0.006\n[projector]\ncontrast = 2000.0\n"
    (tmp_path / "truth.toml").write_text(truth)
    config = Config(
        projector=PanelConfig(size_px=(256, 192), contrast=130.0),  # as found in such a room
        mask=PanelConfig(size_px=(320, 240), contrast=300.0),
        scene=scene,
        camera=CameraConfig(frame_quads=QUADS),
        bench=BenchConfig(truth=str(tmp_path / "truth.toml")),
        limits=LimitsConfig(min_free_bytes=0),
    )
    request = CaptureRequest(goal="direct", codes=64, pilot=0, parts=1, window="quarter")
    run = pdcd.open(take_into(tmp_path, config, request)[1])
    assert run.manifest.run.how.black_level == "mask"
    transport = np.load(tmp_path / "scene.npz")["transport"]
    direct, white = np.trace(transport), transport.sum()
    scales = {}
    for name, light in (("white", white), ("indirect", white - direct), ("direct", direct)):
        picture = run.decode(progress=False).pictures[name]
        known = np.isfinite(picture.sigma)
        scales[name] = float(picture.image[known].mean() / light * GRID[0] * GRID[1])
    assert scales["indirect"] / scales["white"] == pytest.approx(1.0, abs=0.005)
    assert scales["direct"] / scales["white"] == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize("place", ["offset_px = [4.0, 0.0]", "turn_deg = 2.0"])
def test_a_field_beside_the_mask_is_unknown_there(tmp_path: Path, place: str) -> None:
    """No light comes from there: quads that lack it would err by all of it."""
    quality, error, _, covered = judged(
        tmp_path, bright(tmp_path, 0.0, 1.0), f"[mask.place]\n{place}\n"
    )
    assert error < 0.05 and covered > 0.95
    assert quality.verdict == "doubtful"
    assert any("lies beside the mask's picture" in reason for reason in quality.reasons)


@pytest.mark.parametrize("photo", [4, CODED])
@pytest.mark.parametrize("stretch", [1.5, 5.0])
def test_a_stretched_exposure_is_taken_again(tmp_path: Path, photo: int, stretch: float) -> None:
    truth = f"[trigger]\nstretched = {photo}\nstretch = {stretch}\n"
    quality, error, _, _ = judged(tmp_path, bright(tmp_path), truth)
    assert error < 0.05
    assert quality.verdict != "bad"


def test_files_that_tell_a_fraction_of_the_exposure_are_doubtful(tmp_path: Path) -> None:
    quality, _, _, _ = judged(tmp_path, bright(tmp_path), "[camera]\ntagged_s = 0.005\n")
    assert quality.verdict == "doubtful"
    assert "the camera says 0.005 s" in quality.reasons[0]
