"""What is said to be known of a scene before the first photo: a prior, as a request names it.

======================  ============================================================
``FILE.npz``            a transport matrix over the rig's cells, as scenes are read
``scene:NAME``          a preset scene over the rig's grid, such as ``scene:disco-ball``
``decay:CELLS``         light that falls off as ``exp(-d / CELLS)`` with the distance d
======================  ============================================================

Only what is large beside the rest matters, not the unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse
from scipy.sparse import csr_array

from pdcd.errors import ConfigError
from pdcd.scene.matrix import load_matrix, matrix_effects
from pdcd.scene.presets import PRESETS
from pdcd.scene.scene import Scene

MOST_CELLS = 6144
"""Cells beyond which the paths between all pairs of them, 300 MB here, are too many to hold."""
FAINT = 1e-3
"""Share of the strength between neighbours below which a decay counts as none."""
FORMS = "give the absolute path of an .npz file, scene:NAME or decay:CELLS"


@dataclass(frozen=True)
class GivenPrior:
    """A prior, read and checked.

    name : what it is, for people.
    links : sparse CSR (N, N) float64, strength of the paths from cell to cell, 0 on the diagonal.
    scene : a scene to foresee photos of; None for a decay, which knows no direct light.
    """

    name: str
    links: csr_array
    scene: Scene | None


def load_prior(text: str, grid: tuple[int, int]) -> GivenPrior:
    """Read a prior for a rig of that grid.

    Raises
    ------
    ConfigError
        The text is none of the forms above, the file is unsound or of another grid, or the grid has
        too many cells.
    """
    cells = grid[0] * grid[1]
    if cells > MOST_CELLS:
        raise ConfigError(
            f"a prior for {cells} cells has too many paths; the most is {MOST_CELLS} cells",
            hint="leave out the prior, or use a coarser grid",
        )
    kind, colon, rest = text.partition(":")
    if colon and kind == "decay":
        return _decay(rest, grid)
    scene = _preset(rest, grid) if colon and kind == "scene" else _file(text, grid)
    name = f"scene {scene.name}" if colon and kind == "scene" else f"file {Path(text).name}"
    return GivenPrior(name, links_of(scene), scene)


def links_of(scene: Scene) -> csr_array:
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
        raise ConfigError(
            f"the prior decay:{text} names no distance above 0",
            hint="say over how many cells light falls to 37 %, such as decay:3",
        )
    row, column = np.divmod(np.arange(grid[0] * grid[1]), grid[1])
    strength = np.exp(-np.hypot(row[:, None] - row, column[:, None] - column) / length)
    np.fill_diagonal(strength, 0.0)
    strength[strength < FAINT * np.exp(-1.0 / length)] = 0.0
    return GivenPrior(f"decay {length:g} cells", scipy.sparse.csr_array(strength), None)


def _preset(name: str, grid: tuple[int, int]) -> Scene:
    if name not in PRESETS:
        raise ConfigError(
            f"the prior scene:{name} is no preset scene",
            hint=f"one of {', '.join(sorted(PRESETS))}",
        )
    return PRESETS[name](grid, {})


def _file(text: str, grid: tuple[int, int]) -> Scene:
    path = Path(text)
    if not path.is_file():
        raise ConfigError(f"there is no prior {text}", hint=FORMS)
    transport, own = load_matrix(path)
    if own != grid:
        raise ConfigError(
            f"the prior {path} is of {own[0]} x {own[1]} cells, the rig of {grid[0]} x {grid[1]}",
            hint="give a transport matrix over the rig's cells",
        )
    return Scene(path.stem, own, matrix_effects(transport))
