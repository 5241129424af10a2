"""What figures make of photos, on photos that are known.

Each number is right, and leaves its bounds where the effect that it is about is gone.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from pdcd.figures import fig01, fig05, fig07, fig08, table1, table2, tables
from pdcd.figures.figure import QUICK, Figure, Number, Photo

SIZE = (60, 80)


def photo(image: np.ndarray, truth: np.ndarray | None = None, error: float = 0.01) -> Photo:
    """A photo of one picture."""
    known = image if truth is None else truth
    errors = {"answer": error}
    return Photo({"answer": image}, {"answer": known}, errors, None, None, {"codes": 16}, (3, 4))


def flat(level: float) -> np.ndarray:
    return np.full((*SIZE, 3), level, np.float32)


def held(figure: Figure, photos: Mapping[str, Photo]) -> dict[str, Number]:
    return {number.what: number for number in figure.drawn(QUICK, photos).numbers}


def fraction_photos(indirect: float, codes: Mapping[str, int] | None = None) -> dict[str, Photo]:
    """Photos D + p S with D = 0.1 and S = `indirect` everywhere but on the wall.

    A photo of p has 8/p codes, or what `codes` says by its name.
    """
    found = {}
    for name in fig08.takes(QUICK):
        p = 1.0 if name == "white" else 1.0 / int(name.partition(",")[0][2:])
        images = []
        for strength in (indirect, 0.5):
            image = flat(0.4)
            image[:, SIZE[1] // 3 :] = 0.1 + p * strength
            images.append(image)
        one = photo(images[0], images[1])
        summary = {"codes": (codes or {}).get(name, round(8 / p))}
        found[name] = Photo(one.pictures, one.truths, one.errors, None, None, summary, (3, 4))
    return found


def test_figure_8_reads_direct_and_indirect_light_off_its_lines() -> None:
    numbers = held(fig08.FIGURE, fraction_photos(0.5))
    assert numbers["milk: indirect share of all light, from the line"].value == pytest.approx(5 / 6)
    assert numbers["milk: direct light at p = 0, over the true one"].value == pytest.approx(1.0)
    assert numbers["wall: indirect share of all light, from the line"].value == pytest.approx(0.0)
    assert all(number.held for number in numbers.values())
    lit = "codes in which a cell is lit, largest over smallest"
    assert numbers[lit].value == 1.0
    uneven = fraction_photos(0.5, {"1/4, ours": 128, "1/8, ours": 32})
    assert held(fig08.FIGURE, uneven)[lit].value == 8.0
    gone = held(fig08.FIGURE, fraction_photos(0.0))
    assert not gone["milk: indirect share of all light, from the line"].held


def slice_photos(found: np.ndarray, truth: np.ndarray) -> dict[str, Photo]:
    base = photo(flat(0.5))
    whole = [np.repeat(entries[..., None], 3, axis=2) for entries in (found, truth)]
    sliced = Photo(base.pictures, base.truths, base.errors, whole[0], whole[1], {}, (3, 4))
    return {"slice": sliced, "scene": base}


def test_figure_5_knows_the_diagonal_and_reciprocity() -> None:
    cells = QUICK.grid[1]
    rng = np.random.default_rng(1)
    far = np.triu(rng.random((cells, cells)) ** 8, 2)
    truth = np.eye(cells) + 0.01 * (far + far.T)
    numbers = held(fig05.FIGURE, slice_photos(truth, truth))
    assert numbers["a path and its way back, correlated, further off"].value == pytest.approx(1.0)
    assert numbers["correlation with the truth further off the diagonal"].value == pytest.approx(1)
    assert all(number.held for number in numbers.values())
    # One way only is no scene.
    odd = held(fig05.FIGURE, slice_photos(np.eye(cells) + 0.01 * far, truth))
    assert not odd["a path and its way back, correlated, further off"].held
    # A slice that is taken for another one is far from its truth.
    other = held(fig05.FIGURE, slice_photos(truth[::-1, ::-1], truth))
    assert not other["correlation with the truth further off the diagonal"].held


def test_figure_7_compares_noise_by_light() -> None:
    names = fig07.takes(QUICK)
    errors = {
        "diagonal, naive": 2.0, "diagonal, proportional": 0.1, "diagonal, codes": 0.01,
        "indirect, naive": 3.0, "indirect, proportional": 3.0, "indirect, codes": 0.5,
    }  # fmt: skip
    numbers = held(fig07.FIGURE, {name: photo(flat(0.5), error=errors[name]) for name in names})
    assert numbers["diagonal: error of the naive way over the proportional"].value == 20.0
    assert all(number.held for number in numbers.values())
    alike = held(fig07.FIGURE, {name: photo(flat(0.5), error=1.0) for name in names})
    assert not alike["diagonal: error of the naive way over the proportional"].held
    assert not alike["indirect: error of the naive way over codes"].held


def test_figure_1_sees_the_star_in_the_indirect_picture_alone() -> None:
    star = flat(0.2)
    star[:, round(0.23 * SIZE[1]) : round(0.29 * SIZE[1])] = 0.1
    pictures = {"indirect": star, "white": flat(0.5) + star, "direct": flat(0.5)}
    whole = Photo(pictures, pictures, {"indirect": 0.01}, None, None, {}, (3, 4))
    blind = {**pictures, "indirect": flat(0.2), "white": flat(0.7)}
    lost = Photo(blind, pictures, {"indirect": 0.01}, None, None, {}, (3, 4))
    numbers = held(fig01.FIGURE, {"ours": whole, "paper": whole})
    seen = "contrast of the star in the wax, indirect picture"
    assert numbers[seen].value == pytest.approx(0.5)
    assert all(number.held for number in numbers.values())
    assert not held(fig01.FIGURE, {"ours": lost, "paper": whole})[seen].held


@pytest.mark.long
def test_the_path_by_the_mirror_goes_the_way_of_the_scene() -> None:
    """The warp of Table 1 names the cells that the still life's mirror really joins."""
    from pdcd.virtual.scene.presets import builder_of

    build = builder_of("still-life")
    assert build is not None
    grid = (24, 32)
    scene = build(grid, {})
    warp = tables.by_the_mirror(grid).ravel().astype(int)
    joined = np.flatnonzero(warp >= 0)
    middle = joined[len(joined) // 2]
    light = np.zeros((1, scene.cells))
    light[0, warp[middle]] = 1.0
    seen = scene.apply(light)[0].sum(axis=-1)
    seen[warp[middle]] = 0.0
    brightest = int(np.argmax(seen))
    assert np.abs(np.subtract(np.divmod(brightest, 32), np.divmod(middle, 32))).max() <= 1


def test_tables_have_all_their_rows() -> None:
    for table, mode_rows in ((table1, table1.rows((24, 32))), (table2, table2.rows((24, 32)))):
        assert [row.number for row in mode_rows] == list(range(1, 8))
        names = table.FIGURE.takes(QUICK)
        shown = table.FIGURE.drawn(QUICK, {name: photo(flat(0.5)) for name in names})
        assert len(shown.rows) == 7
        # What a filter or a difference gives has both signs; all else is light.
        for row, panels in zip(mode_rows, shown.rows, strict=True):
            signs = {panel.signed for panel in panels.panels}
            assert signs == {row.goal in ("descattered", "filtered")}, row.number
