"""Verdicts in a lit room, steady or switched, and on a field that lies partly beside the mask."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

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
from pdcd.protocol.result import Quality
from tests.bench_rig import bright_scene
from tests.taken import Taken, take

pytestmark = pytest.mark.whole

Grid = tuple[int, int]

COARSE, FINE = (6, 8), (12, 16)
"""Of a coarse grid nobody looks where the panels lie: that is two photos less."""
CODED, BLACK = 5, 6
"""Exposures on a coarse grid: two test exposures, a dark photo, white, codes, a dark photo."""


def taken(
    folder: Path, scene: SceneConfig, truth: str, grid: Grid = COARSE, *,
    contrasts: tuple[float | None, float | None] = (None, None), **asked: Any,
) -> Taken:  # fmt: skip
    """A capture of a bench that really is as `truth` says; 16 px of the projector to a cell."""
    (folder / "truth.toml").write_text(truth)
    rows, cols = grid
    config = Config(
        projector=PanelConfig(size_px=(16 * cols, 16 * rows), contrast=contrasts[0]),
        mask=PanelConfig(size_px=(20 * cols, 20 * rows), contrast=contrasts[1]),
        scene=scene,
        camera=CameraConfig(frame_quads=(6 * cols, 6 * rows)),
        bench=BenchConfig(truth=str(folder / "truth.toml")),
        limits=LimitsConfig(min_free_bytes=0),
    )
    once: dict[str, Any] = {
        "codes": 128,
        "pilot": 0,
        "parts": 1,
        "window": "quarter",
        "out": str(folder),
    }
    return take(config, **{**once, **asked})


class Judged(NamedTuple):
    """error : RMS of the known quads, over the truth. scaled : of means over cells, one common
    factor apart. covered : share of these whose sigma covers the truth."""

    quality: Quality
    error: float
    scaled: float
    covered: float


def judged(made: Taken) -> Judged:
    """A capture against the bench's own truth."""
    run = pdcd.open(made.folder)
    assert run.truth is not None
    known = np.isfinite(run.sigma) & np.isfinite(run.truth)
    found, true, bars = run.image[known], run.truth[known], run.sigma[known]
    scale = float(found @ true / (found @ found))
    error = float(np.sqrt(np.sum((scale * found - true) ** 2) / np.sum(true**2)))
    covered = float(np.mean(np.abs(found - true) <= 1.96 * bars))
    return Judged(made.quality, made.error, error, covered)


@pytest.mark.parametrize("room", [0.05, 0.2])
def test_a_steady_room_is_good_up_to_a_twentieth_of_white(tmp_path: Path, room: float) -> None:
    scene = SceneConfig(kind="milky-bottle", grid=FINE)
    found = judged(taken(tmp_path, scene, f"[scene]\nambient = {room}\n", FINE, parts=4))
    assert found.error < 0.05 and found.covered > 0.9
    if room <= 0.05:
        assert (found.quality.verdict, found.quality.reasons) == ("good", ())
    else:
        assert found.quality.verdict == "doubtful"
        assert "room's light is" in found.quality.reasons[0]
        assert "darken the room" in found.quality.reasons[0]


@pytest.mark.parametrize(
    ("before", "after", "photo"),
    [(0.0, 0.02, BLACK), (0.0, 0.15, BLACK), (0.02, 0.0, BLACK), (0.2, 0.0, CODED)],
)
def test_a_room_that_is_switched_amid_the_run_is_not_good(
    tmp_path: Path, before: float, after: float, photo: int
) -> None:
    truth = f"[scene]\nambient = {after}\nambient_from = {photo}\n"
    found = judged(taken(tmp_path, bright_scene(tmp_path, COARSE, before), truth, codes=64))
    assert found.quality.verdict != "good"
    assert any("changed between the dark photos" in text for text in found.quality.reasons)
    assert found.quality.verdict == "doubtful" or found.scaled > 0.03


@pytest.mark.parametrize(
    ("grid", "before", "photo"),
    [
        *((COARSE, 0.0, photo) for photo in (2, 3, 4, 5, 6, 8, 9, 10)),
        *((COARSE, 0.02, photo) for photo in (9, 11, 15)),
        *((FINE, 0.0, photo) for photo in (5, 6)),  # the looks
    ],
)
def test_a_room_that_is_switched_on_after_any_photo_of_parts_is_not_good(
    tmp_path: Path, grid: Grid, before: float, photo: int
) -> None:
    """Two test exposures, a dark photo, white, two looks on a fine grid, a part, a dark photo,
    three parts, a dark photo; a run that sees the room, as those do that begin in a lit one, adds
    black exposures."""
    truth = f"[scene]\nambient = {before + 0.03}\nambient_from = {photo}\n"
    made = taken(tmp_path, bright_scene(tmp_path, grid, before), truth, grid, codes=64, parts=4)
    assert made.quality.verdict == "doubtful" or made.error < 0.03


def test_all_pictures_of_a_direct_run_in_a_lit_room_share_one_scale(tmp_path: Path) -> None:
    """The room is no error of direct light worth black exposures; without them it was in the white
    photo once and in the indirect one twice. The matrix itself says how much light there is."""
    truth = "[scene]\nambient = 0.006\n[projector]\ncontrast = 2000.0\n"
    made = taken(
        tmp_path, bright_scene(tmp_path, COARSE), truth, goal="direct", codes=64,
        contrasts=(130.0, 300.0),  # as found in such a room
    )  # fmt: skip
    assert made.manifest.run.how.black_level == "mask"
    transport = np.load(tmp_path / "scene.npz")["transport"]
    direct, white = np.trace(transport), transport.sum()
    pictures = pdcd.open(made.folder).decode(progress=False).pictures
    scales = {}
    for name, light in (("white", white), ("indirect", white - direct), ("direct", direct)):
        known = np.isfinite(pictures[name].sigma)
        scales[name] = float(pictures[name].image[known].mean() / light * len(transport))
    assert scales["indirect"] / scales["white"] == pytest.approx(1.0, abs=0.005)
    assert scales["direct"] / scales["white"] == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize(
    "place", ["offset_px = [4.0, 0.0]", pytest.param("turn_deg = 2.0", marks=pytest.mark.long)]
)
def test_a_field_beside_the_mask_is_unknown_there(tmp_path: Path, place: str) -> None:
    """No light comes from there: quads that lack it would err by all of it."""
    scene = bright_scene(tmp_path, FINE, 0.0, 1.0)
    found = judged(taken(tmp_path, scene, f"[mask.place]\n{place}\n", FINE))
    assert found.error < 0.05 and found.covered > 0.95
    assert found.quality.verdict == "doubtful"
    assert any("lies outside the mask's picture" in reason for reason in found.quality.reasons)


@pytest.mark.parametrize(("photo", "stretch"), [(4, 5.0), (CODED, 1.5), (CODED, 5.0)])
def test_a_stretched_exposure_is_taken_again(tmp_path: Path, photo: int, stretch: float) -> None:
    truth = f"[trigger]\nstretched = {photo}\nstretch = {stretch}\n"
    made = taken(tmp_path, bright_scene(tmp_path, COARSE), truth)
    assert any("discarded" in name for name in made.result.files)
    assert made.error < 0.05 and made.quality.verdict != "bad"


def test_files_that_tell_a_fraction_of_the_exposure_are_doubtful(tmp_path: Path) -> None:
    made = taken(tmp_path, bright_scene(tmp_path, COARSE), "[camera]\ntagged_s = 0.005\n")
    assert made.quality.verdict == "doubtful"
    assert "the camera reports 0.005 s" in made.quality.reasons[0]
