"""Priors by their words: what they link, and which are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.planning import prior
from pdcd.planning.prior import PRIOR_GRID, load_prior, sum_scene_links
from pdcd.protocol.request import SentArray
from pdcd.virtual.scene.matrix import split_into_effects
from pdcd.virtual.scene.presets import PRESETS
from pdcd.virtual.scene.scene import Scene

SMALL = (3, 4)
CELLS = 12
RNG = np.random.default_rng(0)
MATRIX = RNG.random((CELLS, CELLS))
GIVEN: Any = {"prior": MATRIX, PRIOR_GRID: np.array([[3.0, 4.0]])}


def test_a_decay_falls_off_with_the_distance_until_it_is_faint() -> None:
    """Of cells in a row of 9: exp(-d / 1), and nothing from a thousandth of the first on."""
    found = load_prior("decay:1", (1, 9))
    links = found.links.toarray()
    ahead = np.abs(np.subtract.outer(np.arange(9), np.arange(9)))
    wanted = np.where((ahead > 0) & (ahead <= 7), np.exp(-ahead.astype(float)), 0.0)
    np.testing.assert_allclose(links, wanted, rtol=1e-12)
    assert found.name == "decay 1 cells" and found.scene is None
    half = load_prior("decay:0.5", SMALL).links.toarray()
    assert half[0, 5] == pytest.approx(np.exp(-np.sqrt(2.0) / 0.5))
    assert half[0, 1] == half[0, 4] == pytest.approx(np.exp(-2.0))
    assert half[3, 4] == pytest.approx(np.exp(-np.hypot(1.0, 3.0) / 0.5))
    assert not np.diag(half).any()


@pytest.mark.parametrize(
    "text", ["decay:", "decay:x", "decay:0", "decay:-1", "decay:inf", "decay:nan"]
)
def test_a_decay_without_a_distance_is_refused(text: str) -> None:
    with pytest.raises(RequestError, match=f"{text} names no distance above 0") as caught:
        load_prior(text, SMALL)
    assert "decay:3" in str(caught.value.hint)


def test_a_preset_scene_is_one_over_the_cells_of_the_rig() -> None:
    found = load_prior("scene:wax-disk", (6, 8))
    assert found.scene is not None and found.scene.grid == (6, 8)
    assert found.name == f"scene {found.scene.name}" == "scene wax-disk"
    off = PRESETS["wax-disk"]((6, 8), {}).dense().mean(axis=0)
    np.fill_diagonal(off, 0.0)
    np.testing.assert_allclose(found.links.toarray(), off, atol=1e-12)
    with pytest.raises(RequestError, match="scene:nowhere is no preset scene") as caught:
        load_prior("scene:nowhere", SMALL)
    assert "wax-disk" in str(caught.value.hint)


@pytest.mark.parametrize("asked", ["a/b/room.npz", SentArray(file="b/room.npz"), "room.npz"])
def test_a_file_is_its_matrix_without_the_light_of_cells_on_themselves(asked: Any) -> None:
    found = load_prior(asked, SMALL, GIVEN)
    assert found.name == "file room.npz"
    assert found.scene is not None
    assert (found.scene.name, found.scene.grid) == ("room", SMALL)
    wanted = MATRIX.copy()
    np.fill_diagonal(wanted, 0.0)
    np.testing.assert_allclose(found.links.toarray(), wanted)
    np.testing.assert_allclose(found.scene.dense()[1], MATRIX)
    assert load_prior(SentArray(), SMALL, GIVEN).name == "file without a name"


def test_a_file_that_did_not_come_or_is_of_other_cells_is_refused() -> None:
    with pytest.raises(RequestError, match=r"there is no prior room.npz") as caught:
        load_prior("room.npz", SMALL)
    assert "decay:CELLS" in str(caught.value.hint)
    for grid in ((4, 3), (2, 6)):
        words = rf"room.npz is of 3 x 4 cells, the rig of {grid[0]} x {grid[1]}"
        with pytest.raises(RequestError, match=words) as caught:
            load_prior("room.npz", grid, GIVEN)
        assert caught.value.hint


def test_links_are_the_mean_of_colours() -> None:
    colours = RNG.random((CELLS, CELLS, 3))
    scene = Scene("colours", SMALL, split_into_effects(colours))
    wanted = colours.mean(axis=2)
    np.fill_diagonal(wanted, 0.0)
    np.testing.assert_allclose(sum_scene_links(scene).toarray(), wanted, rtol=1e-12)


def test_more_cells_than_pairs_of_them_can_be_held_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(RequestError, match="6145 cells has too many paths; the most is 6144"):
        load_prior("decay:3", (5, 1229))
    monkeypatch.setattr(prior, "MOST_PRIOR_CELLS", CELLS)
    assert load_prior("decay:3", SMALL).links.shape == (CELLS, CELLS)
    with pytest.raises(RequestError, match="13 cells has too many") as caught:
        load_prior("decay:3", (1, 13))
    assert "coarser grid" in str(caught.value.hint)
