"""The geometry by dots, stripes and XOR codes: on a card and on textured scenes whose
light comes again mirrored, before a bench that knows none of the program's maps."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from pdcd.bench.tables import CameraConfig, Config, PanelConfig
from pdcd.calibration.figures import Verdict
from pdcd.calibration.geometry.fit import PointPairs, fit_map
from pdcd.calibration.geometry.geometry_step import calibrate_geometry, choose_marks
from pdcd.calibration.script import PhotoRequest, StepOutcome
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, map_between
from pdcd.panels.placing import Placing
from tests.unit.calibration.geometry_bench import Bench, Way, small_way
from tests.unit.calibration.scripted import Answered, run, session_of

pytestmark = pytest.mark.whole

Floats = NDArray[np.float64]

FRAME = (320, 480)
PROJECTOR, MASK = small_way("projector"), small_way("mask", turn_deg=1.0)
FULL = 16


def textured(seed: int = 3) -> Floats:
    """Albedo of a scene from 0.1 to 0.9, with edges and dark parts."""
    rng = np.random.default_rng(seed)
    smooth = gaussian_filter(rng.standard_normal(FRAME), 12.0)
    steps = np.digitize(smooth / smooth.std(), [-1.0, -0.3, 0.4, 1.1])
    return np.asarray(np.array([0.1, 0.3, 0.5, 0.7, 0.9])[steps])


def scene(**changes: Any) -> Bench:
    made = Bench(PROJECTOR, MASK, samples=2, blur_quads=0.6, texture=textured())
    return replace(made, **changes)


def seen_by(bench: Bench, config: Config | None = None, **session: Any) -> tuple[StepOutcome, int]:
    """What the step finds before a bench, and how many photos it took."""
    config = config or Config(
        projector=PanelConfig(size_px=PROJECTOR.size_px), mask=PanelConfig(size_px=MASK.size_px)
    )
    made: Answered = session_of(config, lambda asked: asked.photo)  # type: ignore[attr-defined]
    for name, value in {"full": FULL, **session}.items():
        setattr(made, name, value)
    count = 0

    def taken(wanted: PhotoRequest) -> Any:
        nonlocal count
        count += 1
        photo = bench.photo(wanted.shown, count)
        return SimpleNamespace(photo=photo, raw=SimpleNamespace(pattern="RGGB"))

    found = run(calibrate_geometry(made), taken)
    assert found.outcome is not None
    return found.outcome, count


def off_px(found: StepOutcome, bench: Bench, panel: str) -> float:
    """95th percentile of where the camera sees a panel's pixels, by the maps and in truth."""
    way: Way = getattr(bench, panel)
    x, y = np.meshgrid(np.linspace(20, FRAME[1] - 20, 25), np.linspace(20, FRAME[0] - 20, 25))
    quads = np.stack([x, y], axis=-1).reshape(-1, 2)
    true = way.to_panel(quads)
    inside = ((true > 6.0) & (true < np.array(way.size_px) - 6.0)).all(axis=-1)
    said = map_between(found.maps["camera"], found.maps[panel], quads[inside])
    return float(np.percentile(np.hypot(*(said - true[inside]).T), 95.0))


def known(bench: Bench, moved_px: tuple[float, float] = (0.0, 0.0)) -> Config:
    """A configuration with measured maps, as they were before the camera saw all moved."""
    maps: dict[str, Map] = {}
    x, y = np.meshgrid(np.linspace(8, FRAME[1] - 8, 30), np.linspace(8, FRAME[0] - 8, 20))
    quads = np.stack([x, y], axis=-1).reshape(-1, 2)
    size = (FRAME[1], FRAME[0])
    shape = np.full(quads.shape, 0.01)
    on = {p: getattr(bench, p).to_panel(quads + moved_px) for p in ("projector", "mask")}
    maps["camera"] = fit_map(
        PointPairs(quads, on["projector"], shape), size, PROJECTOR.size_px, ""
    ).map
    maps["mask"] = fit_map(
        PointPairs(on["mask"], on["projector"], shape), MASK.size_px, PROJECTOR.size_px, ""
    ).map
    maps["projector"] = Map.filling(PROJECTOR.size_px)
    return Config(
        projector=PanelConfig(size_px=PROJECTOR.size_px, place=Placing(map=maps["projector"])),
        mask=PanelConfig(size_px=MASK.size_px, place=Placing(map=maps["mask"])),
        camera=CameraConfig(place=Placing(map=maps["camera"])),
    )


def test_maps_that_were_never_measured_are_asked_for() -> None:
    with pytest.raises(CalibrationError, match="lies has not been measured"):
        seen_by(scene(), subject="scene", marks="phase")
    assert choose_marks(session_of()) == "dots"
    on_scene = session_of()
    on_scene.subject = "scene"
    assert choose_marks(on_scene) == "xor"
    on_scene.config = known(scene())
    assert choose_marks(on_scene) == "phase"


def test_a_scene_without_maps_is_found_by_xor_codes() -> None:
    bench = scene(groove=(0.35, 8.0), electrons=30_000.0)
    found, count = seen_by(bench, subject="scene")
    assert count == 3 + 32 + 9
    assert off_px(found, bench, "projector") < 0.1
    assert off_px(found, bench, "mask") < 0.1


@pytest.mark.parametrize(
    "periods",
    [
        pytest.param((1.0, 0.0), marks=pytest.mark.long),
        pytest.param((-2.0, 1.0), marks=pytest.mark.long),
        pytest.param((0.5, 0.0), marks=pytest.mark.long),
        (2.4, -1.3),
        (0.0, 0.0),
    ],
)
def test_a_projector_that_moved_by_periods_is_found(periods: tuple[float, float]) -> None:
    """Stripes look the same a period further on; the maps in use are of where it was before. With
    them a scene needs the three photos of the mask's dots, eight of stripes and one of blocks."""
    shift = 8 * PROJECTOR.scale * periods[0], 8 * PROJECTOR.scale * periods[1]
    moved = replace(PROJECTOR, shift_quads=shift)
    bench = scene(projector=moved)
    found, count = seen_by(bench, known(scene()), subject="scene")
    assert count == 3 + 9 and found.verdict is not Verdict.BAD
    assert off_px(found, bench, "projector") < 0.05
    # A projector that moved away lights less of the mask.
    assert off_px(found, bench, "mask") < (0.2 if any(periods) else 0.1)


def test_a_projector_that_was_turned_and_zoomed_is_refused() -> None:
    before = known(scene())
    zoomed = scene(projector=replace(PROJECTOR, scale=1.3 * PROJECTOR.scale, turn_deg=6.0))
    with pytest.raises(CalibrationError, match=r"beside its stored map|cannot be numbered") as told:
        seen_by(zoomed, before, subject="scene")
    assert told.value.hint is not None and "--marks xor" in told.value.hint


@pytest.mark.parametrize(
    ("cause", "changes"),
    [
        ("darken the room", {"ambient": 9.0, "electrons": 3_000.0}),
        ("mask is seen mirrored", {"mask": replace(MASK, mirrored=True)}),
        (
            "beside its stored map|cannot be numbered|beyond|no smooth map",
            {"projector": replace(PROJECTOR, mirrored=True)},
        ),
    ],
)
def test_what_is_wrong_with_a_scene_is_named(cause: str, changes: dict[str, Any]) -> None:
    with pytest.raises(CalibrationError, match=cause) as told:
        seen_by(scene(**changes), known(scene()), subject="scene")
    assert told.value.hint


def test_half_a_scene_is_doubtful_and_what_is_seen_of_it_right() -> None:
    half = np.ones(FRAME)
    half[:, 250:] = 0.0
    found, _ = seen_by(scene(covered=half), known(scene()), subject="scene")
    seen = {f.name: f for f in found.figures if f.name.endswith("seen")}
    assert seen["projector.seen"].verdict is not Verdict.GOOD
    assert seen["projector.seen"].value == pytest.approx(0.55, abs=0.15)
