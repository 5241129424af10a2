"""The look at both panels on whole captures: sound benches, and such that lie elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

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
from pdcd.pictures.misplaced import estimate_lost_direct, measure_misplacement
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, Quality
from pdcd.runs.folder import read_manifest
from tests.bench.captures import take_into

SIZE_PX = (256, 192)
QUADS = (96, 72)
QUAD_PX = SIZE_PX[0] / QUADS[0]


def captured(folder: Path, truth: str, kind: str = "milky-bottle") -> CaptureResult:
    """Of a bench that really is as `truth` says, and is believed to fill the field. Cells have
    16 px."""
    (folder / "truth.toml").write_text(truth)
    config = Config(
        projector=PanelConfig(size_px=SIZE_PX),
        mask=PanelConfig(size_px=(320, 240)),
        scene=SceneConfig(kind=kind, grid=(12, 16)),
        camera=CameraConfig(frame_quads=QUADS),
        bench=BenchConfig(truth=str(folder / "truth.toml")),
        limits=LimitsConfig(min_free_bytes=0),
    )
    request = CaptureRequest(goal="indirect", codes=64, pilot=0, parts=4, window="quarter")
    return take_into(folder, config, request)[0]


@pytest.mark.parametrize("kind", ["mirror-and-vase", "still-life"])
def test_panels_that_lie_right_are_not_accused_by_few_quads(tmp_path: Path, kind: str) -> None:
    """Three quads to a block, and eighteen blocks: a turn of a tenth of a degree is what they err,
    and error bars have none of it."""
    config = Config(
        projector=PanelConfig(size_px=(512, 384)),
        mask=PanelConfig(size_px=(800, 600)),
        scene=SceneConfig(kind=kind, grid=(18, 24)),
        camera=CameraConfig(frame_quads=(72, 54)),
        limits=LimitsConfig(min_free_bytes=0),
    )
    request = CaptureRequest(goal="indirect", codes=16, pilot=0, parts=1, window="quarter")
    result, taken = take_into(tmp_path, config, request)
    record = read_manifest(taken).run
    assert record.panels is not None and record.panels.mask is not None
    assert estimate_lost_direct(record, "whole").rms < 1e-3
    quality = result.summary["quality"]
    assert isinstance(quality, Quality)
    assert not any("lies" in reason for reason in quality.reasons)


def place(device: str, **keys: str) -> str:
    return f"[{device}.place]\n" + "".join(f"{key} = {value}\n" for key, value in keys.items())


MIRRORED = {"flip": '"horizontal"'}
CASES = [
    # What really is, grades, what is said of it; device, flip, turn, right and down as found.
    # Quarter windows leave 4 px on each side.
    ("", ["good"], "", ("mask", "none", 0.0, (0.0, 0.0))),
    (place("mask", offset_px="[2.0, 0.0]"), ["good"], "", ("mask", "none", 0.0, (2.0, 0.0))),
    (
        place("mask", offset_px="[-6.0, 5.0]"),
        ["doubtful", "bad"],
        "the mask's picture lies",
        ("mask", "none", 0.0, (-6.0, 5.0)),
    ),
    (
        place("mask", offset_px="[24.0, 0.0]"),
        ["bad"],
        "the mask's picture",
        ("mask", "none", 0.0, (24.0, 0.0)),
    ),
    (
        place("mask", offset_px="[-28.0, 28.0]"),
        ["bad"],
        "the mask's picture",
        ("mask", "none", 0.0, (-28.0, 28.0)),
    ),
    (place("mask", turn_deg="2.0"), ["good"], "", ("mask", "none", 2.0, (0.0, 0.0))),
    (
        place("mask", turn_deg="5.0"),
        ["doubtful", "bad"],
        "the mask's picture is turned clockwise by",
        ("mask", "none", 5.0, (0.0, 0.0)),
    ),
    (
        place("mask", **MIRRORED),
        ["bad"],
        "the mask's picture is mirrored left to right",
        ("mask", "horizontal", 0.0, (0.0, 0.0)),
    ),
    (
        place("mask", turn_deg="180.0"),
        ["bad"],
        "the mask's picture is turned by 180 degrees",
        ("mask", "both", 0.0, (0.0, 0.0)),
    ),
    (
        place("camera", offset_px="[20.0, 0.0]"),
        ["doubtful"],
        "what the camera sees lies",
        ("camera", "none", 0.0, (20.0, 0.0)),
    ),
    (
        place("camera", **MIRRORED),
        ["doubtful", "bad"],
        "what the camera sees is mirrored left to right",
        ("camera", "horizontal", 0.0, (0.0, 0.0)),
    ),
]


@pytest.mark.parametrize(("truth", "grades", "words", "lies"), CASES)
def test_what_lies_elsewhere_is_said_with_its_figures_and_nothing_else(
    tmp_path: Path,
    truth: str,
    grades: list[str],
    words: str,
    lies: tuple[str, str, float, tuple[float, float]],
) -> None:
    """A photo that is called good is right, by the truth of the bench; what was found is kept."""
    result = captured(tmp_path, truth)
    quality, error = result.summary["quality"], result.summary["rms_error_quads"]
    assert isinstance(quality, Quality) and isinstance(error, float)
    assert quality.verdict in grades, (quality, error)
    assert error < 0.1 or quality.verdict != "good"
    if words:
        assert any(words in reason for reason in quality.reasons), quality.reasons
        assert any(words in warning for warning in result.warnings), result.warnings
    else:
        assert quality.reasons == ()
    assert result.folder is not None
    record = read_manifest(Path(result.folder)).run
    assert record.panels is not None
    device, flip, turn_deg, offset_px = lies
    six = getattr(record.panels, device)
    assert six is not None
    lie = measure_misplacement(six, SIZE_PX)
    assert lie.flip == flip
    assert abs(lie.turn_deg - turn_deg) < 0.2
    assert np.hypot(*np.subtract(lie.offset_px, offset_px)) < 0.2 * QUAD_PX


@pytest.mark.parametrize(
    "kind",
    [
        "chart-in-milk",
        "wax-disk",
        *(
            pytest.param(one, marks=pytest.mark.long)
            for one in (
                "disco-ball",
                "glass-and-balls",
                "mirror-and-vase",
                "open-book",
            )
        ),
    ],
)
def test_no_sound_scene_is_said_to_lie_elsewhere(tmp_path: Path, kind: str) -> None:
    result = captured(tmp_path, "", kind)
    quality = result.summary["quality"]
    assert isinstance(quality, Quality)
    said = (*quality.reasons, *result.warnings)
    for words in ("the mask's picture", "what the camera sees", "a panel is", "nobody"):
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
    result = captured(tmp_path, "")
    quality = result.summary["quality"]
    assert isinstance(quality, Quality) and quality.verdict == "doubtful"
    (reason,) = quality.reasons
    assert "nobody looked whether panels and camera lie" in reason
    assert "this display draws cells alone" in reason
    assert reason in result.warnings


@pytest.mark.parametrize("f_number", ["auto", 2.5])
def test_blocks_are_seen_where_codes_were_metered_without_direct_light(
    tmp_path: Path, f_number: Literal["auto"] | float
) -> None:
    """No white shot, and a book that returns mostly direct light: its last codes show none of it,
    at a stop at which two thirds of a white photo are clipped."""
    config = Config(
        projector=PanelConfig(size_px=SIZE_PX),
        scene=SceneConfig(kind="open-book", grid=(12, 16)),
        camera=CameraConfig(frame_quads=QUADS, f_number=f_number),
        limits=LimitsConfig(min_free_bytes=0),
    )
    _, taken = take_into(tmp_path, config, CaptureRequest(goal="diagonal", codes=64))
    record = read_manifest(taken).run
    assert record.panels is not None and record.panels.mask_seen
