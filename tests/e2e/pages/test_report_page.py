"""`report.html` in a real browser, without a network: pictures, values, weights, late refreshes.

What the page shows is held against the run's own files and `pdcd row`, not against what made it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig
from pdcd.pages.report import write_report
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.row import read_matrix_row
from pdcd.pictures.written.picture_files import read_tiff
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.folder import read_manifest
from pdcd.runs.verify import verify_run
from tests import bench_rig, tools
from tests.browser import Tab, browser
from tests.taken import started, take

ROWS, COLS = bench_rig.GRID
EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\"'&{{script}}\u202e"

pytestmark = [tools.needs("chromium"), pytest.mark.whole]


@pytest.fixture(scope="module")
def tab() -> Iterator[Tab]:
    with browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with noise, late refreshes and a hostile note, under a rig of a hostile name."""
    folder = tmp_path_factory.mktemp("run")
    config = bench_rig.with_defects(folder, camera=CameraConfig(noise="full"))
    rig = msgspec.structs.replace(config.rig, name=EVIL)
    config = msgspec.structs.replace(config, rig=rig)
    with started(config) as engine:
        # As it is: what a client sends would be refused for such a note.
        request = CaptureRequest(goal="indirect", codes=8, note=EVIL)
        made = Path(str(bench_rig.capture(engine, request).folder))
    write_report(made)
    return made


@pytest.fixture
def page(tab: Tab, run: Path) -> Iterator[Any]:
    tab.faults.clear()
    yield tab.open(run / "report.html")
    assert tab.faults == []
    assert len(tab.asked) == 1, tab.asked  # the page itself, and nothing else


def test_values_are_those_of_the_linear_pictures_and_of_the_error_bars(
    page: Any, run: Path
) -> None:
    """Here the camera fills the field with a quad a cell: a pixel of the page is a quad."""
    told = page.evaluate("JSON.parse(document.getElementById('data').textContent)")
    assert told["size"] == [COLS, ROWS] and told["quads"] == 1
    decoded = Darkroom(run, read_manifest(run).run).decoded()
    step = {p["name"]: p["values"]["step"] for p in told["pictures"] if p["kind"] == "picture"}
    known = 0
    for y, x in np.ndindex(ROWS, COLS):
        found = page.evaluate(f"report.valuesAt({x}, {y})")
        assert found["cell"] == [y, x]
        for side in found["sides"]:
            name = side["id"]
            kept = read_tiff(run / "linear" / f"{name}.tif")[y, x]
            sigma = decoded.pictures[name].sigma[y, x]
            if not np.isfinite(sigma).all():  # saturated
                assert np.isnan(side["value"]).all() and np.isinf(side["sigma"]).all()
                continue
            known += 1
            np.testing.assert_allclose(side["value"], kept, rtol=0, atol=0.501 * step[name])
            np.testing.assert_allclose(side["sigma"], sigma, rtol=0.02)
    assert known > ROWS * COLS
    # Rounding stays well below the noise.
    answer = decoded.answer
    assert step["indirect"] < np.median(answer.sensor)


def test_the_pointer_reads_values_and_the_slider_divides(page: Any) -> None:
    page.locator("#stage").scroll_into_view_if_needed()
    stage = page.locator("#stage").bounding_box()
    page.mouse.move(stage["x"] + 0.9 * stage["width"], stage["y"] + 0.1 * stage["height"])
    words = page.locator("#readout").inner_text()
    assert f"x {COLS - 1}  y 0  cell 0 {COLS - 1}" in words and "scene units" in words
    assert words.count("\u00b1") == 6

    def shown(at: float) -> list[int]:
        page.locator("#divide").fill(str(at))
        clip = page.evaluate("getComputedStyle(document.getElementById('right-canvas')).clipPath")
        assert f"{at:g}%" in clip
        return list(page.locator("#stage").screenshot())

    assert shown(0) != shown(100)  # the other picture lies below
    line = page.locator("#line").bounding_box()
    page.mouse.move(line["x"] + 6, line["y"] + 20)
    page.mouse.down()
    page.mouse.move(stage["x"] + 0.25 * stage["width"], line["y"] + 20)
    page.mouse.up()
    assert float(page.locator("#divide").input_value()) == pytest.approx(25.0, abs=0.6)


def test_every_view_can_be_shown_on_either_side(page: Any, run: Path) -> None:
    views = page.locator("#left option").all_inner_texts()
    names = {path.stem for path in (run / "linear").iterdir()}
    assert names | {f"{name}: sigma" for name in names} <= set(views)
    assert {"indirect: truth", "indirect: error", "indirect: error / sigma"} <= set(views)
    for view in views:
        page.locator("#left").select_option(view)
        page.wait_for_selector(f'body[data-shown="{view} | indirect"]')
    truth = np.load(run / "truth.npz")["image"].reshape(ROWS, COLS, 3)[1, 1]
    page.locator("#left").select_option("indirect: error")
    page.wait_for_selector('body[data-shown="indirect: error | indirect"]')
    error = page.evaluate("report.valuesAt(1, 1)")["sides"]
    wanted = read_tiff(run / "linear" / "indirect.tif")[1, 1] - truth
    told = page.evaluate("JSON.parse(document.getElementById('data').textContent)")["pictures"]
    steps = sum(p["values"]["step"] for p in told if p["name"] == "indirect")
    np.testing.assert_allclose(error[0]["value"], wanted, atol=0.51 * steps)


def test_hostile_texts_are_shown_and_do_nothing(page: Any, tab: Tab) -> None:
    said = page.locator(".said").inner_text()
    assert said.startswith("note: </script><script>alert(1)</script><img src=x onerror=alert(2)>")
    assert "\u202e" not in page.content()
    assert page.locator("img").count() == 0 and page.locator("script").count() == 2
    # Even what got in could not fetch anything, nor run: the page's policy forbids it.
    page.evaluate(
        "document.body.insertAdjacentHTML('beforeend', '<img src=http://x/ onerror=a()>')"
    )
    page.wait_for_timeout(50)
    assert len(tab.faults) >= 2
    assert all("Content Security Policy" in fault for fault in tab.faults)
    tab.faults.clear()
    tab.asked[1:] = []


def test_late_refreshes_are_marked(page: Any, run: Path) -> None:
    lines = (run / "frames.csv").read_text().splitlines()
    heads = lines[0].split(",")
    rows = [dict(zip(heads, line.split(","), strict=True)) for line in lines[1:]]
    late = [r for r in rows if (r["shot"] == "coded" and "0" != r["missed"]) or r["dropped"] == "1"]
    late = [r for r in late if r["shot"] == "coded"]
    assert late
    page.locator("#shot").select_option("coded")
    page.wait_for_selector(f'body[data-late="coded {len(late)}"]')
    words = page.locator("#late-told").inner_text()
    assert all(f" {r['refresh']} at " in words for r in late[:5])
    assert words.count("another one shown") == sum(r["dropped"] == "1" for r in late) > 0


def test_a_time_line_that_leaves_bars_out_says_so(tab: Tab, run: Path, tmp_path: Path) -> None:
    text = (run / "report.html").read_text()
    begin, data, end = re.split(r"(?<=id=\"data\">)(.*?)(?=</script>)", text, flags=re.S)
    told = json.loads(data)
    told["shots"] = told["shots"][:1] * 41
    doctored = tmp_path / "page.html"
    for shots in (told["shots"], told["shots"][:40]):
        told["shots"] = shots
        doctored.write_text(begin + json.dumps(told).replace("<", "\\u003c") + end)
        words = tab.open(doctored).locator("#time-told").inner_text()
        assert ("Bars of the first 40 of 41 shots" in words) == (len(shots) == 41)


def test_the_verdict_and_its_reasons_are_those_of_the_manifest(page: Any, run: Path) -> None:
    quality: Any = read_manifest(run).summary["quality"]
    assert page.locator("#verdict").inner_text() == quality.verdict
    told = page.locator(".reasons li").all_inner_texts()
    for reason in (*quality.reasons, *quality.remarks):
        assert any(reason in line for line in told)
    assert verify_run(run).whole and verify_run(run).later == ("report.html",)


@pytest.mark.parametrize(
    "fields",
    [
        {"goal": "indirect", "normalise": "row", "family": "bernoulli", "window": "quarter"},
        {"goal": "short-range", "radius": 1},
        pytest.param({"goal": "descattered", "shift": (0, -1)}, marks=pytest.mark.long),
        {"goal": "relit", "matrix": np.random.default_rng(3).random((12, 12)).tolist()},
    ],
    ids=lambda fields: str(fields["goal"]),
)
def test_rows_of_the_page_are_those_of_pdcd_row(tab: Tab, tmp_path: Path, fields: Any) -> None:
    """Every photo, wanted and realised, within the rounding that the page states."""
    config = bench_rig.with_defects(tmp_path)
    folder = take(config, codes=16, **fields).folder
    tab.faults.clear()
    page = tab.open(write_report(folder))
    names = page.locator("#photo option").all_inner_texts()
    assert names
    for name in names:
        for r, c in ((0, 0), (1, 2), (2, 3)):
            found = page.evaluate(f"report.row({name!r}, {r}, {c})")
            exact = read_matrix_row(folder, (r, c), name)
            assert found["off"] < 0.01
            np.testing.assert_allclose(
                found["realised"], exact.realised.ravel(), rtol=0, atol=found["off"] + 1e-5
            )
            if found["wanted"] is not None:
                np.testing.assert_allclose(found["wanted"], exact.wanted.ravel(), atol=1e-5)
    assert tab.faults == []
