"""What Figures 9 to 12 make of photos that are known: numbers, pictures, and lines of plots."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import SceneConfig
from pdcd.figures import fig09, fig10, fig11, fig12
from pdcd.figures.figure import FULL, QUICK, Figure, Mode, Number, Photo
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.presets.chart import bars

SIZE = (90, 120)


def flat(level: float) -> NDArray[np.float32]:
    return np.full((*SIZE, 3), level, np.float32)


def photo(error: float = 0.01, truths: Any = None, **pictures: NDArray[np.float32]) -> Photo:
    true = pictures if truths is None else truths
    return Photo(pictures, true, dict.fromkeys(pictures, error), None, None, {}, (3, 4))


def numbers(figure: Figure, photos: dict[str, Photo]) -> dict[str, Number]:
    return {number.what: number for number in figure.drawn(QUICK, photos).numbers}


class Axes:
    """Axes that keep what is drawn on them."""

    def __init__(self) -> None:
        self.lines: dict[str, tuple[list[float], list[float]]] = {}
        self.labels: list[str] = []

    def plot(self, x: Any, y: Any, *_: object, **how: Any) -> list[Any]:
        self.lines[str(how.get("label", len(self.lines)))] = ([*map(float, x)], [*map(float, y)])
        return [self]

    def get_color(self) -> str:
        return "red"

    def get_legend_handles_labels(self) -> tuple[list[int], list[str]]:
        return [], []

    def __getattr__(self, name: str) -> Any:
        def noted(*told: Any, **how: Any) -> None:
            if name.startswith("set_") and isinstance(told[0] if told else None, str):
                self.labels.append(told[0])

        return noted


def drawn_on(figure: Figure, photos: dict[str, Photo]) -> Axes:
    (plot,) = figure.drawn(QUICK, photos).plots
    axes = Axes()
    plot.draw(axes)
    assert len(axes.labels) == 3 and all(axes.labels)
    return axes


def chart(ink: float, paper: float) -> NDArray[np.float32]:
    """Bars of ink on paper, on a raster of the figure's own size."""
    image = flat(paper)
    for dark, _ in bars():
        rows, cols = (
            ((np.arange(n) + 0.5) * whole / n).astype(int)
            for n, whole in zip(SIZE, dark.shape, strict=True)
        )
        image[dark[np.ix_(rows, cols)]] = ink
    return image


def milky(veil: float) -> dict[str, Photo]:
    """Photos (c) and (d) whose difference is the chart's light, behind a veil."""
    p, direct = 1.0 / 8.0, chart(0.05, 0.85)
    white = photo(image=0.1 * direct + veil)
    c, d = photo(image=direct + p * veil), photo(image=p * (veil + direct))
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
    wrong = photo(image=c.image * 1.1, truths={"image": c.image})
    beside = photo(image=d.image * 1.1, truths={"image": d.image})
    off = numbers(fig09.FIGURE, photos | {"ours c": wrong, "ours d": beside})
    assert off["RMS error of (e), our codes"].value == pytest.approx(0.1, rel=1e-3)
    assert not off["RMS error of (e), our codes"].held
    clear = numbers(fig09.FIGURE, milky(0.0))
    assert not clear["contrast of the widest bars, floodlit"].held


def test_figure_9_shows_each_picture_to_its_own_white_and_draws_its_bars() -> None:
    shown = fig09.FIGURE.drawn(QUICK, milky(0.5))
    assert [row.title for row in shown.rows] == ["our codes", "the paper's codes", "the truth"]
    for row in shown.rows:
        for panel in row.panels:
            assert panel.white == pytest.approx(float(panel.image.max()), rel=1e-3)
    lines = drawn_on(fig09.FIGURE, milky(0.5)).lines
    widths, contrasts = lines["(e)"]
    assert widths[0] == max(widths) and contrasts[0] == pytest.approx(0.8 / 0.9, rel=1e-4)
    assert {"floodlit", "(c)", "(e)"} <= set(lines) and len(lines) == 6


def test_figure_10_counts_sharp_and_soft_light_where_it_belongs() -> None:
    spot = fig10.spots_of(np.random.default_rng(0).random((*SIZE, 3)))
    indirect = flat(0.5)
    indirect[spot] = 2.0
    low, high = flat(0.4), flat(0.1)
    low[spot], high[spot] = 0.5, 1.5
    true = {"indirect": indirect, "low": low, "high": high}
    ours = photo(0.02, **true)
    errors = dict.fromkeys(true, 0.3)
    paper = Photo(true, true, errors, None, None, {}, (3, 4))
    direct = photo(white=flat(1.0), direct=flat(0.5))
    photos = {"ours": ours, "paper": paper, "direct": direct}
    found = numbers(fig10.FIGURE, photos)
    assert found["soft share of the wax, our codes"].value == pytest.approx(0.8)
    assert found["soft share of the pages, our codes"].value == pytest.approx(0.8)
    assert found["sharp share of spots, our codes"].value == pytest.approx(0.75)
    assert found["indirect light of the striped photos over its truth"].value == pytest.approx(1.0)
    assert found["RMS error of sharp light, our codes"].value == 0.02
    assert found["RMS error of soft light, the paper's"].value == 0.3
    assert all(number.held for number in found.values())
    swapped = photo(indirect=indirect, low=high, high=low, truths=true)
    wrong = numbers(fig10.FIGURE, photos | {"ours": swapped})
    assert not wrong["soft share of the wax, our codes"].held
    rows = fig10.FIGURE.drawn(QUICK, photos).rows
    assert len(rows) == 4 and rows[1].panels[0].white == pytest.approx(2 * np.percentile(low, 99))


@pytest.mark.parametrize(("off", "held"), [(0.0, True), (0.14, True), (-0.14, True), (0.3, False)])
def test_figure_11_holds_what_is_left_against_geometry(
    off: float, held: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A quarter window is half a cell wide: of a front half a cell off, half of it is left."""

    def seen(photo: Photo, disparity: float) -> float:
        return min(max((abs(disparity) + off - 0.25) / 0.5, 0.0), 1.0)

    monkeypatch.setattr(fig11, "left", seen)
    photos = {name: photo(image=flat(0.5), white=flat(1.0)) for name in fig11.takes(QUICK)}
    found = numbers(fig11.FIGURE, photos)
    half = found["(d) direct light left of the front at -0.5 cells"]
    assert half.value == pytest.approx(min(0.5 + 2 * off, 1.0)) and half.held is held
    assert found["(b) direct light left of the front at -2 cells"].held
    gone = found["(e) direct light left of the front at +0 cells"]
    assert gone.held is (off < 0.2) and (gone.least or 0.0) < 0.0 < (gone.most or 0.0) < 0.1
    lines = drawn_on(fig11.FIGURE, photos).lines
    assert lines["photos"][0] == [-2.0, -1.0, -0.5, 0.0, 0.5, 2.0]
    x, y = (np.array(values) for values in lines["by geometry"])
    assert np.interp([-2, -0.75, -0.5, -0.25, 0, 0.25, 0.5, 0.75], x, y) == pytest.approx(
        [1, 1, 0.5, 0, 0, 0, 0.5, 1], abs=0.02
    )
    rows = fig11.FIGURE.drawn(QUICK, photos).rows
    assert [len(row.panels) for row in rows] == [3] * 5
    assert all(panel.white == pytest.approx(1.0) for row in rows for panel in row.panels)


def test_figure_11_takes_the_front_by_its_cells() -> None:
    """A photo of direct light alone has all of it; one of all other light has none."""
    grid, disparity = (12, 16), 0.0
    on, direct, white = fig11._front(grid, disparity)
    assert 0 < on.sum() < on.size and (white >= direct - 1e-12).all()
    size = 4
    for light, left in ((white, 1.0), (white - direct, 0.0), (white - 0.5 * direct, 0.5)):
        image = light.reshape(*grid, 3).repeat(size, axis=0).repeat(size, axis=1)
        image[: 2 * size] = np.nan  # what no quad shows does not count
        taken = Photo({"keyed": image}, {}, {}, None, None, {}, grid)
        assert fig11.left(taken, disparity) == pytest.approx(left, abs=1e-9)
    # Cells at its edge see the front in part, and do not count.
    options = {"disparity": disparity}  # paint moves nothing
    scene = build_scene(SceneConfig(kind=fig11.SCENE, grid=grid, options=options))
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
    glass = fig12.glass_of(direct)
    direct[glass], indirect[glass] = 0.3, 0.7
    true = {"white": direct + indirect, "direct": direct, "indirect": indirect}
    leaky = {**true, "direct": direct + 0.1 * indirect}
    photos = {}
    for name in fig12.takes(QUICK):
        photos[name] = photo(0.02, **true)
    found = numbers(fig12.FIGURE, photos)
    assert found["direct share of the light of the mirror"].value == pytest.approx(0.3, rel=1e-5)
    assert all(number.held for number in found.values())
    kind = fig12.MIRROR
    bad = photos | {f"{kind}, ours": photo(0.02, truths=true, **leaky)}
    wrong = numbers(fig12.FIGURE, bad)
    left = wrong[f"{kind}: indirect light left in the direct picture"]
    assert left.value == pytest.approx(0.1, rel=1e-3) and not left.held
    error = wrong["its error against the truth"]
    assert error.value == pytest.approx(0.07, rel=1e-3) and not error.held
    lines = drawn_on(fig12.FIGURE, photos).lines
    for words, name in (("white", "white"), ("direct", "direct"), ("indirect", "indirect")):
        (label,) = [known for known in lines if known.startswith(words)]
        x, y = lines[label]
        assert max(x) < 0.0 and len(x) == SIZE[1] // 2
        assert min(y) > 0.0 and np.ptp(true[name]) > 0.0
    rows = fig12.FIGURE.drawn(QUICK, photos).rows
    assert all(len(row.panels) == 3 for row in rows)
    assert rows[0].panels[1].white == pytest.approx(float(np.percentile(indirect, 99.5)), rel=1e-4)


@pytest.mark.parametrize(("mode", "papers"), [(QUICK, 1), (FULL, 4)])
def test_figure_12_takes_the_papers_codes_of_one_scene_where_it_has_to_be_quick(
    mode: Mode, papers: int
) -> None:
    takes = fig12.takes(mode)
    by_paper = [name for name in takes if name.endswith("paper's")]
    assert len(by_paper) == papers and len(takes) == papers + 4
    for name in by_paper:
        ours = takes[name.replace("paper's", "ours")]
        assert takes[name].scene == ours.scene and takes[name].goal == ours.goal
        assert takes[name].asked["codes"] == ours.asked["codes"]
        assert takes[name].asked["family"] == "bernoulli" and "family" not in ours.asked
    assert takes[next(iter(takes))].asked["codes"] == 128  # of 512 as the paper counts them


@pytest.mark.parametrize(("mode", "share"), [(QUICK, 1 / 8), (FULL, 1 / 16)])
def test_figure_9_keeps_the_same_share_in_both_photos(mode: Mode, share: float) -> None:
    takes = fig09.takes(mode)
    assert {take.asked["p"] for name, take in takes.items() if name != "white"} == {share}
    assert {take.goal for name, take in takes.items() if name[-1] == "d"} == {"off-diagonal"}
    assert all(take.asked["codes"] == 256 for name, take in takes.items() if name != "white")
