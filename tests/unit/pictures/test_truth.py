"""True images of goals, against the transport and the wanted matrix written out."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.pictures.truth import apply_probing_matrix
from pdcd.probing.wanted import (
    FullPart,
    MatchPart,
    MatrixPart,
    NearPart,
    OuterPart,
    UniformPart,
    WantedMatrix,
    shift_cells,
)
from pdcd.virtual.scene.presets import PRESETS

GRID = (6, 8)
CELLS = GRID[0] * GRID[1]
RNG = np.random.default_rng(0)
LIGHT = np.where(RNG.random(CELLS) < 0.3, 0.0, RNG.random(CELLS))
ALL, SAME = (1.0, UniformPart(CELLS)), (-1.0, MatchPart(np.arange(CELLS)))
REGION = (0.5, OuterPart(RNG.random(CELLS), RNG.random(CELLS)))


@pytest.mark.parametrize("light", [None, LIGHT])
@pytest.mark.parametrize(
    "parts",
    [
        (ALL,),
        (ALL, SAME),
        (ALL, REGION),
        (ALL, REGION, SAME),
        (ALL, (-1.0, NearPart(GRID, 1))),
        (SAME, (1.0, MatchPart(shift_cells(GRID, (1, -1))))),
        ((1.0, FullPart(RNG.normal(size=(CELLS, CELLS)))), ALL),
    ],
)
@pytest.mark.parametrize("kind", ["mirror-and-vase", "milky-bottle"])
def test_it_is_the_sum_over_all_paths(
    kind: str, parts: tuple[tuple[float, MatrixPart], ...], light: np.ndarray | None
) -> None:
    scene = PRESETS[kind](GRID, {})
    wanted = WantedMatrix(GRID, parts, light)
    whole = np.einsum("nm,cnm->nc", wanted.dense(), scene.dense())
    np.testing.assert_allclose(apply_probing_matrix(scene, wanted), whole, rtol=1e-12, atol=1e-12)
