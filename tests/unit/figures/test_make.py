"""A page of figures: what is made once, what is made anew, and what the page says."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.main import main
from pdcd.errors import ConfigError, DecodeError
from pdcd.figures import make as engine
from pdcd.figures.catalog import FIGURES, choose_figures
from pdcd.figures.figure import (
    FULL_MODE,
    QUICK_MODE,
    BoundedNumber,
    FigureMode,
    FigurePanel,
    FigurePhoto,
    FigurePlot,
    FigureTake,
    Line,
    PanelRow,
    PaperFigure,
    Photos,
)
from pdcd.figures.make import PAGE, MakeOutcome, make_paper_figures
from pdcd.figures.record import capture_told, fingerprint_of, read_record
from tests.figures_rig import TINY_MODE

pytestmark = pytest.mark.whole

LIGHT = np.linspace(0.0, 1.0, 96 * 128 * 3, dtype=np.float32).reshape(96, 128, 3)
SUMMARY = {"codes": 16, "family": "hadamard", "shots": 2, "exposure_s": 3.5, "wall_s": 2.0}
PHOTO = FigurePhoto(
    {"indirect": LIGHT}, {"indirect": 0.5 * LIGHT}, {"indirect": 0.0123}, None, None, SUMMARY,
    (12, 16),
)  # fmt: skip
TAKE = FigureTake("still-life", "indirect", {"codes": 64}, bound=0.02, said="<b>ours</b>")


def figure(*numbers: BoundedNumber, number: str = "1", **takes: FigureTake) -> PaperFigure:
    """A figure of one picture, one plot, and numbers."""

    def shown(mode: FigureMode, photos: Photos) -> Iterator[PanelRow | FigurePlot | BoundedNumber]:
        yield from numbers
        yield FigurePlot("p", "t", "x", "y", "a plot", (Line([0, 1], [0, 1]),))
        yield PanelRow(
            (FigurePanel(LIGHT, "a <picture>"), FigurePanel(LIGHT, "another")), "a <row>"
        )

    return PaperFigure(
        number, "one", "see <this>", "the paper & it", "all", lambda mode: takes, shown
    )


FINE = BoundedNumber("a <number>", 1.0, least=0.5, most=1.5, paper="1.0")


@pytest.fixture
def pool() -> Iterator[Executor]:
    with ThreadPoolExecutor(1) as threads:
        yield threads


@pytest.fixture(autouse=True)
def photographed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """No figure of the catalogue stands on the page, and photos are made up; their names."""
    names: list[str] = []

    def photographs(
        takes: dict[str, FigureTake], mode: FigureMode, heard: Any
    ) -> Iterator[tuple[str, FigurePhoto]]:
        for name, take in takes.items():
            if take.goal == "white":
                raise DecodeError("no <light>")
            names.append(name)
            yield name, PHOTO

    monkeypatch.setattr(engine, "photograph_takes", photographs)
    monkeypatch.setattr(engine, "FIGURES", {"1": None, "2": None})
    return names


def page_of(folder: Path) -> str:
    """What is seen of the page, in which nothing is a script and nothing comes from elsewhere."""
    text = (folder / PAGE).read_text(encoding="utf-8")
    assert "<script" not in text and "http:" not in text and "https:" not in text
    return text


def files_of(made: dict[str, Any]) -> list[str]:
    pictures = [one for row in made["rows"] for one in row["pictures"]]
    return [one["file"] for one in (*pictures, *made["plots"])]


def rows_of(page: str) -> list[list[str]]:
    """The cells of all tables."""
    return [
        re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", page, re.S)
    ]


def test_a_figure_that_is_there_is_not_taken_again(
    tmp_path: Path, pool: Executor, photographed: list[str]
) -> None:
    first = make_paper_figures([figure(FINE, ours=TAKE)], tmp_path, TINY_MODE, pool)
    assert first.held and not first.failed and photographed == ["ours"]
    (made,) = first.made
    assert len(files_of(made)) == 3 and all((tmp_path / file).is_file() for file in files_of(made))
    again = make_paper_figures([figure(FINE, ours=TAKE)], tmp_path, TINY_MODE, pool, tell=None)  # type: ignore[arg-type]
    assert again == first and photographed == ["ours"]
    # All that is told is a script's, too.
    kept = json.loads((tmp_path / "data" / "fig-1.json").read_text())
    assert (kept["numbers"][0]["held"], kept["captures"][0]["error"]) == (True, 0.0123)
    assert (kept["seconds"], kept["title"], kept["mode"]) == (2.0, "one", "tiny")


@pytest.mark.parametrize("spoilt", ["a picture", "a plot", "the record"])
def test_what_is_not_whole_is_made_anew(
    tmp_path: Path, pool: Executor, photographed: list[str], spoilt: str
) -> None:
    (made,) = make_paper_figures([figure(ours=TAKE)], tmp_path, TINY_MODE, pool).made
    if spoilt == "the record":
        (tmp_path / "data" / "fig-1.json").write_text('{"number": "1", "fingerprint"')
    else:
        (tmp_path / files_of(made)[0 if spoilt == "a picture" else -1]).unlink()
    assert make_paper_figures([figure(ours=TAKE)], tmp_path, TINY_MODE, pool).made == [made]
    assert photographed == ["ours", "ours"]


def test_another_mode_and_another_program_make_it_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prints = {
        fingerprint_of(mode, plots=plots)
        for mode in (TINY_MODE, QUICK_MODE)
        for plots in (True, False)
    }
    here = fingerprint_of(TINY_MODE, plots=True)
    assert len(prints) == 4 and here in prints
    assert read_record(tmp_path, "1", here) is None
    monkeypatch.setattr("pdcd.figures.record.__version__", "99")
    assert fingerprint_of(TINY_MODE, plots=True) not in prints


def test_the_page_says_what_was_measured(tmp_path: Path, pool: Executor) -> None:
    share = BoundedNumber("a share", 0.5, most=0.25, percent=True)
    bare = replace(TAKE, bound=None, said="")
    made = make_paper_figures(
        [figure(FINE, share, BoundedNumber("free", 3.0), ours=TAKE, more=bare)],
        tmp_path,
        TINY_MODE,
        pool,
    )
    assert not made.held
    page = page_of(tmp_path)
    assert rows_of(page) == [
        [], ["a &lt;number&gt;", "1", "0.5 to 1.5", "1.0", "held"],
        ["a share", "50 %", "at most 25 %", "", "NOT HELD"], ["free", "3", "", "", ""],
        [], ["ours", "&lt;b&gt;ours&lt;/b&gt;", "indirect", "16 hadamard", "64", "2", "3.5 s",
             "1.23 %", "at most 2 %", "held"],
        ["more", "", "indirect", "16 hadamard", "64", "2", "3.5 s", "1.23 %", "", ""],
    ]  # fmt: skip
    assert "1 of 3 numbers are not within their bounds" in page and "Not finished" not in page
    for words in ("Figure 1: one", "see &lt;this&gt;", "the paper &amp; it", "Still unlike it: all",
                  "a &lt;row&gt;", '<div class="row few">', "4 times fewer", "16 x 12 cells",
                  "240 x 160", 'alt="a &lt;picture&gt;"', "<figcaption>a plot"):  # fmt: skip
        assert words in page, words
    assert [*re.findall(r'img src="([^"]*)"', page)] == files_of(made.made[0])


def test_a_page_without_faults_says_so(tmp_path: Path, pool: Executor) -> None:
    folder = tmp_path / "not" / "there"
    make_paper_figures([figure(FINE, ours=TAKE)], folder, FULL_MODE, pool, plots=False)
    page = page_of(folder)
    assert "All 2 numbers are within their stated bounds." in page
    assert "times fewer" not in page and 'class="plots"' not in page and "banner not" not in page


def test_a_figure_that_fails_ends_no_other(tmp_path: Path, pool: Executor) -> None:
    seen: list[str] = []
    told: list[tuple[int, int, float | None]] = []

    def tell(*ahead: Any) -> None:
        told.append(ahead)
        seen.append(page_of(tmp_path) if (tmp_path / PAGE).exists() else "")

    bad = figure(FINE, number="2", scene=FigureTake("still-life", "white"), more=TAKE)
    outcome = make_paper_figures(
        [figure(FINE, ours=TAKE), bad], tmp_path, TINY_MODE, pool, tell=tell
    )
    assert outcome.failed == {"2": "no <light>"} and not outcome.held
    assert [made["number"] for made in outcome.made] == ["1"]
    assert "Could not be made: no &lt;light&gt;" in page_of(tmp_path)
    assert "1 figures could not be made." in page_of(tmp_path)
    assert [one[:2] for one in told] == [(0, 3), (2, 3), (3, 3)]  # the dearest first
    assert (told[0][2], told[2][2]) == (None, 0.0)
    assert "Not finished: still to be made: Figure 1." in seen[1]


def test_figures_are_made_in_processes_that_end_with_the_command() -> None:
    with engine.open_processes(1) as pool:
        assert pool.submit(abs, -2).result() == 2
    with pytest.raises(RuntimeError):
        pool.submit(abs, -2)
    with pytest.raises(ConfigError, match="--workers 0"), engine.open_processes(0):
        pass


def test_processes_end_with_a_command_that_was_killed() -> None:
    """What it printed to ends for its readers when the last process that has it is gone."""
    code = (
        "import os, time\n"
        "from pdcd.figures.make import open_processes\n"
        "with open_processes(1) as pool:\n"
        "    print(pool.submit(os.getpid).result(), flush=True)\n"
        "    time.sleep(3600)\n"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code], stdout=pipe, stderr=pipe) as command:
        assert command.stdout is not None and int(command.stdout.readline()) != command.pid
        command.kill()
        assert command.stdout.read() == b""


@pytest.mark.parametrize(
    ("value", "least", "most", "held"),
    [(1.0, 1.0, 1.0, True), (1.1, None, 1.0, False), (0.9, 1.0, None, False),
     (5.0, None, None, True), (np.nan, None, None, False), (np.inf, 0.0, None, False)],
)  # fmt: skip
def test_bounds(value: float, least: float | None, most: float | None, held: bool) -> None:
    number = BoundedNumber("n", np.float64(value), least, most)
    assert number.held is held and number.value == (value if np.isfinite(value) else None)


@pytest.mark.parametrize(
    ("bound", "error", "held"),
    [(None, 9.0, True), (0.1, 0.1, True), (0.1, 0.11, False), (0.1, float("nan"), False),
     (None, float("nan"), True)],
)  # fmt: skip
def test_a_capture_is_held_against_its_bound(bound: float | None, error: float, held: bool) -> None:
    photo = replace(PHOTO, errors={"indirect": error}, summary={"family": "none", "codes": 8})
    found = capture_told("ours", replace(TAKE, bound=bound), photo)
    assert found["held"] is held and (found["error"] is None) == bool(np.isnan(error))
    told = [found[name] for name in ("name", "scene", "codes", "exposures", "family")]
    assert told == ["ours", "still-life", None, None, "none"]


def test_a_capture_of_entries_is_judged_by_these() -> None:
    truth = np.full((2, 2, 3), 2.0)
    entries = truth + 0.5
    entries[0, 0] = np.nan
    one = replace(PHOTO, transport=entries, transport_truth=truth)
    assert capture_told("slice", TAKE, one)["error"] == pytest.approx(0.25)
    assert capture_told("slice", TAKE, replace(one, transport_truth=None))["error"] is None


def test_all_figures_are_whole() -> None:
    assert choose_figures([]) == list(FIGURES.values())
    assert [one.number for one in choose_figures(["8", "1"])] == ["1", "8"]
    for one in FIGURES.values():
        assert one.title and one.see and one.paper
        assert all(
            name and (take.bound or 1.0) > 0.0 for name, take in one.takes(QUICK_MODE).items()
        )
    with pytest.raises(ConfigError, match="there is no figure 13"):
        choose_figures(["13"])


def test_the_command_by_what_needs_no_photo(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = ["figures", "appendix", "--no-plots", "--json", "--out", str(tmp_path)]
    assert main(asked) == DONE
    told = json.loads(capsys.readouterr().out)
    assert told["held"] and told["figures"][0]["number"] == "appendix"
    monkeypatch.setattr(
        "pdcd.cli.figures.make_paper_figures", lambda *_, **how: MakeOutcome(failed={"1": "why"})
    )
    assert main(asked) == FAILED
