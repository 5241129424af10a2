"""The pictures of a run as the scene really is: by its known transport, through the same optics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.pictures.truth import apply_probing_matrix
from pdcd.recipes.recipe import Extremes, Recipe, Rule
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
) -> dict[str, _Image]:
    """Every picture of a recipe as the camera's quads would have it of a perfect run, by name.

    Each (h, w, 3), scene units. Extremes of photos are taken quad by quad, as of photos. `alive` is
    called now and then, and may raise to end the work. `kept` holds those that are known already.
    """
    photos = _Photos(recipe, optics, alive)
    return {
        name: kept[name] if name in kept else photos.picture(name, rule)
        for name, rule in recipe.pictures.items()
    }


class _Photos:
    """True photos, each worked out when it is first wanted."""

    def __init__(self, recipe: Recipe, optics: OpticalBench, alive: Callable[[], None]) -> None:
        self._recipe, self._optics, self._alive = recipe, optics, alive
        self._wanted = {photo.name: photo.wanted for photo in recipe.photos}
        self._known: dict[str, Floats] = {}

    def picture(self, name: str, rule: Rule) -> Floats:
        """What a rule makes of the true photos; the answer of an estimate is what it estimates."""
        recipe = self._recipe
        if name == recipe.answer_name and recipe.meant is not None:
            meant = recipe.meant
            return self._optics.wanted(
                lambda part: apply_probing_matrix(part, meant, self._alive),
                meant,
                self._alive,
                grid=recipe.target.grid,
            )
        if isinstance(rule, Extremes):
            stack = np.stack([self._photo(photo) for photo in rule.photos])
            return np.asarray(rule.largest * stack.max(axis=0) + rule.smallest * stack.min(axis=0))
        return np.asarray(sum(weight * self._photo(photo) for weight, photo in rule))

    def _photo(self, name: str) -> Floats:
        if name not in self._known:
            wanted = self._wanted[name]

            def seen(part: Scene) -> Floats:
                return apply_probing_matrix(part, wanted, self._alive)

            grid = self._recipe.target.grid
            self._known[name] = self._optics.wanted(seen, wanted, self._alive, grid=grid)
        return self._known[name]
