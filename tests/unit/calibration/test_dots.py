"""Pictures of dots: where their centres are, and a code that is found nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, center_of_mass, label

from pdcd.calibration.geometry.dots import DotGrid
from pdcd.errors import CalibrationError
from pdcd.panels.frames import BLACK, WHITE

PROJECTOR = DotGrid.usual("projector", (1024, 768))
MASK = DotGrid.usual("mask", (1600, 1200))


@pytest.mark.parametrize("size_px", [(256, 192), (250, 187)])
def test_the_pixels_of_a_dot_are_even_about_its_centre(size_px: tuple[int, int]) -> None:
    grid = DotGrid.usual("projector", size_px)
    named, count = label(grid.dots())
    rows, cols = grid.shape
    assert count == rows * cols
    seen = np.array(center_of_mass(grid.dots(), named, np.arange(1, count + 1)))[:, ::-1] + 0.5
    index = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1).reshape(-1, 2)
    wanted = grid.centres(index)
    order, there = np.lexsort(seen.round(3).T), np.lexsort(wanted.T)
    np.testing.assert_allclose(seen[order], wanted[there], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("grid", [PROJECTOR, MASK, DotGrid.usual("mask", (320, 240))])
def test_holes_of_the_white_picture_keep_away_from_dots(grid: DotGrid) -> None:
    around = binary_dilation(grid.dots(), iterations=int(grid.radius_px))
    assert not (around & ~grid.white()).any()
    assert 0.4 < grid.holes().mean() < 0.6


def test_photos_of_one_panel_let_all_light_pass_the_other() -> None:
    white, black, dots = MASK.shown(5)
    assert (white.name, black.name, dots.name) == ("white-mask", "black-mask", "dots-mask")
    assert black.mask_index.tolist() == [BLACK] * 5
    for shown in (white, black, dots):
        assert shown.projector_index.tolist() == [WHITE] * 5
    np.testing.assert_array_equal(white.mask[0], MASK.white())
    np.testing.assert_array_equal(dots.mask[0], MASK.dots())
    assert PROJECTOR.shown(2)[0].mask_index.tolist() == [WHITE] * 2


@pytest.mark.parametrize("size_px", [(96, 72), (127, 96), (1280, 100), (128, 31), (20, 20)])
def test_a_panel_too_small_for_dots_is_refused_by_name(size_px: tuple[int, int]) -> None:
    with pytest.raises(CalibrationError, match="too few for its dots") as caught:
        DotGrid.usual("mask", size_px)
    assert caught.value.device == "mask" and "mask.size_px" in str(caught.value.hint)
