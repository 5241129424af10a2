"""What figures make of photos that are known: numbers, pictures, and lines of plots.

Each number is right, and leaves its bounds where the effect that it is about is gone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import SceneConfig
from pdcd.figures import fig01, fig05, fig07, fig08, fig09, fig10, fig11, fig12, tables
from pdcd.figures.figure import (
    QUICK_MODE,
    BoundedNumber,
    FigurePhoto,
    PaperFigure,
    Photos,
)
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.presets import find_builder
from pdcd.virtual.scene.presets.chart import list_chart_bars
from tests import figures_rig

SIZE = (90, 120)


def flat(level: float) -> NDArray[np.float32]:
    return np.full((*SIZE, 3), level, np.float32)


Pictures = dict[str, NDArray[Any]]


def photo(
    pictures: Pictures | NDArray[Any], truths: Any = None, error: float = 0.01, codes: int = 16
) -> FigurePhoto:
    """A photo of some pictures, or of one."""
    seen = pictures if isinstance(pictures, dict) else {"image": pictures}
    true = truths if isinstance(truths, dict) else {"image": truths}
    errors = dict.fromkeys(seen, error)
    known = seen if truths is None else true
    return FigurePhoto(seen, known, errors, None, None, {"codes": codes}, (3, 4))


def numbers(figure: PaperFigure, photos: Photos) -> dict[str, BoundedNumber]:
    return figures_rig.numbers_of(figure, photos, QUICK_MODE)


def fraction_photos(
    indirect: float, codes: Mapping[str, int] | None = None
) -> dict[str, FigurePhoto]:
    """Photos D + p S with D = 0.1 and S = `indirect` everywhere but on the wall.

    A photo of p has 8/p codes, or what `codes` says by its name.
    """
    found = {}
    for name in fig08.list_fig08_takes(QUICK_MODE):
        p = 1.0 if name == "white" else 1.0 / int(name.partition(",")[0][2:])
        images = []
        for strength in (indirect, 0.5):
            image = flat(0.4)
            image[:, SIZE[1] // 3 :] = 0.1 + p * strength
            images.append(image)
        count = (codes or {}).get(name, round(8 / p))
        found[name] = photo(images[0], images[1], codes=count)
    return found


def test_figure_8_reads_direct_and_indirect_light_off_its_lines() -> None:
    found = numbers(fig08.FIGURE, fraction_photos(0.5))
    assert found["milk: indirect share of all light, from the line"].value == pytest.approx(5 / 6)
    assert found["milk: direct light at p = 0, over the true one"].value == pytest.approx(1.0)
    assert found["wall: indirect share of all light, from the line"].value == pytest.approx(0.0)
    assert all(number.held for number in found.values())
    lit = "codes in which a cell is lit, largest over smallest"
    assert found[lit].value == 1.0
    uneven = fraction_photos(0.5, {"1/4, ours": 128, "1/8, ours": 32})
    assert numbers(fig08.FIGURE, uneven)[lit].value == 8.0
    gone = numbers(fig08.FIGURE, fraction_photos(0.0))
    assert not gone["milk: indirect share of all light, from the line"].held


def slice_photos(found: np.ndarray, truth: np.ndarray) -> dict[str, FigurePhoto]:
    scene = photo(flat(0.5))
    taken, true = (np.repeat(entries[..., None], 3, axis=2) for entries in (found, truth))
    return {"slice": replace(scene, transport=taken, transport_truth=true), "scene": scene}


def test_figure_5_knows_the_diagonal_and_reciprocity() -> None:
    cells = QUICK_MODE.grid[1]
    rng = np.random.default_rng(1)
    far = np.triu(rng.random((cells, cells)) ** 8, 2)
    truth = np.eye(cells) + 0.01 * (far + far.T)
    found = numbers(fig05.FIGURE, slice_photos(truth, truth))
    assert found["a path and its way back, correlated, further off"].value == pytest.approx(1.0)
    assert found["correlation with the truth further off the diagonal"].value == pytest.approx(1)
    assert all(number.held for number in found.values())
    # One way only is no scene.
    odd = numbers(fig05.FIGURE, slice_photos(np.eye(cells) + 0.01 * far, truth))
    assert not odd["a path and its way back, correlated, further off"].held
    # A slice that is taken for another one is far from its truth.
    other = numbers(fig05.FIGURE, slice_photos(truth[::-1, ::-1], truth))
    assert not other["correlation with the truth further off the diagonal"].held


def test_figure_7_compares_noise_by_light() -> None:
    names = fig07.list_fig07_takes(QUICK_MODE)
    errors = {
        "diagonal, naive": 2.0, "diagonal, proportional": 0.1, "diagonal, codes": 0.01,
        "indirect, naive": 3.0, "indirect, proportional": 3.0, "indirect, codes": 0.5,
    }  # fmt: skip
    found = numbers(fig07.FIGURE, {name: photo(flat(0.5), error=errors[name]) for name in names})
    assert found["diagonal: error of the naive way over the proportional"].value == 20.0
    assert all(number.held for number in found.values())
    alike = numbers(fig07.FIGURE, {name: photo(flat(0.5), error=1.0) for name in names})
    assert not alike["diagonal: error of the naive way over the proportional"].held
    assert not alike["indirect: error of the naive way over codes"].held


def test_figure_1_sees_the_star_in_the_indirect_picture_alone() -> None:
    star = flat(0.2)
    star[:, round(0.23 * SIZE[1]) : round(0.29 * SIZE[1])] = 0.1
    pictures = {"indirect": star, "white": flat(0.5) + star, "direct": flat(0.5)}
    whole = photo(pictures)
    blind = {**pictures, "indirect": flat(0.2), "white": flat(0.7)}
    lost = photo(blind, pictures)
    found = numbers(fig01.FIGURE, {"ours": whole, "paper": whole})
    seen = "contrast of the star in the wax, indirect picture"
    assert found[seen].value == pytest.approx(0.5)
    assert all(number.held for number in found.values())
    assert not numbers(fig01.FIGURE, {"ours": lost, "paper": whole})[seen].held


def chart(ink: float, paper: float) -> NDArray[np.float32]:
    """Bars of ink on paper, on a raster of the figure's own size."""
    image = flat(paper)
    for dark, _ in list_chart_bars():
        rows, cols = (
            ((np.arange(n) + 0.5) * whole / n).astype(int)
            for n, whole in zip(SIZE, dark.shape, strict=True)
        )
        image[dark[np.ix_(rows, cols)]] = ink
    return image


def milky(veil: float) -> dict[str, FigurePhoto]:
    """Photos (c) and (d) whose difference is the chart's light, behind a veil."""
    p, direct = 1.0 / 8.0, chart(0.05, 0.85)
    white = photo(0.1 * direct + veil)
    c, d = photo(direct + p * veil), photo(p * (veil + direct))
    return {"white": white, "ours c": c, "ours d": d, "paper c": c, "paper d": d}


def test_figure_9_is_about_the_contrast_of_the_bars() -> None:
    photos = milky(0.5)
    found = numbers(fig09.FIGURE, photos)
    wide = 0.80 / 0.90
    floodlit = 0.080 / 1.090
    assert found["contrast of the widest bars, floodlit"].value == pytest.approx(floodlit, rel=1e-4)
    assert found["the same in (c)"].value == pytest.approx(0.8 / 1.025, rel=1e-4)
    assert found["the same in (e), de-scattered"].value == pytest.approx(wide, rel=1e-4)
    over = found["contrast in (e) over floodlit"]
    assert over.value == pytest.approx(wide / floodlit, rel=1e-4) and over.held
    assert found["error of that contrast against the truth"].value == pytest.approx(0.0, abs=1e-6)
    assert found["RMS error of (e), our codes"].value == pytest.approx(0.0, abs=1e-6)
    # Off by a tenth all over: so is the picture, and its contrast is the same.
    c, d = photos["ours c"], photos["ours d"]
    wrong = photo(c.image * 1.1, c.image)
    beside = photo(d.image * 1.1, d.image)
    off = numbers(fig09.FIGURE, photos | {"ours c": wrong, "ours d": beside})
    assert off["RMS error of (e), our codes"].value == pytest.approx(0.1, rel=1e-3)
    assert not off["RMS error of (e), our codes"].held
    clear = numbers(fig09.FIGURE, milky(0.0))
    assert not clear["contrast of the widest bars, floodlit"].held


def test_figure_10_counts_sharp_and_soft_light_where_it_belongs() -> None:
    spot = fig10.find_spots(np.random.default_rng(0).random((*SIZE, 3)))
    indirect = flat(0.5)
    indirect[spot] = 2.0
    low, high = flat(0.4), flat(0.1)
    low[spot], high[spot] = 0.5, 1.5
    true = {"indirect": indirect, "low": low, "high": high}
    ours = photo(true, error=0.02)
    paper = photo(true, error=0.3)
    direct = photo({"white": flat(1.0), "direct": flat(0.5)})
    photos = {"ours": ours, "paper": paper, "direct": direct}
    found = numbers(fig10.FIGURE, photos)
    assert found["soft share of the wax, our codes"].value == pytest.approx(0.8)
    assert found["soft share of the pages, our codes"].value == pytest.approx(0.8)
    assert found["sharp share of spots, our codes"].value == pytest.approx(0.75)
    assert found["indirect light of the striped photos over its truth"].value == pytest.approx(1.0)
    assert found["RMS error of sharp light, our codes"].value == 0.02
    assert found["RMS error of soft light, the paper's"].value == 0.3
    assert all(number.held for number in found.values())
    swapped = photo({"indirect": indirect, "low": high, "high": low}, true)
    wrong = numbers(fig10.FIGURE, photos | {"ours": swapped})
    assert not wrong["soft share of the wax, our codes"].held


@pytest.mark.parametrize(("off", "held"), [(0.0, True), (0.14, True), (-0.14, True), (0.3, False)])
def test_figure_11_holds_what_is_left_against_geometry(
    off: float, held: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A quarter window is half a cell wide: of a front half a cell off, half of it is left."""

    def seen(photo: FigurePhoto, disparity: float) -> float:
        return min(max((abs(disparity) + off - 0.25) / 0.5, 0.0), 1.0)

    monkeypatch.setattr(fig11, "measure_direct_left", seen)
    photos = {
        name: photo({"image": flat(0.5), "white": flat(1.0)})
        for name in fig11.list_fig11_takes(QUICK_MODE)
    }
    found = numbers(fig11.FIGURE, photos)
    half = found["(d) direct light left of the front at -0.5 cells"]
    assert half.value == pytest.approx(min(0.5 + 2 * off, 1.0)) and half.held is held
    assert found["(b) direct light left of the front at -2 cells"].held
    gone = found["(e) direct light left of the front at +0 cells"]
    assert gone.held is (off < 0.2) and (gone.least or 0.0) < 0.0 < (gone.most or 0.0) < 0.1


def test_figure_11_takes_the_front_by_its_cells() -> None:
    """A photo of direct light alone has all of it; one of all other light has none."""
    grid, disparity = (12, 16), 0.0
    on, direct, white = fig11._front(grid, disparity)
    assert 0 < on.sum() < on.size and (white >= direct - 1e-12).all()
    size = 4
    for light, left in ((white, 1.0), (white - direct, 0.0), (white - 0.5 * direct, 0.5)):
        image = light.reshape(*grid, 3).repeat(size, axis=0).repeat(size, axis=1)
        image[: 2 * size] = np.nan  # what no quad shows does not count
        taken = FigurePhoto({"keyed": image}, {}, {}, None, None, {}, grid)
        assert fig11.measure_direct_left(taken, disparity) == pytest.approx(left, abs=1e-9)
    # Cells at its edge see the front in part, and do not count.
    options = {"disparity": disparity}  # paint moves nothing
    scene = build_scene(SceneConfig(kind=fig11.BOX_SCENE, grid=grid, options=options))
    assert scene.displacement is not None
    front = np.isclose(scene.displacement[:, 1], disparity).reshape(grid)
    inner = on.reshape(grid)
    for row, col in np.argwhere(inner):
        assert front[row - 1 : row + 2, col].all() and front[row, col - 1 : col + 2].all()
    assert inner.sum() < front.sum()


def test_figure_12_sees_what_codes_left_in_the_direct_picture() -> None:
    rng = np.random.default_rng(1)
    direct = rng.random((*SIZE, 3)).astype(np.float32) + 0.2
    indirect = rng.random((*SIZE, 3)).astype(np.float32)
    glass = fig12.find_glass(direct)
    direct[glass], indirect[glass] = 0.3, 0.7
    true = {"white": direct + indirect, "direct": direct, "indirect": indirect}
    leaky = {**true, "direct": direct + 0.1 * indirect}
    photos = {name: photo(true, error=0.02) for name in fig12.list_fig12_takes(QUICK_MODE)}
    found = numbers(fig12.FIGURE, photos)
    assert found["direct share of the light of the mirror"].value == pytest.approx(0.3, rel=1e-5)
    assert all(number.held for number in found.values())
    kind = fig12.MIRROR_SCENE
    bad = photos | {f"{kind}, ours": photo(leaky, true, 0.02)}
    wrong = numbers(fig12.FIGURE, bad)
    left = wrong[f"{kind}: indirect light left in the direct picture"]
    assert left.value == pytest.approx(0.1, rel=1e-3) and not left.held
    error = wrong["its error against the truth"]
    assert error.value == pytest.approx(0.07, rel=1e-3) and not error.held


@pytest.mark.long
def test_the_path_by_the_mirror_goes_the_way_of_the_scene() -> None:
    """The warp of Table 1 names the cells that the still life's mirror really joins."""
    build = find_builder("still-life")
    assert build is not None
    grid = (24, 32)
    scene = build(grid, {})
    warp = tables.map_mirror_paths(grid).ravel().astype(int)
    joined = np.flatnonzero(warp >= 0)
    middle = joined[len(joined) // 2]
    light = np.zeros((1, scene.cells))
    light[0, warp[middle]] = 1.0
    seen = scene.apply(light)[0].sum(axis=-1)
    seen[warp[middle]] = 0.0
    brightest = int(np.argmax(seen))
    assert np.abs(np.subtract(np.divmod(brightest, 32), np.divmod(middle, 32))).max() <= 1
