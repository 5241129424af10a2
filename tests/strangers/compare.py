"""Pictures of a run against the truth of the stranger's own renderer, quad by quad.

What is counted: an indirect picture shows light that fell first on another cell than the one that
sends it to the camera ("near" + "far" of `World.true_pictures`); a direct one shows the rest, for
codes of one value a cell cannot tell scattering within a cell from direct light. Cells are the
run's own. Compared are quads that look through the mask at lit points of cells alone, blur and all,
and whose sigma is finite: what the run says it does not know is only counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import pdcd
from pdcd.bench.config import from_config_tables
from pdcd.bench.placed import panels_of
from pdcd.panels.atoms import ATOMS_PER_CELL, find_atoms
from tests.strangers.package.strangers_bench.world import World

Floats = NDArray[np.float64]

COVERED = 1.96
WHOLE = 0.999
"""Share of a quad's light that is all of it."""


@dataclass(frozen=True)
class Compared:
    """One picture against the truth. Shares are of the true picture's RMS.

    error : RMS difference as it stands; error_scaled: after one common factor.
    scale : that factor, all light over all light: what the run's pictures must be multiplied by.
        One of least squares would be less by the square of the error.
    near : RMS of light from neighbouring cells, which smaller windows may lose.
    sigma : RMS of the sigma that the run states, times that factor.
    covered : share of values whose truth lies within 1.96 sigma, after the common factor.
    unknown : share of the quads that could be seen which the run gives no sigma for.
    """

    error: float
    error_scaled: float
    scale: float
    near: float
    sigma: float
    covered: float
    unknown: float


def cells_of(run: pdcd.Run) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """The cell that each pixel of the projector shows in a run's codes, -1 for none, and the
    grid."""
    config = from_config_tables(dict(run.manifest.config), "the run's configuration")
    atom = find_atoms(panels_of(config).projector, run.grid)
    lit = atom[..., 0] >= 0
    cell = atom[..., 1] // ATOMS_PER_CELL * run.grid[1] + atom[..., 0] // ATOMS_PER_CELL
    return np.where(lit, cell, -1).ravel().astype(np.int64), run.grid


def true_answers(world: World, run: pdcd.Run) -> dict[str, Floats]:
    """ "white", "indirect", "direct" and "near" of a run, (h, w, 3), in scene units."""
    light = world.true_pictures(*cells_of(run))
    indirect = light["near"] + light["far"]
    direct = light["direct"] + light["own"]
    return {"white": direct + indirect, "indirect": indirect, "direct": direct,
            "near": light["near"]}  # fmt: skip


def _within(world: World, run: pdcd.Run) -> NDArray[np.bool_]:
    """Quads whose direct light all comes from cells, (h, w): nothing is lit beside these, and a run
    tells what quads at their border would see if more were."""
    cells, _ = cells_of(run)
    here, all_lit = (
        world.true_pictures(lit, (1, 1))["direct"]
        for lit in (np.where(cells >= 0, 0, -1), np.zeros_like(cells))
    )
    return np.asarray((here > WHOLE * all_lit).all(axis=-1))


def compare(run: pdcd.Run, world: World, names: Sequence[str]) -> dict[str, Compared]:
    """Pictures of a run against the truth, by name."""
    true, seen = true_answers(world, run), world.mask_seen() & _within(world, run)
    decoded = run.decode(progress=False).pictures
    found = {}
    for name in names:
        image, sigma = (
            np.asarray(a, np.float64) for a in (decoded[name].image, decoded[name].sigma)
        )
        found[name] = compare_arrays(image, sigma, true[name], true["near"], seen)
    return found


def compare_arrays(
    image: Floats, sigma: Floats, true: Floats, near: Floats, seen: NDArray[np.bool_]
) -> Compared:
    """The same of arrays (h, w, 3); seen (h, w)."""
    known = seen[..., None] & np.isfinite(sigma)
    level = float(np.sqrt(np.mean(true[known] ** 2))) if known.any() else np.nan
    off = image - true
    scale = float(np.sum(true[known]) / np.sum(image[known]))
    scaled = scale * image - true
    return Compared(
        error=_rms(off[known]) / level,
        error_scaled=_rms(scaled[known]) / level,
        scale=scale,
        near=_rms(near[known]) / level,
        sigma=scale * _rms(sigma[known]) / level,
        covered=float(np.mean(abs(scaled[known]) <= COVERED * scale * sigma[known])),
        unknown=float(1.0 - np.mean(np.isfinite(sigma[seen]))),
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")
