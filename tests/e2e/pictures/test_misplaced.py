"""The look at both panels on whole captures: sound benches, and such that lie elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from drivers.mock.display import MockDisplay
from pdcd.bench.tables import (
    BenchConfig,
    CameraConfig,
    Config,
    LimitsConfig,
    PanelConfig,
    SceneConfig,
)
from pdcd.errors import ConfigError
from pdcd.panels.frames import Frames
from pdcd.panels.placing import Placing
from pdcd.pictures.lost_direct import estimate_lost_direct
from pdcd.pictures.misplaced import measure_misplacement
from tests.taken import Taken, take

pytestmark = pytest.mark.whole

SIZE_PX = (256, 192)
QUADS = (96, 72)
QUAD_PX = SIZE_PX[0] / QUADS[0]
FREE = LimitsConfig(min_free_bytes=0)


def taken(folder: Path, truth: str, kind: str = "milky-bottle") -> Taken:
    """Of a bench that really is as `truth` says, and is believed to fill the field. Cells have
    16 px, of which quarter windows leave 4 on each side."""
    (folder / "truth.toml").write_text(truth)
    config = Config(
        projector=PanelConfig(size_px=SIZE_PX),
        mask=PanelConfig(size_px=(320, 240)),
        scene=SceneConfig(kind=kind, grid=(12, 16)),
        camera=CameraConfig(frame_quads=QUADS),
        bench=BenchConfig(truth=str(folder / "truth.toml")),
        limits=FREE,
    )
    return take(config, codes=64, pilot=0, parts=4, window="quarter", out=str(folder))


@pytest.mark.parametrize(
    "kind", ["mirror-and-vase", pytest.param("still-life", marks=pytest.mark.long)]
)
def test_panels_that_lie_right_are_not_accused_by_few_quads(tmp_path: Path, kind: str) -> None:
    """Three quads to a block, and eighteen blocks: a turn of a tenth of a degree is what they err,
    and error bars have none of it."""
    config = Config(
        projector=PanelConfig(size_px=(512, 384)),
        mask=PanelConfig(size_px=(800, 600)),
        scene=SceneConfig(kind=kind, grid=(18, 24)),
        camera=CameraConfig(frame_quads=(72, 54)),
        limits=FREE,
    )
    made = take(config, codes=16, pilot=0, parts=1, window="quarter", out=str(tmp_path))
    record = made.manifest.run
    assert record.panels is not None and record.panels.mask is not None
    assert estimate_lost_direct(record, "whole").rms < 1e-3
    assert not any("lies" in reason for reason in made.quality.reasons)


def place(device: str, keys: str) -> str:
    return f"[{device}.place]\n{keys}\n"


MIRRORED = 'flip = "horizontal"'
MASK, CAMERA = "the mask's picture", "the camera's view"
WRONG = ("doubtful", "bad")
CASES = [
    # What really is, grades, what is said of it; device, flip, turn, right and down as found.
    ("", ("good",), "", ("mask", "none", 0.0, (0.0, 0.0))),
    (place("mask", "offset_px = [-6.0, 5.0]"), WRONG, f"{MASK} lies",
     ("mask", "none", 0.0, (-6.0, 5.0))),
    (place("mask", "offset_px = [-28.0, 28.0]"), ("bad",), MASK,
     ("mask", "none", 0.0, (-28.0, 28.0))),
    (place("mask", "turn_deg = 5.0"), WRONG, f"{MASK} is turned clockwise by",
     ("mask", "none", 5.0, (0.0, 0.0))),
    (place("mask", MIRRORED), ("bad",), f"{MASK} is mirrored left to right",
     ("mask", "horizontal", 0.0, (0.0, 0.0))),
    (place("camera", "offset_px = [20.0, 0.0]"), ("doubtful",), f"{CAMERA} lies",
     ("camera", "none", 0.0, (20.0, 0.0))),
    (place("camera", MIRRORED), WRONG, f"{CAMERA} is mirrored left to right",
     ("camera", "horizontal", 0.0, (0.0, 0.0))),
    ("[scene]\nblur_px = 6.0", WRONG, "light is blurred by", ("mask", "none", 0.0, (0.0, 0.0))),
    *(
        pytest.param(*case, marks=pytest.mark.long)  # of the same kinds
        for case in (
            (place("mask", "offset_px = [2.0, 0.0]"), ("good",), "",
             ("mask", "none", 0.0, (2.0, 0.0))),
            (place("mask", "offset_px = [24.0, 0.0]"), ("bad",), MASK,
             ("mask", "none", 0.0, (24.0, 0.0))),
            (place("mask", "turn_deg = 2.0"), ("good",), "", ("mask", "none", 2.0, (0.0, 0.0))),
            (place("mask", "turn_deg = 180.0"), ("bad",), f"{MASK} is turned by 180 degrees",
             ("mask", "both", 0.0, (0.0, 0.0))),
        )
    ),
]  # fmt: skip


@pytest.mark.parametrize(("truth", "grades", "words", "lies"), CASES)
def test_what_lies_elsewhere_is_said_with_its_figures_and_nothing_else(
    tmp_path: Path,
    truth: str,
    grades: tuple[str, ...],
    words: str,
    lies: tuple[str, str, float, tuple[float, float]],
) -> None:
    """A photo that is called good is right, by the truth of the bench; what was found is kept."""
    made = taken(tmp_path, truth)
    quality = made.quality
    assert quality.verdict in grades, (quality, made.error)
    assert made.error < 0.1 or quality.verdict != "good"
    if words:
        assert any(words in reason for reason in quality.reasons), quality.reasons
        assert any(words in warning for warning in made.warnings), made.warnings
    else:
        assert quality.reasons == ()
    device, flip, turn_deg, offset_px = lies
    assert made.manifest.run.panels is not None
    lie = measure_misplacement(getattr(made.manifest.run.panels, device), SIZE_PX)
    assert lie.flip == flip
    assert abs(lie.turn_deg - turn_deg) < 0.2
    assert np.hypot(*np.subtract(lie.offset_px, offset_px)) < 0.2 * QUAD_PX


@pytest.mark.parametrize(
    "kind",
    [
        "chart-in-milk",
        *(
            pytest.param(one, marks=pytest.mark.long)
            for one in ("wax-disk", "disco-ball", "glass-and-balls", "mirror-and-vase", "open-book")
        ),
    ],
)
def test_no_sound_scene_is_said_to_lie_elsewhere(tmp_path: Path, kind: str) -> None:
    made = taken(tmp_path, "", kind)
    said = (*made.quality.reasons, *made.warnings)
    for words in (MASK, CAMERA, "a panel is", "not known", "not checked"):
        assert not any(words in text for text in said), said


def test_a_display_that_takes_no_pixels_is_photographed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load = MockDisplay.load

    def cells_alone(display: MockDisplay, frames: Frames) -> None:
        if frames.grid == (1, 1):
            raise ConfigError("this display draws cells alone", device="display")
        load(display, frames)

    monkeypatch.setattr(MockDisplay, "load", cells_alone)
    made = taken(tmp_path, "")
    assert made.quality.verdict == "doubtful"
    (reason,) = made.quality.reasons
    assert "the places of panels and camera were not checked" in reason
    assert "this display draws cells alone" in reason and reason in made.warnings


@pytest.mark.parametrize("f_number", ["auto", 2.5])
def test_blocks_are_seen_where_codes_were_metered_without_direct_light(
    tmp_path: Path, f_number: Literal["auto"] | float
) -> None:
    """No white shot, and a book that returns mostly direct light: its last codes show none of it,
    at a stop at which two thirds of a white photo are clipped."""
    config = Config(
        projector=PanelConfig(size_px=SIZE_PX),
        mask=PanelConfig(size_px=SIZE_PX),
        scene=SceneConfig(kind="open-book", grid=(6, 8)),
        camera=CameraConfig(frame_quads=(64, 48), f_number=f_number),
        limits=FREE,
    )
    record = take(config, goal="diagonal", codes=32, out=str(tmp_path)).manifest.run
    assert record.panels is not None and record.panels.mask_seen


def fine(
    folder: Path, kind: str, truth: str = "", *, px: tuple[int, int] = (512, 384), **camera: Any
) -> Taken:
    """Whole cells of 32 px and quads of 6.4 px, of which blocks tell a third of a pixel."""
    (folder / "truth.toml").write_text(truth)
    config = Config(
        projector=PanelConfig(size_px=px),
        mask=PanelConfig(size_px=(800, 600)),
        scene=SceneConfig(kind=kind, grid=(12, 16)),
        camera=CameraConfig(frame_quads=(80, 60), **camera),
        bench=BenchConfig(truth=str(folder / "truth.toml")),
        limits=FREE,
    )
    return take(config, seed=0, out=str(folder))


@pytest.mark.parametrize(
    ("kind", "truth"),
    [
        ("open-book", place("mask", "offset_px = [0.5, 0.0]")),
        pytest.param("still-life", "[scene]\nblur_px = 0.5", marks=pytest.mark.long),
        pytest.param("open-book", "[scene]\nblur_px = 0.3", marks=pytest.mark.long),
    ],
)
def test_what_blocks_are_too_coarse_for_shows_as_lines_along_borders(
    tmp_path: Path, kind: str, truth: str
) -> None:
    """Light that gets from cell to cell by less than blocks tell: error bars have it."""
    made = fine(tmp_path, kind, truth)
    assert made.error > 0.1 and made.quality.verdict in WRONG
    assert any("on its way to the mask" in reason for reason in made.quality.reasons)
    with np.load(made.folder / "probe.npz") as data:
        stated = np.sqrt(np.mean(data["sigma"] ** 2) / np.mean(data["image"] ** 2))
    assert stated > 0.1
    assert made.decodes_the_same()


@pytest.mark.parametrize(
    ("kind", "rest"),
    [
        ("chart-in-milk", {}),
        ("open-book", {"px": (510, 380)}),
        *(
            pytest.param(kind, rest, marks=pytest.mark.long)
            for kind in ("wax-disk", "disco-ball", "glass-and-balls", "mirror-and-vase")
            for rest in ({}, {"px": (510, 380)}, {"place": Placing(turn_deg=5.0, scale=1.1)})
        ),
    ],
)
def test_no_sound_scene_has_lines_along_borders(
    tmp_path: Path, kind: str, rest: dict[str, Any]
) -> None:
    """Also where cells end within pixels, and where the camera stands askew."""
    made = fine(tmp_path, kind, **rest)
    assert made.quality.verdict == "good" and made.error < 0.03
    assert made.manifest.run.panels is not None
    assert made.manifest.run.panels.border_px == 0.0
