"""What is taken to be known of a scene before the first photo: a prior, as a request names it.

======================  ============================================================
a file, or its name     a transport matrix over the rig's cells, stored as scenes are
``scene:NAME``          a preset scene over the rig's grid, such as ``scene:disco-ball``
``decay:CELLS``         light that falls off as ``exp(-d / CELLS)`` with the distance d
======================  ============================================================

Only the strength of paths relative to the rest matters, not the unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from pdcd.errors import RequestError
from pdcd.protocol.request import SentArray
from pdcd.recipes.arrays import NO_ARRAYS, Given
from pdcd.virtual.scene.matrix import split_into_effects
from pdcd.virtual.scene.presets import find_builder, list_presets
from pdcd.virtual.scene.scene import Scene

MOST_PRIOR_CELLS = 6144
"""Most cells: the paths between all pairs of them take 300 MB."""
_FAINT = 1e-3
"""Share of the strength between neighbours below which a decay counts as none."""
_FORMS = "give an .npz file with a transport matrix, scene:NAME or decay:CELLS"
PRIOR_GRID = "prior.grid"
"""Key of the array [[rows, columns]] of the grid of the transport matrix "prior"."""


@dataclass(frozen=True)
class GivenPrior:
    """A prior, read and checked.

    name : what it is, for people.
    links : sparse CSR (N, N) float64, strength of the paths from cell to cell, 0 on the diagonal.
    scene : a scene to predict photos of; None for a decay, which has no direct light.
    """

    name: str
    links: scipy.sparse.csr_array
    scene: Scene | None


def load_prior(
    prior: str | SentArray, grid: tuple[int, int], given: Given = NO_ARRAYS
) -> GivenPrior:
    """The prior that a request names, for a rig of that grid.

    Parameters
    ----------
    given : with the transport "prior", (N, N), and its `PRIOR_GRID`, where the prior is a file.

    Raises
    ------
    RequestError
        The text is none of the forms above, the matrix is of another grid, or the grid has too
        many cells.
    """
    cells = grid[0] * grid[1]
    if cells > MOST_PRIOR_CELLS:
        raise RequestError(
            f"a prior for {cells} cells has too many paths; the most is {MOST_PRIOR_CELLS} cells",
            hint="leave out the prior, or use a coarser grid",
        )
    if isinstance(prior, str) and prior.startswith("decay:"):
        return _decay(prior.removeprefix("decay:"), grid)
    if isinstance(prior, str) and prior.startswith("scene:"):
        scene = _preset(prior.removeprefix("scene:"), grid)
        return GivenPrior(f"scene {scene.name}", sum_scene_links(scene), scene)
    file = prior if isinstance(prior, str) else prior.file or "without a name"
    scene = _file(Path(file).name, given, grid)
    return GivenPrior(f"file {Path(file).name}", sum_scene_links(scene), scene)


def sum_scene_links(scene: Scene) -> scipy.sparse.csr_array:
    """Paths of a scene between different cells, mean of R, G, B: sparse CSR (N, N)."""
    paths = np.zeros((scene.cells, scene.cells))
    for effect in scene.effects:
        if not effect.coaxial:
            paths += float(np.mean(effect.tint)) * effect.dense()
    np.fill_diagonal(paths, 0.0)
    return scipy.sparse.csr_array(paths)


def _decay(text: str, grid: tuple[int, int]) -> GivenPrior:
    try:
        length = float(text)
    except ValueError:
        length = np.nan
    if not (np.isfinite(length) and length > 0.0):
        raise RequestError(
            f"the prior decay:{text} names no distance above 0",
            hint="say over how many cells light falls to 37 %, such as decay:3",
        )
    row, column = np.divmod(np.arange(grid[0] * grid[1]), grid[1])
    strength = np.exp(-np.hypot(row[:, None] - row, column[:, None] - column) / length)
    np.fill_diagonal(strength, 0.0)
    strength[strength < _FAINT * np.exp(-1.0 / length)] = 0.0
    return GivenPrior(f"decay {length:g} cells", scipy.sparse.csr_array(strength), None)


def _preset(name: str, grid: tuple[int, int]) -> Scene:
    build = find_builder(name)
    if build is None:
        raise RequestError(
            f"the prior scene:{name} is no preset scene",
            hint=f"one of {', '.join(list_presets())}",
        )
    return build(grid, {})


def _file(name: str, given: Given, grid: tuple[int, int]) -> Scene:
    if "prior" not in given:
        raise RequestError(f"there is no prior {name}", hint=_FORMS)
    rows, columns = given[PRIOR_GRID].astype(int).ravel().tolist()
    if (rows, columns) != grid:
        raise RequestError(
            f"the prior {name} is of {rows} x {columns} cells, the rig of {grid[0]} x {grid[1]}",
            hint="give a transport matrix over the rig's cells",
        )
    return Scene(Path(name).stem, grid, split_into_effects(given["prior"]))
