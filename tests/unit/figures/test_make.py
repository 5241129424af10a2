"""The engine of figures: what is made once, what is made anew, what a page says of itself."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.main import main
from pdcd.errors import ConfigError
from pdcd.figures import make as engine
from pdcd.figures.catalog import FILES, figures_of
from pdcd.figures.figure import (
    QUICK,
    TINY,
    Drawn,
    Figure,
    Mode,
    Number,
    Panel,
    Photo,
    Row,
    Take,
)
from pdcd.figures.page import page
from pdcd.figures.photo import packed, unpacked
from pdcd.figures.store import PAGE, Store

LIGHT = np.linspace(0.0, 1.0, 96 * 128 * 3, dtype=np.float32).reshape(96, 128, 3)
PHOTO = Photo(
    {"indirect": LIGHT},
    {"indirect": 0.5 * LIGHT},
    {"indirect": 1.0},
    None,
    None,
    {"codes": 16, "family": "hadamard", "shots": 2, "exposure_s": 3.5},
    (12, 16),
)
TAKE = Take("still-life", "indirect", {"codes": 64}, bound=1.5, said="<b>ours</b>")


def figure(value: float = 1.0, **takes: Take) -> Figure:
    """A figure of one picture and one number that is to be 1."""

    def drawn(mode: Mode, photos: Mapping[str, Photo]) -> Drawn:
        number = Number("a <number>", value, least=0.5, most=1.5, paper="1.0")
        return Drawn((Row((Panel(LIGHT, "a picture"),), "a row"),), numbers=(number,))

    texts = ("one", "see <this>", "the paper & it", "")
    return Figure("1", *texts, takes=lambda mode: takes, drawn=drawn)


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """No figure of the catalogue stands on the page beside the test's own."""
    monkeypatch.setattr(engine, "FILES", {"1": "fig01"})
    monkeypatch.setattr(engine, "figure_of", lambda number: figure())


@pytest.mark.usefixtures("alone")
def test_a_figure_is_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = engine.make([figure()], tmp_path, TINY, plots=False)
    assert first.held and not first.failed
    (made,) = first.made
    assert all((tmp_path / file).is_file() for file in made.files)
    shown = (tmp_path / PAGE).read_text()
    assert "Not finished" not in shown and "within their stated bounds" in shown
    monkeypatch.setattr(engine, "write_figure", None)  # made again, it would fail
    assert engine.make([figure()], tmp_path, TINY, plots=False).made == [made]


@pytest.mark.usefixtures("alone")
def test_what_changes_is_made_anew(tmp_path: Path) -> None:
    store = Store(tmp_path, TINY, plots=False)
    engine.make([figure()], tmp_path, TINY, plots=False)
    assert store.made(figure()) is not None
    assert store.made(figure(more=TAKE)) is None
    assert Store(tmp_path, QUICK, plots=False).made(figure()) is None
    assert Store(tmp_path, TINY).made(figure()) is None
    lost = next(iter(engine.make([figure()], tmp_path, TINY, plots=False).made[0].files))
    (tmp_path / lost).unlink()
    assert store.made(figure()) is None
    (tmp_path / "data" / "fig-1.json").write_text('{"number": "1", "fingerprint"')
    assert store.made(figure()) is None


def test_arrays_of_a_capture_count_in_its_name(tmp_path: Path) -> None:
    store = Store(tmp_path, TINY)
    names = {
        store.photo_name(Take("still-life", "illuminated", {"illumination": light}))
        for light in (np.zeros((2, 2)), np.ones((2, 2)), np.ones((2, 2)))
    }
    assert len(names) == 2


def test_photos_come_back_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "photo.npz"
    path.write_bytes(packed(PHOTO))
    back = unpacked(path)
    assert np.array_equal(back.image, PHOTO.image) and np.array_equal(back.truth, PHOTO.truth)
    assert back.errors == PHOTO.errors and back.summary == PHOTO.summary
    assert back.grid == PHOTO.grid and back.transport is None
    store = Store(tmp_path, TINY)
    store.write(store.photo_name(TAKE), path.read_bytes()[:-20])
    assert store.photo(store.photo_name(TAKE)) is None


@pytest.mark.usefixtures("alone")
def test_photos_that_are_there_are_not_taken_again(tmp_path: Path) -> None:
    wanted = figure(ours=TAKE)
    store = Store(tmp_path, TINY, plots=False)
    store.write(store.photo_name(TAKE), packed(PHOTO))
    outcome = engine.make([wanted], tmp_path, TINY, plots=False)
    assert outcome.held
    (captured,) = outcome.made[0].captures
    assert (captured.codes, captured.error, captured.bound) == (16, 1.0, 1.5)
    assert not list((tmp_path / "data" / "photos").iterdir())  # no longer needed


@pytest.mark.usefixtures("alone")
def test_a_number_beyond_its_bounds_is_said(tmp_path: Path) -> None:
    outcome = engine.make([figure(2.0)], tmp_path, TINY, plots=False)
    assert not outcome.held
    made = outcome.made[0]
    shown = page([made], TINY, {}, [])
    assert "NOT HELD" in shown and "1 of 1 numbers are not within" in shown


def test_a_page_says_that_it_is_not_finished() -> None:
    shown = page([], TINY, {"5": "no <light>"}, ["1", "table-2"])
    assert "Not finished: still to be made: Figure 1, Table 2." in shown
    assert "no &lt;light&gt;" in shown and "<light>" not in shown


@pytest.mark.usefixtures("alone")
def test_texts_are_no_markup(tmp_path: Path) -> None:
    engine.make([figure()], tmp_path, TINY, plots=False)
    shown = (tmp_path / PAGE).read_text()
    assert "see &lt;this&gt;" in shown and "a &lt;number&gt;" in shown
    assert "<script" not in shown and "http" not in shown


@pytest.mark.parametrize(
    ("value", "least", "most", "held"),
    [(1.0, 1.0, 1.0, True), (1.1, None, 1.0, False), (0.9, 1.0, None, False),
     (float("nan"), None, None, False), (float("inf"), 0.0, None, False)],
)  # fmt: skip
def test_bounds(value: float, least: float | None, most: float | None, held: bool) -> None:
    assert Number("n", value, least, most).held is held


def test_codes_of_a_mode() -> None:
    assert [QUICK.codes(count) for count in (16, 32, 64, 128, 256)] == [16, 32, 32, 32, 64]


def test_all_figures_are_whole() -> None:
    found = figures_of([])
    assert [one.number for one in found] == list(FILES)
    for one in found:
        assert one.title and one.see and one.paper
        for name, take in one.takes(QUICK).items():
            assert name and (take.bound or 1.0) > 0.0
    with pytest.raises(ConfigError, match="there is no figure 13"):
        figures_of(["13"])


def test_the_command_by_what_needs_no_photo(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["figures", "appendix", "--no-plots", "--json", "--out", str(tmp_path)]
    assert main(asked) == DONE
    told = json.loads(capsys.readouterr().out)
    assert told["held"] and told["figures"][0]["number"] == "appendix"
    assert (tmp_path / PAGE).is_file()


@pytest.mark.usefixtures("alone")
def test_the_command_fails_where_a_number_is_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("pdcd.cli.figures.figures_of", lambda numbers: [figure(9.0)])
    assert main(["figures", "--no-plots", "--out", str(tmp_path)]) == FAILED
    assert "NOT HELD: a <number>" in capsys.readouterr().out
