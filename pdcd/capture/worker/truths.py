"""The true pictures of a run: from the scene's known transport, through the same optics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.pictures.truth import apply_probing_matrix
from pdcd.probing.wanted import WantedMatrix
from pdcd.recipes.recipe import Extremes, Recipe, Rule
from pdcd.sensor.profile import weigh_colours
from pdcd.virtual.scene.scene import Scene

if TYPE_CHECKING:
    from pdcd.virtual.optics.bench import OpticalBench

_Image = NDArray[np.floating]
_NOTHING: Mapping[str, _Image] = MappingProxyType({})


def compute_true_pictures(
    recipe: Recipe,
    optics: OpticalBench,
    alive: Callable[[], None] = lambda: None,
    kept: Mapping[str, _Image] = _NOTHING,
    *,
    colours: int = 3,
) -> dict[str, _Image]:
    """Every picture of a recipe as the camera's quads would show it in a perfect run, by name.

    Each is (h, w, C) with so many `colours`, in scene units. Extremes of photos are taken quad by
    quad, as in photos. `alive` is called now and then, and may raise to end the work. `kept` holds
    pictures that are known already.
    """
    photos = _Photos(recipe, optics, colours, alive)
    return {
        name: kept[name] if name in kept else photos.picture(name, rule)
        for name, rule in recipe.pictures.items()
    }


class _Photos:
    """True photos, each computed when it is first needed."""

    def __init__(
        self, recipe: Recipe, optics: OpticalBench, colours: int, alive: Callable[[], None]
    ) -> None:
        self._recipe, self._optics, self._colours, self._alive = recipe, optics, colours, alive
        self._wanted = {photo.name: photo.wanted for photo in recipe.photos}
        self._known: dict[str, Floats] = {}

    def picture(self, name: str, rule: Rule) -> Floats:
        """What a rule makes of the true photos; where the answer is an estimate, what it
        estimates."""
        recipe = self._recipe
        if name == recipe.answer_name and recipe.meant is not None:
            return self._seen(recipe.meant)
        if isinstance(rule, Extremes):
            stack = np.stack([self._photo(photo) for photo in rule.photos])
            return np.asarray(rule.largest * stack.max(axis=0) + rule.smallest * stack.min(axis=0))
        return np.asarray(sum(weight * self._photo(photo) for weight, photo in rule))

    def _photo(self, name: str) -> Floats:
        if name not in self._known:
            self._known[name] = self._seen(self._wanted[name])
        return self._known[name]

    def _seen(self, wanted: WantedMatrix) -> Floats:
        """The scene through a wanted matrix."""

        def answer(part: Scene) -> Floats:
            return apply_probing_matrix(part, wanted, self._alive)

        grid = self._recipe.target.grid
        image = self._optics.wanted(answer, wanted, self._alive, grid=grid)
        return weigh_colours(image, self._colours)
