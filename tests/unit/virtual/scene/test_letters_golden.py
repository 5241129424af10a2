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


def test_the_same_letters_can_be_written() -> None:
    with np.load(GOLDEN) as golden:
        assert set(golden) == {f"ink of {ord(letter)}" for letter in letters.STROKES}


def test_a_line_is_its_letters_side_by_side() -> None:
    """Each begins where the one before has moved the pen to, to half a pixel."""
    size = 20.0
    whole = letters.draw_text_line("ab b", size)
    assert whole.shape[0] == 48  # 1.75 above and 0.65 below the base line
    steps = [letters.measure_text("a", size), letters.measure_text("ab ", size)]
    assert letters.measure_text("ab b", size) == pytest.approx(
        steps[1] + letters.measure_text("b", size)
    )
    assert steps[1] == pytest.approx(steps[0] + letters.measure_text("b", size) + 0.5 * size)
    assert whole.shape[1] == int(np.ceil(letters.measure_text("ab b", size))) + 2
    first, other = letters.draw_text_line("a", size), letters.draw_text_line("b", size)
    np.testing.assert_array_equal(whole[:, : first.shape[1] - 4], first[:, :-4])
    for begin in steps:
        ink = whole[:, round(begin) : round(begin) + other.shape[1] - 2].sum()
        assert ink == pytest.approx(other.sum(), rel=0.02)


def test_upright_strokes_are_thick_and_level_ones_thin() -> None:
    """In the middle of the stem of an l, and of the top bar of a T."""
    size = 40.0
    stem = letters.draw_text_line("l", size)
    assert stem[40].sum() == pytest.approx(2.0 * 0.165 * size, abs=0.5)
    bar = letters.draw_text_line("T", size)
    column = round((0.165 + 0.25) * size)
    assert bar[:, column].sum() == pytest.approx(2.0 * 0.10 * size, abs=0.5)


if __name__ == "__main__":
    kept = {f"ink of {ord(letter)}": profiles(letter) for letter in letters.STROKES}
    np.savez_compressed(GOLDEN, **{n: v.astype(np.float32) for n, v in kept.items()})  # type: ignore[arg-type]
