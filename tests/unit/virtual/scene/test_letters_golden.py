"""Letters of the font look as they did: how much ink is in each row and column of each.

`tests/data/letters.npz` has both sums of every letter. Where one is changed on purpose, write it
anew by ``python -m tests.unit.virtual.scene.test_letters_golden``, and look at the scenes again.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.virtual.scene.presets import letters
from tests.places import DATA

GOLDEN = DATA / "letters.npz"
SIZE_PX = 24.0
NEAR = 0.02
"""Of a pixel's ink."""


def profiles(letter: str) -> NDArray[np.float64]:
    """Ink of each row, and then of each column."""
    image = letters.draw_text_line(letter, SIZE_PX).astype(np.float64)
    return np.concatenate([image.sum(axis=1), image.sum(axis=0)])


@pytest.mark.parametrize("letter", sorted(letters.STROKES))
def test_a_letter_looks_as_it_did(letter: str) -> None:
    with np.load(GOLDEN) as golden:
        wanted = golden[f"ink of {ord(letter)}"].astype(np.float64)
    found = profiles(letter)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() <= NEAR


if __name__ == "__main__":
    kept = {f"ink of {ord(letter)}": profiles(letter) for letter in letters.STROKES}
    np.savez_compressed(GOLDEN, **{n: v.astype(np.float32) for n, v in kept.items()})  # type: ignore[arg-type]
