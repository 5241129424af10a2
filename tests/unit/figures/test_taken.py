"""Figures taken coarsely: what their photos show, each against its truth, or dense transport."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import SceneConfig
from pdcd.figures import fig01, fig05, fig07, fig08, fig09, fig10, fig11, fig12, tables
from pdcd.figures.bench import count_equal_photos
from pdcd.figures.figure import FigurePhoto, PaperFigure, Photos
from pdcd.figures.places import average_patch
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.presets.ball_book import draw_wax
from pdcd.virtual.scene.presets.canvas import FrameRaster
from pdcd.virtual.scene.presets.vase import draw_mirror
from pdcd.virtual.scene.texture import average_cells
from tests import figures_rig
from tests.figures_rig import TINY_MODE, taken

pytestmark = pytest.mark.long
ROWS, COLS = TINY_MODE.grid
INNER = np.pad(np.ones((ROWS - 2, COLS - 2), dtype=bool), 1).ravel()
"""Cells off the border of the field, where a raster of 100 pixels has unknown ones."""


def agree(photo: FigurePhoto) -> None:
    """The error was found over the same quads by the capture itself, from its own truth."""
    assert photo.error == pytest.approx(photo.summary["rms_error_quads"], rel=1e-4)


def numbers_of(figure: PaperFigure, photos: Photos) -> dict[str, float]:
    found = figures_rig.numbers_of(figure, photos)
    return {what: np.nan if one.value is None else one.value for what, one in found.items()}


def dense(kind: str, **options: Any) -> NDArray[np.float64]:
    """(3, N, N) light transport of a scene."""
    return build_scene(SceneConfig(kind=kind, grid=TINY_MODE.grid, options=options)).dense()


def off(found: NDArray[Any], wanted: NDArray[Any]) -> float:
    """RMS difference within the border over the RMS of what is wanted."""
    rms = np.sqrt(np.mean((found - wanted)[INNER] ** 2) / np.mean(wanted[INNER] ** 2))
    return float(rms)


def in_cells(image: NDArray[Any]) -> NDArray[np.float64]:
    """(N, 3) means over cells."""
    return average_cells(np.nan_to_num(image).astype(np.float64), TINY_MODE.grid)


def test_figure_1() -> None:
    photos = taken(fig01.FIGURE)
    numbers = numbers_of(fig01.FIGURE, photos)
    assert numbers["direct + indirect - white, mean, scene units"] < 1e-5
    assert photos["ours"].error < photos["paper"].error
    for photo in photos.values():
        agree(photo)
        assert photo.errors["white"] < 0.03


def test_figure_5() -> None:
    photos = taken(fig05.FIGURE)
    numbers = numbers_of(fig05.FIGURE, photos)
    assert numbers["correlation with the truth further off the diagonal"] > 0.85
    found, truth = fig05.average_entries(photos["slice"])
    assert np.argmax(found, axis=1) == pytest.approx(np.argmax(truth, axis=1), abs=1)


def test_figure_7() -> None:
    photos = taken(fig07.FIGURE)
    numbers = numbers_of(fig07.FIGURE, photos)
    assert photos["diagonal, codes"].error < 0.03 < photos["diagonal, proportional"].error
    # 24 cells: between the root of them and all of them.
    assert 4.0 < numbers["diagonal: error of the naive way over the proportional"] < 30.0
    assert 0.8 < numbers["indirect: error of the naive way over the proportional"] < 1.25


def test_a_fixed_aperture_fills_another_sensor_as_much() -> None:
    """The paper's would fill the small pixels of this one eight times: its photos were clipped."""
    photos = taken(fig07.FIGURE, ("diagonal, codes", "indirect, codes"), "mono")
    assert all(photo.image.shape[2] == 1 for photo in photos.values())
    assert photos["diagonal, codes"].error < 0.06 and photos["indirect, codes"].error < 0.2


def test_another_sensor_takes_as_much_light() -> None:
    """A sample of 10 500 electrons against four of up to 40 200, of which red and blue ones see
    half as much as green ones."""
    assert {name: count_equal_photos(name) for name in ("450d", "mono", "modern")} == {
        "450d": 1, "mono": 3, "modern": 1,
    }  # fmt: skip
    for profile, shots in (("450d", 2), ("mono", 6)):
        assert taken(fig08.FIGURE, ("1/2, ours",), profile)["1/2, ours"].summary["shots"] == shots


def test_figure_8() -> None:
    names = ("white", "1/2, ours", "1/4, ours", "1/8, ours", "1/16, ours")
    photos = taken(fig08.FIGURE, names)
    for photo in photos.values():
        agree(photo)
        assert photo.error < 0.08
    cells = {float(p): n for p, n in ((1, "white"), (2, names[1]), (16, names[4]))}
    patches = {p: average_patch(photos[n].image, fig08.POINTS["milk"]) for p, n in cells.items()}
    # D + p S: what p = 1/16 has left over follows from p = 1 and p = 1/2.
    direct = 2.0 * patches[2.0] - patches[1.0]
    assert patches[16.0] == pytest.approx(direct + (patches[1.0] - direct) / 16.0, rel=0.15)


def test_rows_of_the_tables() -> None:
    photos = taken(tables.TABLE_2, ("row 1", "row 2", "row 5"))
    for name, most in (("row 1", 0.1), ("row 2", 0.45), ("row 5", 0.06)):
        agree(photos[name])
        assert photos[name].error < most
    photos = taken(tables.TABLE_1, ("row 1", "row 2"))
    one, two = photos["row 1"].image, photos["row 2"].image
    assert np.nanmean(np.abs(one - two)) < 0.01 * np.nanmean(one)


def test_figure_9_is_direct_light_less_that_from_the_left() -> None:
    photos, p = taken(fig09.FIGURE), 1.0 / 8.0
    whole = dense(fig09.CHART_SCENE).sum(axis=0) / 3.0
    cells = np.arange(ROWS * COLS)
    own = whole[cells, cells]
    beside = np.where(cells % COLS > 0, whole[cells, cells - 1], 0.0)
    seen = {}
    for name, light in (("ours c", own), ("ours d", beside)):
        seen[name] = in_cells(photos[name].image).mean(axis=1)
        assert off(seen[name], light + p * (whole.sum(axis=1) - light)) < 0.13, name
    assert off((seen["ours c"] - seen["ours d"]) / (1.0 - p), own - beside) < 0.20
    numbers = numbers_of(fig09.FIGURE, photos)
    assert numbers["RMS error of (e), our codes"] < numbers["RMS error of (e), the paper's codes"]


def test_contrast_is_that_of_two_greys() -> None:
    np.testing.assert_allclose(
        fig09.measure_contrasts(np.full((300, 400, 3), 0.5))[:3], 0.0, atol=1e-12
    )
    half = build_scene(SceneConfig(kind=fig09.CHART_SCENE, grid=TINY_MODE.grid)).texture
    assert half is not None
    # Ink of 0.05 on paper of 0.86, before there is milk.
    assert fig09.measure_contrasts(half)[0] == pytest.approx(
        (0.86 - 0.05) / (0.86 + 0.05), abs=0.02
    )


def test_figure_10_wax_is_soft_by_dense_transport_as_by_photos() -> None:
    photos = taken(fig10.FIGURE, ("ours", "paper", "direct"))
    whole = dense(fig10.BALL_SCENE).sum(axis=0)
    np.fill_diagonal(whole, 0.0)
    column, period = np.arange(len(whole)) % COLS, fig10.PERIOD
    seen = np.stack([whole @ ((column + step) % period < period // 2) for step in range(4)])
    wax = draw_wax(FrameRaster(TINY_MODE.grid)).ravel()
    soft = 2.0 * seen.min(axis=0)[wax].sum() / whole.sum(axis=1)[wax].sum()
    ours = photos["ours"]
    there = draw_wax(FrameRaster(ours.image.shape[:2]))
    # The truth is told of places within cells, and a mean of the smallest is less than the smallest
    # of means.
    assert soft - 0.1 < fig10.measure_area_share(ours.truths, "low", there) < soft
    assert fig10.measure_area_share(ours.pictures, "low", there) == pytest.approx(soft, abs=0.10)
    scale = numbers_of(fig10.FIGURE, photos)["indirect light of the striped photos over its truth"]
    assert scale == pytest.approx(1.0, abs=0.25)  # least squares leave 1.33 on so few cells


def test_figure_11_blocks_one_plane_and_no_other() -> None:
    photos = taken(fig11.FIGURE, ("e", "g"))
    for name, disparity, want in (("e", 0.0, 0.0), ("g", 2.0, 1.0)):
        photo = photos[name]
        whole = dense(fig11.BOX_SCENE, disparity=disparity, painted=True)
        keyed = (whole.sum(axis=2) - np.diagonal(whole, axis1=1, axis2=2)).T
        for image, most in ((photo.truth, 0.15), (photo.image, 0.20)):
            assert off(in_cells(image), keyed) < most, name
        assert fig11.measure_direct_left(photo, disparity) == pytest.approx(want, abs=0.1)
        true = replace(photo, pictures=photo.truths)
        assert fig11.measure_direct_left(true, disparity) == pytest.approx(want, abs=0.06)


def test_figure_12_mirror_keeps_what_it_took_back_itself_and_nothing_else() -> None:
    (photo,) = taken(fig12.FIGURE, (f"{fig12.MIRROR_SCENE}, ours",)).values()
    whole = dense(fig12.MIRROR_SCENE).sum(axis=0)
    glass = draw_mirror(FrameRaster(TINY_MODE.grid), -0.06).ravel()
    want = np.diagonal(whole)[glass].sum() / whole.sum(axis=1)[glass].sum()
    assert 0.1 < want < 0.7
    assert fig12.measure_mirror_share(photo.truths) == pytest.approx(want, abs=0.10)
    assert fig12.measure_mirror_share(photo.pictures) == pytest.approx(
        fig12.measure_mirror_share(photo.truths), abs=0.06
    )
    assert abs(fig12.measure_indirect_left(photo)) < 0.15
    # The number sees what it is for: a photo whose codes did nothing has all of it left.
    bad = {**photo.pictures, "direct": photo.pictures["white"]}
    assert fig12.measure_indirect_left(replace(photo, pictures=bad)) == pytest.approx(1.0, abs=0.1)
