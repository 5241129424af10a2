"""The stranger's bench itself, against sums that are done by hand and by brute force."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.strangers import benches
from tests.strangers.benches import true_maps
from tests.strangers.compare import compare_arrays
from tests.strangers.judge import calibrate, photograph
from tests.strangers.package.strangers_bench.facts import Facts, PanelFacts, draw_facts
from tests.strangers.package.strangers_bench.places import Place
from tests.strangers.package.strangers_bench.world import Shown, Stands, World

Floats = NDArray[np.float64]
REFRESH_S = 1.0 / 60.0
STEP_S = 4e-6
CODES = {"codes": 80, "parts": 4, "pilot": 0}
"""Few, of which parts tell the error bars."""


Found = tuple[Facts, Path, dict[str, Path]]


def bench(**changes: object) -> Facts:
    return dataclasses.replace(draw_facts(1, small=True), **changes)  # type: ignore[arg-type]


def patch(size_px: tuple[int, int], level: int = 255) -> NDArray[np.uint8]:
    """The middle half of a panel."""
    width, height = size_px
    picture = np.zeros((height, width), dtype=np.uint8)
    picture[height // 5 : -height // 5, width // 5 : -width // 5] = level
    return picture


def followed(panel: PanelFacts, row: float, at_s: Floats, targets: Floats, t_s: Floats) -> Floats:
    """Light of a pixel in a row, by small steps of its differential equation."""
    share = row / panel.size_px[1]
    late = panel.late_s + abs(panel.scan_s) * (share if panel.scan_s > 0 else 1.0 - share)
    black = 1.0 / panel.contrast
    light, found = black, np.empty(len(t_s))
    number = np.searchsorted(at_s, t_s - late, side="right") - 1
    for step, which in enumerate(number):
        goal = black if which < 0 else black + (1.0 - black) * targets[which] ** panel.gamma
        light += (goal - light) * STEP_S / (panel.rise_s if goal > light else panel.fall_s)
        found[step] = light
    return found


@pytest.mark.parametrize("level", [255, 140])
def test_a_patch_is_as_bright_as_by_hand(level: int) -> None:
    facts = bench(room=0.04, blur_px=0.4)
    world = World(facts)
    at_s = 0.05 + REFRESH_S * np.array([0.0, 1.0, 3.0, 4.0])
    shows, lets = np.array([0, -1, 0, -1]), np.array([-1, 0, 0, -1])
    lit_at, open_at = (np.asarray(which + 1, dtype=np.float64) for which in (shows, lets))
    shown = Shown(
        at_s, shows, at_s, lets,
        [patch(facts.projector.size_px, level)], [patch(facts.mask.size_px)],
    )  # fmt: skip
    end_s = 0.21
    photo = world.expose(shown, 0.0, end_s, facts.room)
    width, height = world.frame
    t_s = np.asarray((np.arange(round(end_s / STEP_S)) + 0.5) * STEP_S, dtype=np.float64)
    for quad in ((width // 2, height // 2), (width // 2 + 30, height // 2 - 25)):
        at = world.camera_place.to_scene(np.array(quad) + 0.5)
        on_mask = world.mask_place.from_scene(at)
        lit = followed(facts.projector, at[1], at_s, level / 255.0 * lit_at, t_s)
        through = followed(facts.mask, on_mask[1], at_s, open_at, t_s)
        size = np.array(facts.projector.size_px)
        apart = np.sum(((at - size / 2) / (size / 2)) ** 2) / 2.0
        room = facts.room * (1.0 + facts.room_tilt * (at[0] / size[0] - 0.5))
        sums = (1.0 - facts.falloff * apart) * np.sum(lit * through) + room * np.sum(through)
        middle = (np.array(quad) + 0.5 - np.array(world.frame) / 2.0) / np.array(world.frame) * 2.0
        dimmed = 1.0 - facts.vignetting * np.sum(middle**2 * np.array(world.frame) ** 2) / np.sum(
            np.array(world.frame) ** 2
        )
        by_hand = sums * STEP_S * dimmed
        assert photo[quad[1], quad[0]] == pytest.approx(by_hand, rel=2e-3)


def test_all_true_light_adds_up_to_a_white_photo() -> None:
    for seed in range(4):  # all scenes
        facts = draw_facts(seed, small=True)
        facts = dataclasses.replace(
            facts, mask=dataclasses.replace(facts.mask, contrast=1e9),
            projector=dataclasses.replace(facts.projector, contrast=1e9), camera="tiny",
        )  # fmt: skip
        world = World(facts, Stands(stands="scene"))
        width, height = facts.projector.size_px
        y, x = np.mgrid[0:height, 0:width]
        cells = (y * 6 // height * 8 + x * 8 // width).ravel()
        light = world.true_pictures(cells, (6, 8))
        pictures = [np.full((p.size_px[1], p.size_px[0]), 255, np.uint8)
                    for p in (facts.projector, facts.mask)]  # fmt: skip
        far = np.array([-9.0])
        shown = Shown(far, np.array([0]), far, np.array([0]), [pictures[0]], [pictures[1]])
        photo = world.expose(shown, 0.0, 1.0, 0.0)
        seen = world.mask_seen()
        assert np.allclose(np.sum(list(light.values()), axis=0)[seen], photo[seen], rtol=1e-3)


def test_places_lead_back_and_typed_maps_say_the_same() -> None:
    facts = draw_facts(2)
    maps, size_px = true_maps(facts), facts.projector.size_px
    place = Place(facts.mask_place, facts.mask.size_px, size_px)
    points = np.random.default_rng(0).uniform(0.0, 1.0, (50, 2)) * np.array(facts.mask.size_px)
    on_scene = place.to_scene(points)
    assert np.allclose(place.from_scene(on_scene), points, atol=1e-6)
    on_field = maps["projector"].to_field(on_scene)
    assert np.allclose(maps["mask"].to_field(points), on_field, atol=1e-6)


def test_an_error_is_what_was_put_in() -> None:
    rng = np.random.default_rng(3)
    true = rng.uniform(0.5, 1.0, (40, 50, 3))
    sigma = np.full(true.shape, 0.01)
    image = 1.1 * (true + 0.01 * rng.standard_normal(true.shape))
    sigma[:4] = np.inf
    image[:4] = 9.0  # said to be unknown: not compared
    found = compare_arrays(image, 1.1 * sigma, true, 0.1 * true, np.ones((40, 50), np.bool_))
    assert found.scale == pytest.approx(1.0 / 1.1, rel=1e-3)
    assert found.error == pytest.approx(0.1, rel=0.02)
    assert found.error_scaled == pytest.approx(0.01 / np.sqrt(np.mean(true**2)), rel=0.05)
    assert found.covered == pytest.approx(0.95, abs=0.01)
    assert found.near == pytest.approx(0.1, rel=0.01)
    assert found.unknown == pytest.approx(0.1)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Found]:
    """A small bench that pdcd knew from data sheets, and found the places and times of."""
    folder = tmp_path_factory.mktemp("stranger")
    facts = draw_facts(1, small=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(benches.PACKAGE))
        files = benches.write_bench(facts, folder)
        # What the step of light would find: colours have factors of their own.
        told = f"[camera]\nresponsivity_e = {list(facts.responsivity_e)}\n"
        files["sheet"].write_text(files["sheet"].read_text().replace("[camera]\n", told))
        done = calibrate(files["sheet"], folder, Stands(stands="card"), "geometry", "timing")
        assert done["state"] == "done", done["cause"]
        assert done["passed"]
        yield facts, folder, files


@pytest.mark.whole
@pytest.mark.timeout(600)  # a minute and a half of a processor
def test_a_stranger_is_photographed_as_if_it_were_known(found: Found) -> None:
    """One common factor apart: the steps that find it are left out."""
    facts, folder, files = found
    scene = Stands(stands="scene")
    taken = photograph(files["sheet"], folder, facts, scene, "indirect", **CODES)
    true = photograph(files["truth"], folder, facts, scene, "indirect", **CODES)
    assert taken["state"] == "done"
    assert taken["verdict"] == "good", taken["reasons"]
    assert taken["error_scaled"] <= max(1.3 * true["error_scaled"], 0.003)


@pytest.mark.whole
def test_a_stranger_whose_mask_was_moved_is_not_called_good(found: Found) -> None:
    facts, folder, files = found
    moved = Stands(stands="scene", mask_shift_px=(16.0, -12.0))
    taken = photograph(files["sheet"], folder, facts, moved, "indirect", **CODES)
    assert taken["state"] != "done" or taken["verdict"] != "good"
