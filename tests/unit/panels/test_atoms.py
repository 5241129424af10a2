"""Atoms of a panel's pixels: exact fractions where the map has them, and the map where it bends."""

from __future__ import annotations

from fractions import Fraction

import msgspec
import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.atoms import ATOMS_PER_CELL, OUTSIDE, check_cells, find_atoms, find_shown_cells
from pdcd.panels.map import Map, PanelView
from pdcd.panels.placing import Placing, make_placed_map

SIZE = (45, 35)


def view(size_px: tuple[int, int] = SIZE, **place: object) -> PanelView:
    return PanelView("mask", make_placed_map(Placing(**place), size_px, size_px, "mask"))  # type: ignore[arg-type]


@pytest.mark.parametrize("grid", [(5, 9), (7, 11), (35, 45), (1, 1), (17, 23)])
@pytest.mark.parametrize("flip", ["none", "horizontal", "vertical"])
def test_upright_panels_by_exact_fractions(grid: tuple[int, int], flip: str) -> None:
    """A centre that lies exactly on an edge belongs to what begins there, mirrored or not."""
    found = find_atoms(view(flip=flip), grid)
    for axis, (size, cells) in enumerate(zip(SIZE, grid[::-1], strict=True)):
        centres = [Fraction(2 * k + 1, 2 * size) for k in range(size)]
        if flip == ("horizontal", "vertical")[axis]:
            centres.reverse()
        wanted = [int(4 * cells * place) for place in centres]
        line = found[0, :, 0] if axis == 0 else found[:, 0, 1]
        np.testing.assert_array_equal(line, wanted)
    assert found.dtype == np.int32
    assert found.shape == (35, 45, 2)
    assert (found == found[:1, :, :])[..., 0].all()
    assert (found == found[:, :1, :])[..., 1].all()


def test_a_quarter_turn_is_exact() -> None:
    """Of a square panel: rows become columns, in whole numbers."""
    upright, turned = (
        find_atoms(view((36, 36)), (7, 12)),
        find_atoms(view((36, 36), turn_deg=90.0), (7, 12)),
    )
    centre = [Fraction(2 * k + 1, 72) for k in range(36)]
    np.testing.assert_array_equal(turned[:, 0, 0], [int(48 * (1 - y)) for y in centre])
    np.testing.assert_array_equal(turned[0, :, 1], upright[:, 0, 1])


def test_many_blocks_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    panel = view(turn_deg=7.0, radial=(0.05, -0.01))
    whole = find_atoms(panel, (6, 8))
    monkeypatch.setattr("pdcd.panels.atoms.BLOCK_PX", 100)
    np.testing.assert_array_equal(whole, find_atoms.__wrapped__(panel, (6, 8)))


def test_places_beyond_infinity_are_outside() -> None:
    """A panel that reaches behind the projection shows nothing there."""
    bent = msgspec.structs.replace(Map.filling((8, 8)), homography=(1, 0, 0, 0, 1, 0, -0.2, 0, 1))
    found = find_atoms(PanelView("projector", bent), (2, 2))
    assert (found[:, 5:] == OUTSIDE).all()


@pytest.mark.parametrize("turn_deg", [0.0, 90.0])
@pytest.mark.parametrize(("grid", "fits"), [((12, 12), True), ((13, 12), False), ((12, 13), False)])
def test_every_cell_has_a_pixel(grid: tuple[int, int], fits: bool, turn_deg: float) -> None:
    panel = view((12, 12), turn_deg=turn_deg)
    if fits:
        check_cells(panel, grid)
        return
    with pytest.raises(ConfigError, match=r"12 of 1. x 1. cells .* on the mask") as found:
        check_cells(panel, grid)
    assert found.value.device == "mask"


@pytest.mark.parametrize("radial", [(0.0, 0.0), (0.001, 0.0)])
def test_cells_beyond_the_panel_are_not_shown(radial: tuple[float, float]) -> None:
    """No panel covers the field exactly; one that shows no cell at all is refused."""
    panel = view(offset_px=(8.0, 0.0), radial=radial)
    check_cells(panel, (6, 8))
    shown = find_shown_cells(panel, (6, 8))
    assert not shown[:, 0].any() and shown[:, 1:].all()
    with pytest.raises(ConfigError, match=r"48 of 6 x 8 cells .*row 0, column 0"):
        check_cells(view(offset_px=(64.0, 0.0), radial=radial), (6, 8))


@pytest.mark.parametrize("turn_deg", [0.0, 17.0, 45.0])
def test_cells_of_two_pixels_need_no_look(turn_deg: float) -> None:
    """A square of that side holds the centre of a pixel, however it is turned."""
    panel = view((96, 96), turn_deg=turn_deg, scale=1.5)
    cells = find_atoms(panel, (30, 30)) // ATOMS_PER_CELL
    inside = cells[cells[..., 0] >= 0]
    found = np.zeros((30, 30), dtype=np.bool_)
    found[inside[:, 1], inside[:, 0]] = True
    assert found.all() and find_shown_cells(panel, (30, 30)).all()
