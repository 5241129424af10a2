"""True images of goals, against the transport and the wanted matrix written out."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.pictures.truth import probe
from pdcd.probing.wanted import Full, Match, Near, Outer, Part, Uniform, Wanted, shifted
from pdcd.virtual.scene.presets import PRESETS

GRID = (6, 8)
CELLS = GRID[0] * GRID[1]
RNG = np.random.default_rng(0)
LIGHT = np.where(RNG.random(CELLS) < 0.3, 0.0, RNG.random(CELLS))
ALL, SAME = (1.0, Uniform(CELLS)), (-1.0, Match(np.arange(CELLS)))
REGION = (0.5, Outer(RNG.random(CELLS), RNG.random(CELLS)))


@pytest.mark.parametrize("light", [None, LIGHT])
@pytest.mark.parametrize(
    "parts",
    [
        (ALL,),
        (ALL, SAME),
        (ALL, REGION),
        (ALL, REGION, SAME),
        (ALL, (-1.0, Near(GRID, 1))),
        (SAME, (1.0, Match(shifted(GRID, (1, -1))))),
        ((1.0, Full(RNG.normal(size=(CELLS, CELLS)))), ALL),
    ],
)
@pytest.mark.parametrize("kind", ["open-book", "wax-disk", "mirror-and-vase", "milky-bottle"])
def test_it_is_the_sum_over_all_paths(
    kind: str, parts: tuple[tuple[float, Part], ...], light: np.ndarray | None
) -> None:
    scene = PRESETS[kind](GRID, {})
    wanted = Wanted(GRID, parts, light)
    whole = np.einsum("nm,cnm->nc", wanted.dense(), scene.dense())
    np.testing.assert_allclose(probe(scene, wanted), whole, rtol=1e-12, atol=1e-12)
