"""The true picture, where the scene is one whose transport is known."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.bench.tables import Config
from pdcd.errors import DecodeError, disk_errors
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.to_quads import expand_to_quads
from pdcd.probing.wanted import WantedMatrix
from pdcd.recipes.recipe import Extremes, Recipe
from pdcd.runs.patterns import read_stored_arrays
from pdcd.sensor.cells import CellMap
from pdcd.sensor.profile import weigh_colours
from pdcd.sensor.raw import shrink_image
from pdcd.virtual.optics.needed import choose_optics
from pdcd.virtual.scene.scene import Scene

TRUTH = "truth.npz"
"""The true answer, in the folder of a run of a virtual scene."""
TRUTH_BLOCK_ROWS = 256
"""Rows of the wanted matrix taken together; bounds the memory."""


@dataclass(frozen=True)
class KnownAnswer:
    """The true answer, in scene units, and where it can be compared.

    On a bench of cells `image` is (N, C) and `seen` (N,), of cells, to be compared with means over
    them. On a bench of pixels they are (h, w, C) and (h, w), of quads: the truth is seen through
    the same optics, and compared where it lies wholly inside the field.
    """

    image: NDArray[np.floating]
    seen: Bools
    of_cells: bool

    def rms_errors(
        self, picture: PictureWithErrors, means: PictureWithErrors, cells: CellMap
    ) -> tuple[float | None, float | None]:
        """RMS error of the answer over the RMS of the truth, where both are known: of its quads,
        and of its means over the cells. None where the truth is dark, or nothing is known."""
        truth = self.on_cells(cells)
        by_cells = _rms_error(means, truth, np.asarray(np.isfinite(truth).all(axis=-1)))
        if self.of_cells and cells.frame == cells.grid:
            return by_cells, by_cells  # a quad is a cell
        return _rms_error(picture, *self.on_quads(cells)), by_cells

    def binned(self, side: int) -> KnownAnswer:
        """The same on squares of `side` x `side` quads."""
        if self.of_cells or side == 1:
            return self
        image = shrink_image(self.image.astype(np.float32), side)
        return KnownAnswer(
            image, shrink_image(self.seen.astype(np.float32), side) == 1.0, of_cells=False
        )

    def on_cells(self, cells: CellMap) -> Floats:
        """Means over the cells, (rows, cols, C) float64; NaN where a cell cannot be compared."""
        seen = self.seen if self.of_cells else cells.seen(self.seen)
        image = self.image if self.of_cells else cells.mean(self.image, self.seen)
        whole = np.where(seen[:, None], image, np.nan).astype(np.float64)
        return whole.reshape(*cells.grid, image.shape[1])

    def on_quads(self, cells: CellMap) -> tuple[NDArray[np.floating], Bools]:
        """The same on the camera's quads, (h, w, C) and (h, w)."""
        if not self.of_cells:
            return self.image, self.seen
        return expand_to_quads(self.image, cells, None), expand_to_quads(self.seen, cells, None)


def _rms_error(found: PictureWithErrors, truth: NDArray[np.floating], seen: Bools) -> float | None:
    """Compared where `seen`; `truth` has the shape of the picture's image."""
    known = seen & np.isfinite(found.sigma).all(axis=-1)
    image, truth = found.image[known], truth[known]
    scale = float(np.sum(truth**2))
    return float(np.sqrt(np.sum((image - truth) ** 2) / scale)) if scale else None


def write_known_answer(folder: Path, known: KnownAnswer) -> None:
    """Keep it in a run folder, in single precision. Raises NoSpaceError, or DiskError for any other
    refusal of the disk."""
    with disk_errors(str(folder)), (folder / TRUTH).open("wb") as file:
        image = known.image.astype(np.float32)
        np.savez(file, image=image, seen=known.seen, of_cells=np.array(known.of_cells))


def read_known_answer(folder: Path, cells: CellMap) -> KnownAnswer:
    """What `write_known_answer` stored, in a run with that map of its cells. Raises DecodeError."""
    kept = read_stored_arrays(folder / TRUTH)
    image, seen, of_cells = (kept.get(name, np.zeros(0)) for name in ("image", "seen", "of_cells"))
    shape = (cells.grid[0] * cells.grid[1],) if of_cells.any() else cells.frame
    fits = seen.shape == shape and image.shape in ((*shape, 3), (*shape, 1))
    if not fits or image.dtype != np.float32 or seen.dtype != np.bool_:
        raise DecodeError(f"{folder / TRUTH} does not fit the run", hint="restore it from a copy")
    return KnownAnswer(image, seen, of_cells=bool(of_cells.any()))


def find_known_answer(
    config: Config,
    scene: Scene | None,
    recipe: Recipe,
    windows: Iterable[str],
    cells: CellMap | None,
    alive: Callable[[], None] = lambda: None,
    *,
    colours: int = 3,
) -> KnownAnswer | None:
    """The truth of a recipe's answer; None where it is not known.

    windows : of the recipe's shots. cells : the map of the camera's frame. colours : of its sensor
    (`weigh_colours`). `alive` is called now and then, and may raise to end the work.
    """
    if scene is None or cells is None:
        return None
    optics = choose_optics(config, scene, ("whole", *windows))
    if optics is None:
        answer = compute_true_answer(scene, recipe, alive, colours=colours)
        return KnownAnswer(answer, cells.seen(), of_cells=True)
    if optics.frame != cells.frame or isinstance(recipe.answer, Extremes):
        return None  # a bench of pixels can only compute what is linear in a scene's effects
    meant, grid = recipe.wanted if recipe.meant is None else recipe.meant, recipe.target.grid
    if not optics.tells(meant, grid):
        return None
    image = optics.wanted(
        lambda part: compute_true_answer(part, recipe, alive), meant, alive, grid=grid
    )
    return KnownAnswer(weigh_colours(image, colours), optics.inside_of(grid), of_cells=False)


def compute_true_answer(
    scene: Scene, recipe: Recipe, alive: Callable[[], None] = lambda: None, *, colours: int = 3
) -> NDArray[np.float64]:
    """A recipe's true answer, (N, C), in scene units, without ambient light.

    `alive` is called now and then, and may raise to end the work.
    """
    rule = recipe.answer
    if recipe.meant is not None:
        return weigh_colours(apply_probing_matrix(scene, recipe.meant, alive), colours)
    if not isinstance(rule, Extremes):
        return weigh_colours(apply_probing_matrix(scene, recipe.wanted, alive), colours)
    wanted = {photo.name: photo.wanted for photo in recipe.photos}
    photos = [apply_probing_matrix(scene, wanted[name], alive) for name in rule.photos]
    images = weigh_colours(np.stack(photos), colours)
    return np.asarray(rule.largest * images.max(axis=0) + rule.smallest * images.min(axis=0))


def apply_probing_matrix(
    scene: Scene, wanted: WantedMatrix, alive: Callable[[], None] = lambda: None
) -> NDArray[np.float64]:
    """``(Pi o T) 1`` with the wanted matrix itself, (N, 3), in scene units, without ambient light.

    Eq. 2 of the paper. Parts that are products cost one pass over the transport, and direct light
    none. Others are evaluated row by row, in O(N^2): a scene does not give single entries of T.
    """
    direct, indirect = scene.split()
    if wanted.uniform is not None:
        diagonal, off = wanted.uniform
        return diagonal * direct + off * indirect
    nothing = np.zeros(scene.cells)
    camera, projector = wanted.products()
    banded = wanted.banded()
    image = direct * banded.diagonal()[:, None]
    if len(camera):
        image += scene.photo(camera, projector, np.sum(camera * projector, axis=0), nothing)
    if not banded.squares().any():
        return image
    for start in range(0, scene.cells, TRUTH_BLOCK_ROWS):
        alive()
        stop = min(start + TRUTH_BLOCK_ROWS, scene.cells)
        rows = banded.rows(start, stop)
        pick = np.zeros((stop - start, scene.cells))
        here = np.arange(stop - start), np.arange(start, stop)
        pick[here], rows[here] = 1.0, 0.0
        image += scene.photo(pick, rows, nothing, nothing)
    return image


def compute_true_entries(
    scene: Scene, seen: NDArray[np.int64], lit: NDArray[np.int64], *, colours: int = 3
) -> NDArray[np.float64]:
    """Entries of T between camera cells `seen` (C,) and projector cells `lit` (J,), (C, J, 3), or
    (C, J, 1) for a sensor of one colour."""
    found = np.empty((seen.size, lit.size, 3))
    for start in range(0, lit.size, TRUTH_BLOCK_ROWS):
        some = lit[start : start + TRUTH_BLOCK_ROWS]
        light = np.zeros((some.size, scene.cells))
        light[np.arange(some.size), some] = 1.0
        found[:, start : start + TRUTH_BLOCK_ROWS] = scene.apply(light)[:, seen].transpose(1, 0, 2)
    return weigh_colours(found, colours)
