"""The verdict on whole captures of the mock bench: none without a fault, and each fault's own."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

import pdcd
from drivers.mock.bench import MockBench
from pdcd.bench.tables import (
    BenchConfig,
    CameraConfig,
    Config,
    DisplayConfig,
    FaultsConfig,
    LimitsConfig,
    PanelConfig,
    RigConfig,
    SceneConfig,
    ScheduleConfig,
)
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.patterns import Patterns, pack_bits
from pdcd.panels.placing import Placing
from pdcd.protocol.result import Quality
from pdcd.sensor.raw import read_raw
from tests.bench_rig import bright_scene
from tests.taken import take

pytestmark = pytest.mark.whole

GRID = (24, 32)
Bits = NDArray[np.uint8]
Move = Callable[[Bits], Bits]


def moved(patterns: Patterns, shape: tuple[int, int], move: Move) -> Patterns:
    if not len(patterns):
        return patterns
    bits = np.unpackbits(patterns.astype(np.uint8), axis=1, count=shape[0] * shape[1])
    shown = move(bits.reshape(-1, *shape)).reshape(len(bits), -1)
    return pack_bits(shown.astype(np.bool_))


def misplace(monkeypatch: pytest.MonkeyPatch, panel: str, move: Move) -> None:
    """The bench shows patterns (K, rows, cols) of a panel otherwise than its driver believes."""
    photo = MockBench._photo

    def wrongly(bench: MockBench, asked: Frames, log: FrameLog) -> NDArray[np.float64]:
        field = f"{panel}_patterns"
        shown: Any = {field: moved(getattr(asked, field), asked.lattice, move)}
        return photo(bench, replace(asked, **shown), log)

    monkeypatch.setattr(MockBench, "_photo", wrongly)


def verdict(folder: Path, *, camera: dict[str, Any] | None = None, **asked: Any) -> Quality:
    """Of one exposure with full sensor noise; `asked` holds tables of the bench, too."""
    tables = {k: asked.pop(k) for k in ("scene", "rig", "display", "mask") if k in asked}
    scene = tables.pop("scene", {})
    config = Config(
        scene=SceneConfig(**{"grid": GRID, **scene}),
        camera=CameraConfig(**(camera or {})),
        limits=LimitsConfig(min_free_bytes=0),
        **tables,
    )
    once = {"codes": 128, "pilot": 0, "parts": 1, "out": str(folder)}
    made = take(config, **{**once, **asked})
    assert made.manifest.summary["quality"] == made.quality
    return made.quality


@pytest.mark.parametrize("asked", [{}, {"white": False, "family": "bernoulli"}])
def test_a_sound_photo_is_good(tmp_path: Path, asked: dict[str, Any]) -> None:
    assert verdict(tmp_path, parts=4, **asked) == Quality(verdict="good")


def test_a_scene_that_is_lit_in_part_is_no_panel_that_is_mirrored(tmp_path: Path) -> None:
    """The edge of the light is the border between a cell and its mirror image."""
    illumination = np.zeros((12, 16))
    illumination[:, :8] = 1.0
    scene = {"kind": "open-book", "grid": [12, 16]}
    with pdcd.local({"scene": scene}, folder=tmp_path) as bench:
        run = bench.capture("indirect", illumination=illumination, progress=False)
    assert run.verdict == "good", run.quality.reasons


@pytest.mark.parametrize(("goal", "grade"), [("direct", "good"), ("indirect", "bad")])
def test_a_card_without_indirect_light_has_a_photo_of_direct_light(
    tmp_path: Path, goal: str, grade: str
) -> None:
    """Its coded shots are dark by right: blocks show that both panels work."""
    (tmp_path / "truth.toml").write_text("")
    config = late_bench(tmp_path, "card", frame_quads=(100, 75))
    assert take(config, goal=goal, out=str(tmp_path / "run")).quality.verdict == grade


def test_codes_that_leave_no_error_need_no_word(tmp_path: Path) -> None:
    found = verdict(tmp_path, scene={"grid": (6, 8)})
    assert not any("codes are not" in text for text in (*found.reasons, *found.remarks)), found


@pytest.mark.parametrize(
    ("scene", "asked", "grades"),
    [
        ("mirror-and-vase", {}, ["bad"]),
        ("mirror-and-vase", {"goal": "long-range", "codes": 16}, ["doubtful", "bad"]),
        ("milky-bottle", {"codes": None}, ["good"]),
        pytest.param("mirror-and-vase", {"codes": None}, ["bad"], marks=pytest.mark.long),
        pytest.param("milky-bottle", {"goal": "long-range"}, ["good"], marks=pytest.mark.long),
    ],
)
def test_near_light_that_is_lost_in_far_light(
    tmp_path: Path, scene: str, asked: dict[str, Any], grades: list[str]
) -> None:
    """Before a mirror hardly any light comes from near, and the photo is wrong by far more than
    there is; in milk there is much."""
    given = {"goal": "short-range", "radius": 2, "pilot": None, "parts": None, **asked}
    found = verdict(tmp_path, scene={"kind": scene, "grid": (12, 16)}, **given)
    assert found.verdict in grades, found
    assert bool(found.reasons) == (scene == "mirror-and-vase")


BARE = {"method": "multi-image", "codes": 16, "black_level": "none"}


@pytest.mark.parametrize(
    ("panel", "move", "asked", "words"),
    [
        ("dual", lambda b: b[:, :, ::-1], {}, "bad: a panel is mirrored left to right"),
        ("dual", lambda b: b[:, :, ::-1], {"white": False, "codes": 64},
         "bad: a panel is mirrored left to"),
        ("primal", lambda b: b[:, ::-1, ::-1], {}, "bad: a panel is turned by 180 degrees"),
        ("dual", lambda b: b[:, ::-1], {"family": "bernoulli"}, "bad: a panel is mirrored top"),
        ("dual", lambda b: 1 - b, {}, "bad: the coded photo has more light than there can be"),
        ("dual", lambda b: np.roll(b, 1, axis=2), {}, "doubtful: no direct light in the scene"),
        ("primal", lambda b: b[:, ::-1], {"goal": "diagonal"}, "bad: a panel is mirrored top"),
        ("primal", lambda b: np.roll(b, 3, axis=2), BARE, "doubtful: no direct light in the scene"),
        ("primal", lambda b: 1 - b, BARE, "bad: a panel is inverted"),
    ],
)  # fmt: skip
def test_a_panel_that_lies_wrongly(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    panel: str,
    move: Move,
    asked: dict[str, Any],
    words: str,
) -> None:
    misplace(monkeypatch, panel, move)
    found = verdict(tmp_path, **asked)
    grade, start = words.split(": ", 1)
    assert found.verdict == grade
    assert any(reason.startswith(start) for reason in found.reasons), found.reasons


@pytest.mark.parametrize(
    ("bench", "asked", "grades", "start"),
    [
        ({"camera": {"f_number": 0.2}}, {}, ["bad"], "100 % of the field is saturated"),
        ({"camera": {"f_number": 1e9}}, {}, ["bad"], "no light"),
        ({"camera": {"f_number": 210.0}}, {}, ["doubtful", "bad"], "under-exposed"),
        ({"scene": {"ambient": 1.0}}, {"black_level": "ambient"}, ["doubtful", "bad"],
         "ambient or stray light"),
        ({"rig": RigConfig(on_miss="flag"),
          "display": DisplayConfig(faults=FaultsConfig(dropped=tuple(range(100, 400, 7))))},
         {}, ["doubtful"], "refreshes were missed"),
    ],
)  # fmt: skip
def test_too_much_or_too_little_light_and_unequal_light_are_told(
    tmp_path: Path, bench: dict[str, Any], asked: dict[str, Any], grades: list[str], start: str
) -> None:
    found = verdict(tmp_path, **bench, **asked)
    assert found.verdict in grades
    assert any(start in reason for reason in found.reasons), found.reasons
    if "saturated" in start:  # nothing else is known of it
        assert not any("direct light" in reason for reason in found.reasons)


SMALL = (12, 16)
"""Cells of the benches that are not what is believed."""


def verdict_on(folder: Path, truth: str) -> Quality:
    """Of a bench that really is as `truth` says. Its camera is believed to see 60 % more than the
    field either way, its panels to fill the field; the scene is bright up to its edges."""
    scene = bright_scene(folder, SMALL, indirect=1.0)
    (folder / "truth.toml").write_text(truth)
    config = Config(
        projector=PanelConfig(size_px=(256, 192)),
        mask=PanelConfig(size_px=(320, 240)),
        scene=scene,
        camera=CameraConfig(frame_quads=(80, 60), place=Placing(scale=1.6)),
        bench=BenchConfig(truth=str(folder / "truth.toml")),
        rig=RigConfig(look_at_panels=False),  # light alone tells
        limits=LimitsConfig(min_free_bytes=0),
    )
    return take(config, codes=64, pilot=0, window="quarter", out=str(folder)).quality


@pytest.mark.parametrize(
    ("truth", "words"),
    [
        ("", ""),
        # Projector and mask are larger than they are believed to be: to the camera, all is nearer.
        ("[camera]\nplace = { scale = 1.15 }\n", "light outside"),
        ("[projector]\nplace = { offset_px = [40.0, 0.0] }\n", "no direct light in the scene"),
    ],
)
def test_a_bench_that_lies_elsewhere_than_believed(tmp_path: Path, truth: str, words: str) -> None:
    found = verdict_on(tmp_path, truth)
    if not words:
        assert (found.verdict, found.reasons) == ("good", ())
        return
    assert found.verdict == "doubtful"
    if words == "light outside":
        said = [r for r in found.reasons if "of the field's light outside it" in r]
        assert said and said[0].endswith("check that [camera.place] says where the field lies")
    else:
        assert any(reason.startswith(words) for reason in found.reasons), found.reasons


def test_borders_of_cells_that_the_panels_draw_apart(tmp_path: Path) -> None:
    """Of whole cells: what the report says of direct light is what the photo had of it; the picture
    has none, and the verdict says how much was taken out."""
    (tmp_path / "truth.toml").write_text("[camera]\nsamples = 12\n")
    config = Config(
        projector=PanelConfig(size_px=(256, 192)),
        mask=PanelConfig(size_px=(68, 51), place=Placing(turn_deg=4.0, scale=1.1)),
        scene=bright_scene(tmp_path, SMALL, indirect=0.2),
        camera=CameraConfig(frame_quads=(64, 48), noise="none"),
        bench=BenchConfig(truth=str(tmp_path / "truth.toml")),
        limits=LimitsConfig(min_free_bytes=0),
    )
    made = take(config, codes=64, pilot=0, parts=1, window="whole", out=str(tmp_path))
    told = made.manifest.realised["coded"]["diagonal_mean"]
    run = pdcd.open(made.folder)
    assert run.truth is not None
    white, indirect = (run.pictures[name].mean() for name in ("white", "indirect"))
    left = (indirect - run.truth.mean()) / (white - run.truth.mean())
    assert told > 0.1
    assert abs(left) < 0.01
    assert made.quality.verdict != "good"
    for words in ("picture was subtracted from it", "photo coded: direct light has a weight"):
        assert any(words in reason for reason in made.quality.reasons)


def test_saturation_is_a_share_of_the_field(tmp_path: Path) -> None:
    """A twelfth of the field is over-exposed; the field fills a ninth of the frame."""
    width, height = 48, 36
    small = PanelConfig(size_px=(128, 96))
    config = Config(
        projector=small,
        mask=small,
        scene=SceneConfig(grid=SMALL),
        camera=CameraConfig(frame_quads=(width, height), f_number=1.0, place=Placing(scale=3.0)),
        limits=LimitsConfig(min_free_bytes=0),
    )
    made = take(config, codes=16, white=False, pilot=0, parts=1, out=str(tmp_path))
    raw = read_raw(made.folder / "raw" / "coded.dng")
    blown = raw.samples.reshape(height, 2, width, 2).max(axis=(1, 3)) >= raw.white
    told = re.search(r"([0-9.]+) % of the field is saturated", made.quality.reasons[0])
    assert made.quality.verdict == "bad" and told is not None, made.quality
    quad = 100.0 / (width * height / 9)  # one on the verge
    assert 5.0 < float(told[1]) == pytest.approx(quad * blown.sum(), abs=1.1 * quad)


@pytest.mark.parametrize(
    ("fall_s", "grade", "taken_out"), [(3e-3, None, True), (8e-3, "bad", False)]
)
def test_direct_light_that_is_too_much_to_be_taken_out(
    tmp_path: Path, fall_s: float, grade: str | None, taken_out: bool
) -> None:
    """Nothing is taken out then, and nobody is told that it was."""
    mask = PanelConfig(size_px=(1600, 1200), fall_s=fall_s)
    found = verdict(tmp_path, mask=mask, guards=False, black_level="none")
    told = [text for text in found.reasons if "was subtracted from it" in text]
    left = [text for text in found.reasons if "of the picture is direct light" in text]
    assert (bool(told), bool(left)) == (taken_out, not taken_out), found
    assert grade in (None, found.verdict)


NOT_MET = "codes of the panels do not meet"


@pytest.mark.parametrize("scene", ["open-book", "wax-disk"])
@pytest.mark.parametrize(
    ("mask", "sound"),
    [
        ("skew_s = 0.0166", True),
        ("skew_s = 0.02", False),
        ("skew_s = 0.033333", False),
        ("skew_s = -0.025", False),
        ("skew_s = 0.05", False),
        ("rise_s = 0.012\nfall_s = 0.012", False),
        ("scan_s = 0.0159\nskew_s = 0.008", False),
    ],
)
def test_a_mask_that_keeps_other_times_than_believed(
    tmp_path: Path, scene: str, mask: str, sound: bool
) -> None:
    """The photo is called good where it is right by the known truth, and nowhere else."""
    (tmp_path / "truth.toml").write_text(f"[mask]\n{mask}\n")
    made = take(late_bench(tmp_path, scene), goal="indirect", out=str(tmp_path / "run"))
    assert (made.error < 0.05) == sound
    assert (made.quality.verdict == "good") == sound, made.quality
    if not sound:
        told = made.quality.reasons[0]
        assert told.startswith((NOT_MET, "the coded photo has more light than there can be"))
        assert "run pdcd calibrate timing" in told


@pytest.mark.parametrize(
    "truth",
    [
        "[mask]\nskew_s = 0.017",
        "[mask]\nskew_s = -0.017",
        "[mask]\nrise_s = 0.005\nfall_s = 0.006",
        "[mask]\nscan_s = 0.0159\nskew_s = 0.003",
        pytest.param("[projector]\nrise_s = 0.005\nfall_s = 0.006", marks=pytest.mark.long),
    ],
)
def test_codes_that_hardly_meet_others_are_told_by_how_parts_differ(
    tmp_path: Path, truth: str
) -> None:
    """Two hundredths of the direct light of a book are a fifth of its indirect light."""
    (tmp_path / "truth.toml").write_text(f"{truth}\n")
    made = take(late_bench(tmp_path, "open-book"), goal="indirect", out=str(tmp_path / "run"))
    assert 0.1 < made.error < 0.5
    assert made.quality.verdict == "doubtful"
    assert made.quality.reasons[0].startswith(NOT_MET)


@pytest.mark.parametrize(
    ("mask", "sound"), [("", True), ("[mask]\nrise_s = 0.006\nfall_s = 0.007\n", False)]
)
def test_far_light_by_a_slow_mask_is_told_without_a_white_photo(
    tmp_path: Path, mask: str, sound: bool
) -> None:
    (tmp_path / "truth.toml").write_text(mask)
    config = late_bench(tmp_path, "open-book", frame_quads=(100, 75))
    made = take(config, goal="long-range", radius=2, codes=240, out=str(tmp_path / "run"))
    assert (made.error < 0.1) == sound
    assert (made.quality.verdict == "good") == sound, made.quality
    assert sound or made.quality.reasons[0].startswith(NOT_MET)


@pytest.mark.parametrize(
    ("times", "asked"),
    [
        ("scan_s = 0.03", {"parts": 1, "pilot": 0, "codes": 128}),
        ("skew_s = 0.03", {"goal": "transport", "codes": None}),
        ("skew_s = 0.03", {"goal": "fraction", "p": 0.25, "codes": 160}),
    ],
)
@pytest.mark.parametrize("right", [False, True])
def test_times_that_nothing_shows_are_never_good_unless_measured(
    tmp_path: Path, times: str, asked: dict[str, Any], right: bool
) -> None:
    """The photo of a right bench is called doubtful, too: it looks no better."""
    (tmp_path / "truth.toml").write_text("" if right else f"[mask]\n{times}\n")
    config = late_bench(tmp_path, "open-book", frame_quads=(96, 72))
    made = take(config, **{"goal": "indirect", "out": str(tmp_path / "run"), **asked})
    assert (made.error < 0.1) == right
    assert made.quality.verdict != "good"
    assert any("nobody measured when" in reason for reason in made.quality.reasons)


@pytest.mark.parametrize("asked", [{}, {"goal": "long-range", "radius": 2, "codes": 240}])
@pytest.mark.parametrize("scene", ["open-book", "still-life"])
def test_known_slow_panels_are_not_accused(
    tmp_path: Path, scene: str, asked: dict[str, Any]
) -> None:
    """They let a twentieth of the direct light past the codes, as everybody knows."""
    (tmp_path / "truth.toml").write_text("")
    config = late_bench(tmp_path, scene)
    slow = PanelConfig(
        size_px=config.mask.size_px, rise_s=3e-3, fall_s=5e-3, skew_s=4e-3, contrast=300.0
    )
    made = take(msgspec.structs.replace(config, mask=slow), out=str(tmp_path / "run"), **asked)
    assert made.error < (0.3 if asked else 0.05)
    assert not any(reason.startswith(NOT_MET) for reason in made.quality.reasons), made.quality


@pytest.mark.parametrize(
    ("place", "asked", "quads"),
    [
        ("radial = [-0.02, 0.0]", {"goal": "indirect", "window": "quarter"}, (96, 72)),
        ("offset_px = [1.0, 0.5]", {"goal": "indirect", "white": False}, (96, 72)),
        ("offset_px = [1.0, 0.5]", {"goal": "short-range", "radius": 2}, (96, 72)),
        ("offset_px = [2.0, 0.0]", {"goal": "indirect"}, (60, 45)),
    ],
)
def test_a_mask_a_little_elsewhere_than_believed_is_never_good(
    tmp_path: Path, place: str, asked: dict[str, Any], quads: tuple[int, int]
) -> None:
    """Bent by a lens, or off by less than the camera's blocks or lines show."""
    (tmp_path / "truth.toml").write_text(f"[mask.place]\n{place}\n")
    config = msgspec.structs.replace(
        late_bench(tmp_path, "open-book", frame_quads=quads),
        scene=SceneConfig(kind="open-book", grid=(24, 32)),
        schedule=ScheduleConfig(grid=(24, 32)),
    )
    made = take(config, out=str(tmp_path / "run"), **asked)
    assert made.error > 0.2
    assert made.quality.verdict != "good"


def late_bench(folder: Path, scene: str, **camera: Any) -> Config:
    """A bench that is as `truth.toml` says, in front of a scene."""
    return Config(
        scene=SceneConfig(kind=scene, grid=SMALL if camera else GRID),
        camera=CameraConfig(**camera),
        rig=RigConfig(look_at_panels=bool(camera)),  # else its pixels are too few
        bench=BenchConfig(truth=str(folder / "truth.toml")),
        limits=LimitsConfig(min_free_bytes=0),
    )


@pytest.mark.parametrize(
    ("truth", "asked", "words"),
    [
        ("[mask]\nskew_s = 0.025\n", {}, "than configured: run"),
        ("[mask]\nskew_s = 0.025\n", {"codes": 32, "goal": "direct"}, "than configured: run"),
        ("[mask.place]\nturn_deg = 90.0\nscale = 1.34\n", {}, "than configured, or elsewhere: run"),
        ("[scene]\nambient = 0.05\n", {}, ""),
        ("[mask.place]\nturn_deg = 1.0\n", {}, ""),
    ],
)
def test_codes_that_do_not_meet_beside_what_else_is_wrong(
    tmp_path: Path, truth: str, asked: dict[str, Any], words: str
) -> None:
    """On a bench whose blocks are looked at: what they or the room explain is not told of times."""
    (tmp_path / "truth.toml").write_text(truth)
    config = late_bench(tmp_path, "wax-disk", frame_quads=(100, 75))
    found = take(config, **{"goal": "indirect", "out": str(tmp_path / "run"), **asked}).quality
    told = [reason for reason in found.reasons if reason.startswith(NOT_MET)]
    assert [words in reason for reason in told] == [True] * bool(words), found
    assert not words or found.verdict == "bad"


@pytest.mark.parametrize("scene", ["disco-ball", "milky-bottle", "mirror-and-vase", "wax-disk"])
@pytest.mark.parametrize("asked", [{}, {"window": "quarter"}, {"goal": "direct", "codes": 100}])
@pytest.mark.long
def test_codes_that_meet_are_not_told_to_be_apart(
    tmp_path: Path, scene: str, asked: dict[str, Any]
) -> None:
    (tmp_path / "truth.toml").write_text("")
    config = late_bench(tmp_path, scene, frame_quads=(100, 75))
    made = take(config, **{"goal": "indirect", "out": str(tmp_path / "run"), **asked})
    assert made.quality.verdict == "good", made.quality


@pytest.mark.parametrize("goal", ["diagonal", "descattered"])
@pytest.mark.parametrize("skew_s", [6e-3, 25e-3])
def test_direct_light_of_unequal_weight(tmp_path: Path, goal: str, skew_s: float) -> None:
    """Guards of one refresh bear 6 ms. A mask that is 25 ms late shows each code before light of
    the next: right on average, as the photo is scaled by that, and wrong in every cell."""
    mask = PanelConfig(size_px=(1600, 1200), skew_s=skew_s)
    asked: dict[str, Any] = {"codes": 256, "shift": (0, 1)} if goal == "descattered" else {}
    found = verdict(tmp_path, goal=goal, mask=mask, guards=True, **asked)
    late = skew_s > 0.01
    assert any("from cell to cell" in text for text in found.reasons) == late, found
    assert (found.verdict == "good") != late


def test_direct_light_beside_that_of_a_matched_cell(tmp_path: Path) -> None:
    """It is one of the other paths there, whose weights differ by the code."""
    found = verdict(tmp_path, goal="fraction", p=0.25, shift=(0, 1), family="balanced")
    assert not any("from cell to cell" in text for text in found.reasons), found
