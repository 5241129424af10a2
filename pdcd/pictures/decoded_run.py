"""What the photos of a run make: its pictures, and the shots that they were made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from pdcd.arrays import Bools, Floats
from pdcd.pictures.combine import compute_removed_share
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.to_cells import average_with_errors
from pdcd.pictures.transport import TransportSlice, solve_transport_slice
from pdcd.pictures.upright import FieldView
from pdcd.pictures.weights import sum_realised_matrices
from pdcd.probing.deviation import Deviation, measure_deviation
from pdcd.recipes.recipe import Recipe, RecipePhoto
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

_Alive = Callable[[], None]


@dataclass(frozen=True)
class DecodedRun:
    """All pictures of a run by name, the answer first, and the shots they were made from."""

    recipe: Recipe
    shots: dict[str, ExposedShot]
    pictures: dict[str, PictureWithErrors]
    """On the camera's own quads, (h, w, C)."""
    cells: CellMap
    view: FieldView
    """How the camera saw the field, for pictures that are to be upright on it."""
    sums: dict[str, ExposedShot] = field(default_factory=dict)
    """Weighted sums of single photos, which the recipe's photos refer to by name as to shots."""
    apart: Mapping[str, float] = field(default_factory=dict)
    """Share of the field in which the panels showed different cells, by shot of whole cells."""
    side: int = 1
    """Side, in quads of the camera, of the squares that the pictures' quads are means of."""
    dead: Bools | None = None
    """(h, w), quads that a white shot showed to be dead; all shots have them as saturated. None
    where this could not be found out."""
    full: Bools | None = None
    """(h, w), quads that light has saturated in a shot of the answer; None where there are none, or
    where the pictures' quads are means of several."""

    crossed: Mapping[str, tuple[Floats, Floats]] = field(default_factory=dict)
    """`pdcd.pictures.weights.RealisedMatrix.crossed` of shots of codes."""

    @property
    def answer(self) -> PictureWithErrors:
        """The picture that was asked for."""
        return self.pictures[self.recipe.answer_name]

    @cached_property
    def transport(self) -> TransportSlice | None:
        """Entries of T, where these were photographed. Raises DecodeError."""
        if self.recipe.target.goal.name != "transport":
            return None
        return solve_transport_slice(self.recipe, self.shots, self.cells, self.full)

    def takes_out(self, photo: RecipePhoto, normalise: NormaliseName) -> bool:
        """Whether direct light was taken out of a photo; not where there was too much of it."""
        shots = {**self.shots, **self.sums}
        share = compute_removed_share(photo, self.recipe, shots, self.cells, normalise=normalise)
        return share is not None

    def apart_in(self, photo: RecipePhoto) -> float:
        """Share of the field in which the panels showed different cells in all shots of a photo."""
        return min(self.apart.get(name, 0.0) for _, name in photo.shots)

    @cached_property
    def cell_means(self) -> PictureWithErrors:
        """The answer's means over the cells, (rows, cols, C)."""
        return average_with_errors(self.answer, self.cells, self.full)

    def deviations(self, alive: _Alive = lambda: None) -> dict[str, Deviation]:
        """For each photo, its realised probing matrix against the wanted one.

        `alive` is called now and then, and may raise to end the work.
        """
        shots = {**self.shots, **self.sums}
        return {
            p.name: measure_deviation(
                sum_realised_matrices(p.shots, shots), p.wanted, alive, self.apart_in(p)
            )
            for p in self.recipe.photos
        }
