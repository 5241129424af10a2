"""How a page of figures shows what was found: pictures, plots, tables, what is off."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.errors import DiskError
from pdcd.figures import make as engine
from pdcd.figures import page as pages
from pdcd.figures import photo as photos
from pdcd.figures import picture
from pdcd.figures.figure import (
    FULL,
    QUICK,
    TINY,
    Mode,
    Number,
    Panel,
    Photo,
    Plot,
    Row,
    Take,
    codes_printed,
)
from pdcd.figures.plot import PALETTE, colour, finish, plotted
from pdcd.figures.store import Captured, Made, Shown, ShownRow, Stated, Store
from pdcd.figures.write import captured, stated
from pdcd.pictures.decode import TRANSPORT


def number(held: bool = True, **fields: Any) -> Stated:
    told: dict[str, Any] = {
        "what": "width", "value": 1.0, "least": 0.5, "most": 1.5, "paper": "", "percent": False,
    }  # fmt: skip
    return Stated(**(told | fields), held=held)


def capture(**fields: Any) -> Captured:
    told: dict[str, Any] = {
        "name": "ours", "said": "<b>", "goal": "indirect", "scene": "vase", "codes": 16,
        "family": "hadamard", "exposures": 2, "exposure_s": 3.5, "error": 0.0123, "bound": None,
        "held": True,
    }  # fmt: skip
    return Captured(**(told | fields))


def made(**fields: Any) -> Made:
    told: dict[str, Any] = {
        "number": "1", "fingerprint": "", "mode": "quick", "title": "<t>", "see": "see",
        "paper": "p", "unlike": "", "rows": (), "plots": (), "numbers": (),
        "captures": (), "seconds": 1.0,
    }  # fmt: skip
    return Made(**(told | fields))


@pytest.mark.parametrize(
    ("least", "most", "percent", "words"),
    [
        (0.5, 1.5, False, "0.5 to 1.5"),
        (0.5, None, False, "at least 0.5"),
        (None, 0.25, True, "at most 25 %"),
        (0.0, 0.12345, True, "0 % to 12.3 %"),
        (None, None, False, ""),
    ],
)
def test_bounds_are_told_as_they_were_stated(
    least: float | None, most: float | None, percent: bool, words: str
) -> None:
    told = pages._numbers([number(least=least, most=most, percent=percent, value=0.5)])
    assert f'<td class="n">{words}</td>' in told
    assert ("held" in told) == bool(words)


def test_numbers_of_the_paper_have_a_column_where_there_are_any() -> None:
    plain = pages._numbers([number(), number(held=False, value=None)])
    assert "in the paper" not in plain and "not known" in plain
    assert re.findall(r'class="(held|not)">([^<]*)<', plain) == [
        ("held", "held"),
        ("not", "NOT HELD"),
    ]
    both = pages._numbers([number(), number(paper="<1.1>")])
    assert both.count("<th>") == 5 and "&lt;1.1&gt;" in both
    assert pages._numbers([]) == "" == pages._captures([])


def test_captures_are_told_in_figures() -> None:
    told = pages._captures([capture(), capture(bound=0.02), capture(bound=0.01, held=False)])
    cells = re.findall(r"<tr>(.*?)</tr>", told)[1:]
    rows = [re.findall(r">([^<]*)</td>", row) for row in cells]
    assert rows[0][:4] == ["ours", "&lt;b&gt;", "indirect", "16 hadamard"]
    assert rows[0][4:] == ["64", "2", "3.5 s", "1.23 %", "", ""]
    assert (rows[1][-2:], rows[2][-2:]) == (["at most 2 %", "held"], ["at most 1 %", "NOT HELD"])
    bare = capture(codes=None, family=None, exposures=None, exposure_s=None, error=None)
    (row,) = re.findall(r"<tr>(.*?)</tr>", pages._captures([bare]))[1:]
    assert re.findall(r">([^<]*)</td>", row)[3:] == ["", "", "", "", "not known", "", ""]


@pytest.mark.parametrize(
    ("some", "failed", "waiting", "there", "not_there"),
    [
        ([made()], {}, [], [], ["bounds", "banner not"]),
        (
            [made(numbers=(number(), number()))],
            {},
            [],
            ["All 2 numbers are within"],
            ["banner not"],
        ),
        ([made(numbers=(number(), number(held=False)))], {}, [], ["1 of 2 numbers"], ["All "]),
        ([made(captures=(capture(), capture(bound=1.0)))], {}, [], ["All 1 numbers"], ["of 1"]),
        (
            [made(numbers=(number(),), captures=(capture(bound=1.0, held=False),))],
            {},
            [],
            ["1 of 2 numbers"],
            ["All "],
        ),
        ([], {"5": "w", "6": "w"}, [], ["2 figures could not be made"], ["bounds"]),
        (
            [made(numbers=(number(held=False),))],
            {"5": "w"},
            ["appendix", "7"],
            ["still to be made: Appendix, Figure 7."],
            ["could not be made.", "of 1 numbers"],
        ),
    ],
)
def test_the_banner_tells_what_is_missing_and_what_is_off(
    some: Any, failed: Any, waiting: Any, there: list[str], not_there: list[str]
) -> None:
    told = "".join(pages._banner(some, failed, waiting))
    assert all(words in told for words in there)
    assert not any(words in told for words in not_there)


def test_contents_lead_to_all_figures_and_mark_those_that_are_off() -> None:
    told = pages._contents(
        [made(), made(number="table-2", numbers=(number(held=False),))], {"9": ""}
    )
    links = re.findall(r"<span>(.*?)</span>\n?", told, re.DOTALL)
    assert '<a href="#fig-1">Figure 1</a>' in told and '"#fig-table-2">Table 2</a> <span' in told
    assert told.count("!") == 1 and '<span class="not">Figure 9</span>' in told and links


@pytest.mark.parametrize(
    ("count", "small", "size"),
    [(1, False, " few"), (2, False, " few"), (3, False, ""), (4, False, ""), (5, False, " many"),
     (7, False, " many"), (5, True, " small"), (1, True, " small")],
)  # fmt: skip
def test_rows_of_many_pictures_have_smaller_ones(count: int, small: bool, size: str) -> None:
    shown = tuple(Shown(f"{n}.png", "<c>") for n in range(count))
    told = pages._section(made(rows=(ShownRow("a <row>", shown, small),)))
    assert f'<div class="row{size}">' in told and "<h3>a &lt;row&gt;</h3>" in told
    assert told.count("<img ") == count and "figcaption" not in told
    assert 'alt="&lt;c&gt;"' in told


def test_plots_have_captions_and_may_be_wide() -> None:
    plots = (Shown("a.png", "one"), Shown("b.png", "two", True))
    told = pages._section(made(plots=plots, unlike="the <lens>"))
    assert told.count("<figcaption>") == 2 and told.count('<figure class="wide">') == 1
    assert '<div class="plots">' in told and "Still unlike it: the &lt;lens&gt;" in told
    bare = pages._section(made(rows=(ShownRow("", (), False),)))
    assert "plots" not in bare and "unlike" not in bare and "<h3>" not in bare


def test_the_page_says_how_it_was_taken() -> None:
    mode = Mode("x", (3, 4), (50, 40), 10, True, thrift=3)
    told = pages._introduction(mode)
    assert "4 x 3 cells" in told and "100 x 80 pixels" in told and "up to 3 times fewer" in told
    assert "fewer" not in pages._introduction(FULL)


def light(level: float = 1.0, size: tuple[int, int] = (40, 60)) -> NDArray[np.float32]:
    return np.full((*size, 3), level, np.float32)


def test_white_is_what_the_brightest_hundredth_gets_to() -> None:
    image = np.linspace(0.0, 1.0, 10_001)[:, None]
    assert picture.white_of(image) == pytest.approx(0.99 / 0.9, rel=1e-3)
    assert picture.white_of(-image) == pytest.approx(0.99 / 0.9, rel=1e-3)
    image[5:] = np.nan
    assert picture.white_of(image) < 0.01
    assert picture.white_of(np.full((2, 2), np.nan)) == 0.0


def test_panels_of_a_row_share_a_scale_unless_they_have_their_own() -> None:
    row = Row((Panel(light(0.9), ""), Panel(light(0.45), ""), Panel(light(0.45), "", white=0.5)))
    one, half, own = (int(drawn[0, 0, 0]) for drawn in picture.drawn(row))
    assert one == own > half > 0.5 * one  # a gamma lifts what is half as bright
    dark = picture.drawn(Row((Panel(light(0.0), ""),)))[0]
    assert dark[0, 0].tolist() == [0, 0, 0]


def test_a_signed_picture_is_grey_at_nothing_and_straight_about_it() -> None:
    values = [-2.0, -1.0, 0.0, 0.5, 1.0, np.nan]
    found = []
    for value in values:
        (drawn,) = picture.drawn(Row((Panel(light(value), "", white=1.0, signed=True),)))
        found.append(int(drawn[20, 20, 0]))
    assert found == [0, 0, 128, 191, 255, picture.UNKNOWN]


@pytest.mark.parametrize(("width", "shown"), [(100, 480), (479, 480), (500, 492), (1300, 1280)])
def test_pictures_lose_their_rim_and_are_as_wide_as_their_strip(width: int, shown: int) -> None:
    image = light(0.2, (80, width))
    rim = max(round(0.008 * width), 1)
    image[rim:-rim, rim:-rim] = 0.9
    (drawn,) = picture.drawn(Row((Panel(image, "a caption", white=1.0),)))
    assert drawn.shape[1] == shown == max(width - 2 * rim, 480)
    height = round((80 - 2 * rim) * shown / (width - 2 * rim))
    assert drawn.dtype == np.uint8 and drawn.shape[0] > height
    assert np.ptp(drawn[:height]) <= 2  # nothing of the rim is left


def test_grey_panels_are_enlarged_by_whole_factors() -> None:
    pixels = np.array([[0, 255, 7], [9, 8, 6]], np.uint8)
    (drawn,) = picture.drawn(Row((Panel(pixels, "", kind="grey"),)))
    assert drawn.shape[1] == 480 and drawn[:320].shape == (320, 480, 3)
    back = drawn[80:320:160, 80::160, 1]
    assert np.array_equal(back, pixels)
    odd = np.zeros((2, 7), np.uint8)
    assert picture.drawn(Row((Panel(odd, "", kind="grey"),)))[0].shape[1] == 7 * 69
    colours = np.arange(600 * 3, dtype=np.uint8).reshape(1, 600, 3)
    assert np.array_equal(picture.drawn(Row((Panel(colours, "", kind="grey"),)))[0][:1], colours)


def test_plots_are_drawn_alike_and_wide_ones_wider(monkeypatch: pytest.MonkeyPatch) -> None:
    """All but the pixels, which take seconds and are looked at by people."""
    figures = pytest.importorskip("matplotlib.figure")
    told: list[Any] = []

    def saved(figure: Any, file: Any, **how: Any) -> None:
        file.write(b"of a plot")
        told.append((figure, how))

    def draw(axes: Any) -> None:
        axes.plot([0, 1], [0, 1], color=colour(1), label="a line")
        finish(axes, "title", "time / s", "light")

    monkeypatch.setattr(figures.Figure, "savefig", saved)
    assert [plotted(Plot("p", draw, "c", wide)) for wide in (False, True)] == [b"of a plot"] * 2
    (plain, how), (wide, _) = told
    width, height = plain.get_size_inches()
    assert tuple(wide.get_size_inches()) == (pytest.approx(1.6 * width), height) and width > height
    # A time or a version of a library in it would change a file that is else the same.
    assert how["metadata"] == {"Software": None} and how["format"] == "png" and how["dpi"] > 90
    (axes,) = plain.axes
    assert (axes.get_title(), axes.get_xlabel(), axes.get_ylabel()) == (
        "title",
        "time / s",
        "light",
    )
    assert axes.get_legend() is not None
    finish(wide.add_subplot(), "", "", "")
    assert wide.axes[-1].get_legend() is None


def test_lines_have_colours_of_their_own() -> None:
    assert len({colour(n) for n in range(len(PALETTE))}) == len(PALETTE)
    assert colour(len(PALETTE)) == colour(0) != colour(1)


@pytest.mark.parametrize(("count", "codes"), [(512, 128), (4, 1), (7, 1), (1, 1), (8, 2)])
def test_the_paper_counts_each_code_four_times(count: int, codes: int) -> None:
    assert codes_printed(count) == codes


def test_captures_on_one_bench_are_told_by_what_stands_there() -> None:
    same = Take("vase", "indirect", {"codes": 8}, {"a": 1, "b": 2}, bound=0.1, said="x")
    assert same.stands == Take("vase", "white", {}, {"b": 2, "a": 1}).stands
    others = (
        Take("wax", "indirect", {}, {"a": 1, "b": 2}), Take("vase", "white", {}, {"a": 2, "b": 2}),
        Take("vase", "white", {}, {"a": 1, "b": 2}, off_axis=True),
        Take("vase", "white", {}, {"a": 1, "b": 2}, perfect=True),
        Take("vase", "white", {}, {"a": 1, "b": 2}, f_number=8.0),
        Take("vase", "white", {}, {"a": 1, "b": 2}, grid=(3, 4)),
    )  # fmt: skip
    assert len({same.stands, *(other.stands for other in others)}) == 7


def taken(error: float = 0.1, **fields: Any) -> Photo:
    image = light(0.5)
    told: dict[str, Any] = {
        "pictures": {"a": image}, "truths": {"a": image}, "errors": {"a": error}, "transport": None,
        "transport_truth": None, "summary": {}, "grid": (3, 4),
    }  # fmt: skip
    return Photo(**(told | fields))


@pytest.mark.parametrize(
    ("bound", "error", "held"),
    [(None, 9.0, True), (0.1, 0.1, True), (0.1, 0.11, False), (0.1, float("nan"), False),
     (None, float("nan"), True)],
)  # fmt: skip
def test_a_capture_is_held_against_its_bound(bound: float | None, error: float, held: bool) -> None:
    found = captured("ours", Take("vase", "indirect", bound=bound, said="s"), taken(error))
    assert found.held is held and (found.error is None) == bool(np.isnan(error))
    assert (found.name, found.said, found.scene, found.codes) == ("ours", "s", "vase", None)


def test_a_capture_of_entries_is_judged_by_these() -> None:
    truth = np.full((2, 2, 3), 2.0)
    found = truth + 0.5
    found[0, 0] = np.nan
    one = taken(9.0, transport=found, transport_truth=truth, summary={"codes": 8.0, "shots": 3})
    told = captured("slice", Take("vase", "transport"), one)
    assert told.error == pytest.approx(0.25) and (told.codes, told.exposures) == (8, 3)
    unknown = taken(9.0, transport=found)
    assert captured("slice", Take("vase", "transport"), unknown).error is None
    none = taken(summary={"family": "none", "codes": 8, "exposure_s": 2.5})
    bare = captured("w", Take("vase", "white"), none)
    assert (bare.codes, bare.family, bare.exposure_s) == (None, "none", 2.5)


def test_a_number_keeps_what_was_stated_of_it() -> None:
    told = stated(Number("n", 0.5, 0.1, 0.9, "0.4", True))
    assert (told.what, told.value, told.least, told.most) == ("n", 0.5, 0.1, 0.9)
    assert (told.paper, told.percent, told.held) == ("0.4", True, True)
    lost = stated(Number("n", float("nan")))
    assert lost.value is None and not lost.held


def test_errors_of_pictures_are_over_the_rms_of_their_truth() -> None:
    truth = np.full((2, 3, 3), 2.0)
    image = truth + 0.5
    image[0] = 99.0
    where = np.array([[False] * 3, [True] * 3])
    assert photos._error(image, truth, where) == pytest.approx(0.25)
    assert np.isnan(photos._error(image, 0.0 * truth, where))

    def sampler(image: Any, known: Any) -> Any:
        return image.copy(), known

    seen = photos._on_field(sampler, image, where)  # type: ignore[arg-type]
    assert np.isnan(seen[0]).all() and np.array_equal(seen[1], image[1])


def test_entries_that_nobody_photographed_are_not_there(tmp_path: Path) -> None:
    run: Any = SimpleNamespace(manifest=SimpleNamespace(files={}))
    scene: Any = None
    assert photos._transport(run, scene) == (None, None)
    found = np.full((2, 1, 3), 0.25)
    sigma = np.zeros((2, 1, 3))
    sigma[1] = np.inf
    np.savez(
        tmp_path / "t.npz", transport=found, sigma=sigma, camera_cells=np.array([0, 1]),
        projector_cells=np.array([1]),
    )  # fmt: skip
    run = SimpleNamespace(
        manifest=SimpleNamespace(files={TRANSPORT: None}),
        checked=lambda _: tmp_path / "t.npz",
    )

    def apply(lit: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.repeat((lit @ np.array([[1.0, 2.0], [3.0, 4.0]]).T)[..., None], 3, axis=2)

    scene = SimpleNamespace(cells=2, apply=apply)
    told, truth = photos._transport(run, scene)
    assert told is not None and truth is not None
    assert np.array_equal(told[0], found[0]) and np.isnan(told[1]).all()
    assert truth[:, 0, 0].tolist() == [2.0, 4.0]  # light of projector cell 1 in cells 0 and 1


def test_photos_of_entries_come_back_too(tmp_path: Path) -> None:
    entries = np.arange(12.0).reshape(2, 2, 3)
    one = taken(0.25, transport=entries, transport_truth=2.0 * entries, summary={"codes": None})
    (tmp_path / "p.npz").write_bytes(photos.packed(one))
    back = photos.unpacked(tmp_path / "p.npz")
    assert back.transport is not None and np.array_equal(back.transport, entries)
    assert back.transport_truth is not None and np.array_equal(back.transport_truth, 2.0 * entries)
    assert (back.answer, back.error, back.grid) == ("a", 0.25, (3, 4))


@pytest.mark.parametrize(
    ("take", "cost"),
    [(Take("a", "transport", {"codes": 512}), 8.0), (Take("a", "white"), 1.5),
     (Take("a", "indirect", {"codes": 128}), 3.0)],
)  # fmt: skip
def test_captures_cost_as_their_codes_do(take: Take, cost: float) -> None:
    assert engine._cost(take) == cost


def work(folder: Path, takes: dict[str, Take]) -> Any:
    store = Store(folder, TINY, plots=False)
    figure: Any = SimpleNamespace(number="1", takes=lambda mode: takes)
    return engine._Work(store, TINY, [figure], engine.Outcome(), False), store


def test_captures_before_one_bench_are_taken_together_the_dearest_first(tmp_path: Path) -> None:
    takes = {f"v{n}": Take("vase", "white", {"seed": n}) for n in range(9)}
    takes["dear"] = Take("wax", "indirect", {"codes": 2048})
    found, store = work(tmp_path, takes)
    groups = found._groups()
    assert [len(group) for group in groups] == [1, 5, 4]  # no more than eight at once
    names = {store.photo_name(take): take for take in takes.values()}
    assert {name for group in groups for name in group} == set(names)
    assert all(names[name] == take for group in groups for name, take in group.items())
    store.write(store.photo_name(takes["dear"]), b"there")
    assert [len(group) for group in found._groups()] == [5, 4]


def test_how_far_captures_are_is_told_by_what_they_cost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 100.0
    monkeypatch.setattr(engine.time, "monotonic", lambda: now_s)  # type: ignore[attr-defined]
    takes = {str(n): Take("vase", "white", {"seed": n, "codes": 64 * n}) for n in (1, 2, 3)}
    found, store = work(tmp_path, takes)
    assert found._ahead() == engine.Ahead(0, 3, ("1",), None)
    now_s = 110.0
    store.write(store.photo_name(takes["3"]), b"there")  # 4 of 2 + 3 + 4
    ahead = found._ahead()
    assert (ahead.taken, ahead.of, ahead.left_s) == (1, 3, pytest.approx(12.5))


def test_a_capture_that_fails_costs_the_figures_that_need_it(tmp_path: Path) -> None:
    takes = {"a": Take("vase", "white"), "b": Take("wax", "white")}
    found, store = work(tmp_path, takes)
    names = {name: store.photo_name(take) for name, take in takes.items()}
    fine: Any = SimpleNamespace(exception=lambda: None)
    lost: Any = SimpleNamespace(exception=lambda: DiskError("full"))
    found._ended(fine, {names["a"]: takes["a"]})
    store.write(names["b"], b"there")
    found._ended(lost, {names["b"]: takes["b"]})  # taken before it failed
    assert found._outcome.failed == {} and [*found._left] == ["1"]
    found._ended(lost, {names["a"]: takes["a"]})
    assert found._outcome.failed == {"1": "full"} and not found._left


def test_quick_figures_have_fewer_codes_but_enough() -> None:
    assert [TINY.codes(n) for n in (8, 16, 60, 64, 68)] == [8, 16, 16, 16, 17]
    assert FULL.codes(512) == 512 and QUICK.codes(512) == 128
