"""Where a panel's light falls, and the faults of photos that tell nothing of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pdcd.calibration.geometry.lit import OFFSETS_QUADS, find_panel_light
from pdcd.calibration.photo import QuadPhoto
from pdcd.errors import CalibrationError

SHAPE = (80, 100)


def photo(light: float, *, sigma: float = 1.0, room: float = 10.0, share: float = 1.0,
          noise: bool = True, seed: int = 0) -> QuadPhoto:  # fmt: skip
    """A panel that lights the left `share` of the picture, in the room's light."""
    values = np.full((*SHAPE, 3), room)
    values[:, : round(share * SHAPE[1])] += light
    if noise:
        values += sigma * np.random.default_rng(seed).standard_normal(values.shape)
    return QuadPhoto(values, np.full(values.shape, sigma**2))


def corner(columns: int) -> QuadPhoto:
    """A panel that lights 8 rows of so many columns."""
    found = photo(0.0)
    found.light[:8, :columns] += 100.0
    return found


def blown() -> QuadPhoto:
    """A tenth of it is saturated."""
    saturated = np.zeros(SHAPE, np.bool_)
    saturated[:8] = True
    return replace(photo(100.0), saturated=saturated)


def speck() -> QuadPhoto:
    """One quad that holds no number."""
    found = photo(100.0)
    found.light[8, 12] = np.nan
    return found


def test_the_light_of_a_panel_is_found_where_it_falls() -> None:
    half = find_panel_light(photo(100.0, share=0.5), photo(0.0, seed=1), "mask")
    assert half[:, :50].all() and not half[:, 50:].any()


def test_green_light_tells() -> None:
    white, black = photo(100.0), photo(0.0, seed=1)
    white.light[..., 0] = black.light[..., 0]
    assert find_panel_light(white, black, "projector").all()


@pytest.mark.parametrize(
    ("white", "black", "words", "device"),
    [
        (photo(0.0, room=0.0), photo(0.0, room=0.0, seed=1), "no light reaches", "camera"),
        (photo(0.0), photo(0.0, seed=1), "the mask looks the same when it shows", "mask"),
        (photo(0.0, seed=1), photo(50.0), "the mask looks the same when it shows", "mask"),
        (photo(0.7), photo(0.0, seed=1), "too dim to tell white from black in one pixel", "mask"),
        (photo(5.5), photo(0.0, seed=1), r"too dim: 3\.\d times the noise", "mask"),
        (corner(16), photo(0.0, seed=1), r"only 1\.6% of the photo is lit", "mask"),
        (blown(), photo(0.0, seed=1), r"10\.0% of the photo is saturated", "mask"),
        (photo(9.5), photo(0.0, seed=1), r"is 1\.1 times as strong as its own", "mask"),
        (photo(np.nan), photo(0.0), "not finite", "mask"),
        (speck(), photo(0.0), "not finite", "mask"),
        (photo(100.0), photo(np.inf, noise=False), "not finite", "mask"),
    ],
)
def test_photos_that_tell_nothing_say_why(
    white: QuadPhoto, black: QuadPhoto, words: str, device: str
) -> None:
    with pytest.raises(CalibrationError, match=words) as caught:
        find_panel_light(white, black, "mask")
    assert caught.value.device == device and caught.value.hint


@pytest.mark.parametrize("pattern", OFFSETS_QUADS)
def test_samples_lie_a_quarter_of_a_quad_off_its_middle(pattern: str) -> None:
    """Letters of the four samples: above left, above right, below left, below right."""
    places = [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)]
    assert len(OFFSETS_QUADS[pattern]) == (3 if pattern else 1)
    for number, colour in enumerate("RGB" if pattern else "W"):  # one sample without colours
        letters = zip(pattern or "WWWW", places, strict=True)
        own = [place for letter, place in letters if letter == colour]
        assert OFFSETS_QUADS[pattern][number] == pytest.approx(tuple(np.mean(own, axis=0)))


def test_hot_quads_do_not_saturate_a_photo() -> None:
    white, saturated = photo(100.0), np.zeros(SHAPE, np.bool_)
    saturated.ravel()[:5] = True
    found = find_panel_light(replace(white, saturated=saturated), photo(0.0, seed=1), "mask")
    assert found.all()
