"""The page in a real browser, before a daemon with the mock bench."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from pdcd.bench.tables import (
    BenchConfig,
    CameraConfig,
    Config,
    PanelConfig,
    SceneConfig,
    ServerConfig,
)
from pdcd.panels.placing import Placing
from tests import bench_rig
from tests.browser import READY_MS, Tab, launched
from tests.e2e.web._bench import Bench, bench
from tests.tools import needs

pytestmark = [needs("chromium"), pytest.mark.whole]
HOSTILE = "<img src=x onerror=alert(1)><script>alert(2)</script>"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser for all tests of this file; each has a profile of its own."""
    with launched() as made:
        yield made


@contextmanager
def page(chromium: Any, here: Bench, first: str = "") -> Iterator[Any]:
    """A page that was opened at the printed address; fails on any error of its scripts."""
    context = chromium.new_context(viewport={"width": 1280, "height": 900})
    try:
        tab = Tab(context.new_page())
        tab.page.set_default_timeout(READY_MS)
        tab.page.goto(here.address + first)
        yield tab.page
    finally:
        context.close()
    # A daemon that is away, or refuses, is told of by the status of an answer.
    assert not [fault for fault in tab.faults if "Failed to load resource" not in fault]
    assert all(url.startswith(("blob:", here.address.partition("#")[0])) for url in tab.asked)


def test_a_photo_from_the_form_ends_with_a_picture(chromium: Any, tmp_path: Path) -> None:
    config = bench_rig.config(tmp_path, camera=CameraConfig(noise="none", f_number=8.0))
    with bench(tmp_path, config) as here, page(chromium, here) as opened:
        start = opened.locator("#start:enabled")
        start.wait_for()
        goals = opened.locator("#field-goal option").all_inner_texts()
        assert "indirect" in goals and "transport" in goals
        # What a goal needs is asked for; what it does not take cannot be given.
        opened.select_option("#field-goal", "fraction")
        assert opened.locator("#fields-first #field-p").is_visible()
        start.click()
        opened.locator("#form-trouble", has_text="fraction needs p").wait_for()
        opened.fill("#field-p", "1.5")
        start.click()
        opened.locator(
            "#form-trouble", has_text="p: it takes a number over 0 and below 1, not 1.5"
        ).wait_for()
        opened.select_option("#field-goal", "indirect")
        assert not opened.locator("#field-p").is_visible()
        opened.fill("#field-codes", "8")
        opened.fill("#field-note", HOSTILE)
        opened.locator("#plan").click()
        opened.locator("#plan-answer", has_text="8 hadamard").wait_for()
        start.click()
        opened.locator("#job-stage.done").wait_for()
        shown = opened.locator("#picture[alt^='indirect of ']")
        shown.wait_for()
        assert opened.locator("#picture-names button").all_inner_texts() == [
            "indirect", "direct", "white",
        ]  # fmt: skip
        # Its bytes are those on the disk.
        job = opened.locator("#picture-of").inner_text().rpartition(", ")[2]
        place = here.state / f"captures/{job}/preview/indirect.png"
        who = {"Authorization": f"Bearer {here.address.partition('#')[2]}"}
        told = opened.request.get(f"{opened.url}picture/{job}/indirect", headers=who)
        assert told.body() == place.read_bytes()
        assert shown.evaluate("image => image.complete && image.naturalWidth") > 0
        assert opened.locator("#runs tr").count() == 1
        assert HOSTILE in opened.locator("#runs td.words").inner_text()
        # The report of the run works where it can reach nothing.
        with opened.context.expect_page() as report:
            opened.locator("#runs .report").click()
        shown_there = Tab(report.value)
        shown_there.page.wait_for_selector("body[data-ready=yes]", timeout=READY_MS)
        assert shown_there.faults == []
        # What lets in is not in the address, and the page that is loaded again has it still.
        assert opened.url == here.address.partition("#")[0]
        opened.reload()
        opened.locator("#start:enabled").wait_for()
        opened.set_viewport_size({"width": 390, "height": 800})
        assert opened.evaluate("document.documentElement.scrollWidth") == 390


def test_numbers_keep_their_size(chromium: Any, tmp_path: Path) -> None:
    """120.3 s were "12 s", 99.97 % were "1 %": zeros that count were taken for idle ones."""
    wanted = {
        0.1: "0.1", 120.3: "120", 99.97: "100", 10.04: "10", 1.2e-10: "1.2e-10", 1234.5: "1230",
        -150.4: "-150", 25.84: "25.8", 100: "100", 4096: "4096", 0.00833: "0.00833",
    }  # fmt: skip
    with bench(tmp_path, bench_rig.config(tmp_path)) as here, page(chromium, here) as opened:
        opened.locator("#start:enabled").wait_for()
        say = "async (all) => all.map((await import('./dom.js')).short)"
        assert opened.evaluate(say, list(wanted)) == list(wanted.values())


def test_the_page_outlives_the_daemon_and_cancels(chromium: Any, tmp_path: Path) -> None:
    config = bench_rig.config(tmp_path)
    with bench(tmp_path, config) as here, page(chromium, here) as opened:
        opened.locator("#start:enabled").wait_for()
        here.stop()
        opened.locator("#state.away").wait_for()
        assert "does not answer" in opened.locator("#trouble").inner_text()
        assert opened.locator("#start").is_disabled()
        here.start()
        opened.locator("#start:enabled").wait_for()
        assert opened.locator("#trouble").is_hidden()
        opened.fill("#field-codes", "2048")
        opened.click("#start")
        opened.locator("#cancel:enabled").click()
        opened.locator("#job-stage.cancelled").wait_for()
        opened.locator("#state.idle").wait_for()


TOO_WIDE = """() => [...document.querySelectorAll("body *")].filter((each) => {
  const { left, right, width } = each.getBoundingClientRect();
  const cut = each.matches("button, dd, dt, p") && each.scrollWidth > each.clientWidth + 1;
  return width && !each.closest(".scroll table") && (left < 0 || right > innerWidth + 1 || cut);
}).map((each) => each.outerHTML.slice(0, 200))"""
"""What sticks out of the page, or is cut off; a table may be scrolled."""


@pytest.mark.parametrize("width", [1280, 390])
def test_nothing_sticks_out(chromium: Any, tmp_path: Path, width: int) -> None:
    """Form and plan, a photo and its end, live view, runs, focus: as they follow on each other."""
    with bench(tmp_path, _card_bench(tmp_path)) as here, page(chromium, here) as opened:

        def check(what: str) -> None:
            assert opened.evaluate(TOO_WIDE) == [], what
            assert opened.evaluate("document.documentElement.scrollWidth") == width, what

        opened.set_viewport_size({"width": width, "height": 900})
        opened.locator("#start:enabled").wait_for()
        opened.click("#more summary")
        for goal in opened.locator("#field-goal option").all_inner_texts():
            opened.select_option("#field-goal", goal)
            check(f"form of {goal}")
        opened.select_option("#field-goal", "indirect")
        opened.click("#more summary")
        opened.fill("#field-codes", "x" * 300)
        opened.click("#plan")
        opened.locator("#form-trouble", has_text="a whole number from 1").wait_for()
        check("a refusal")
        opened.fill("#field-codes", "8")
        opened.click("#plan")
        opened.locator("#plan-answer", has_text="8 hadamard").wait_for()
        check("a plan")
        # It is where one looks: below the button, and on the screen.
        button, plan = (opened.locator(i).bounding_box() for i in ("#plan", "#plan-answer"))
        assert 0.0 <= plan["y"] - button["y"] - button["height"] < 40.0
        assert plan["y"] < 900.0 and plan["y"] + plan["height"] > 0.0
        opened.fill("#field-name", "W" * 80)
        opened.fill("#field-tags", "t" * 40 + " " + "u" * 40)
        opened.fill("#field-note", "n" * 400)
        opened.click("#start")
        opened.locator("#job-stage.done").wait_for()
        opened.locator("#picture[alt^='indirect of ']").wait_for()
        opened.locator("#runs tr").wait_for()
        check("a photo, and the list of runs")
        opened.click("#live")
        opened.locator("#live-figures dd", has_text="pictures a second").wait_for()
        check("a live view")
        opened.click("#focus")
        opened.locator("#attention-text", has_text="white card").wait_for()
        check("what somebody is asked to do")
        opened.click("#proceed")
        opened.locator("#focus-now", has_text="now 0.").wait_for()
        check("focus")
        opened.click("#cancel:enabled")
        opened.locator("#job-stage.cancelled").wait_for()
        check("a job that was cancelled")


def _card_bench(tmp_path: Path) -> Config:
    """A bench in front of a card, large enough to be focused by."""
    truth = tmp_path / "truth.toml"
    truth.write_text("[mask]\ncontrast = 450.0\n[camera]\nblur_quads = 1.0\n")
    return Config(
        projector=PanelConfig(size_px=(128, 96)),
        mask=PanelConfig(size_px=(160, 120)),
        camera=CameraConfig(profile="450d", frame_quads=(288, 216), seed=5),
        scene=SceneConfig(kind="card", grid=(12, 16)),
        bench=BenchConfig(truth=str(truth)),
        server=ServerConfig(state_dir=str(tmp_path / "state")),
    )


@pytest.mark.long
def test_focus_is_shown_photo_by_photo(chromium: Any, tmp_path: Path) -> None:
    config = _card_bench(tmp_path)
    with bench(tmp_path, config) as here, page(chromium, here) as opened:
        opened.locator("#focus:enabled").click()
        card = opened.locator("#attention-text", has_text="white card")
        card.wait_for()
        opened.click("#proceed")
        opened.locator(
            "#focus-now", has_text=re.compile(r"^now 0\.[0-9]{3}, best so far")
        ).wait_for()
        opened.check("#by-itself")
        opened.click("#proceed")
        opened.locator("#focus-now", has_text="focus: good").wait_for()
        assert opened.locator("#focus-found li").count() == 2
        assert opened.locator("#focus-chart circle").count() >= 4
        opened.locator("#job-stage.done").wait_for()


@pytest.mark.parametrize("width", [1280, 390])
def test_a_live_view_is_seen_and_gives_way(chromium: Any, tmp_path: Path, width: int) -> None:
    camera = CameraConfig(noise="none", f_number=8.0, quads_per_cell=4, place=Placing(scale=2.0))
    panels = {name: PanelConfig(size_px=(64, 48)) for name in ("projector", "mask")}
    config = bench_rig.config(tmp_path, grid=(6, 8), camera=camera, **panels)
    with bench(tmp_path, config) as here, page(chromium, here, ".live") as opened:
        opened.set_viewport_size({"width": width, "height": 900})
        # By its address it begins by itself.
        opened.locator("#live-figures dd", has_text="pictures a second").wait_for()
        assert opened.locator("#live").inner_text() == "Stop"
        image = opened.locator("#live-picture")
        # The page lets nobody evaluate text in it, so that it is asked from here.
        while opened.evaluate("document.querySelector('#live-picture').naturalWidth") != 32:
            opened.wait_for_timeout(50)
        # The camera sees twice the field, whose edge is drawn there.
        edge = opened.locator("#live-edge").get_attribute("points").split()
        places = [[float(at) for at in point.split(",")] for point in edge]
        assert all(min(p) == pytest.approx(0.25) for p in zip(*places, strict=True))
        assert all(max(p) == pytest.approx(0.75) for p in zip(*places, strict=True))
        drawn, seen = (opened.locator(f"#live-frame {of}").bounding_box() for of in ("svg", "img"))
        assert drawn == seen and seen["width"] > 300
        assert opened.evaluate("document.documentElement.scrollWidth") == width
        before = image.get_attribute("src")
        while image.get_attribute("src") == before:
            opened.wait_for_timeout(50)
        opened.locator("#live").click()
        opened.locator("#state.idle").wait_for()
        assert opened.locator("#live-trouble").is_hidden()
        opened.select_option("#live-pattern", "checker")
        opened.locator("#live:enabled").click()
        opened.locator("#job-name", has_text="live checker").wait_for()
        opened.locator("#plan:enabled").click()
        opened.locator("#live-trouble", has_text="gave way").wait_for()
        opened.locator("#plan-answer dt").first.wait_for()
        # A page that is closed ends it.
        opened.locator("#live:enabled").click()
        opened.locator("#state.busy").wait_for()
    (tmp_path / "again").mkdir()
    with bench(tmp_path / "again", config) as here, page(chromium, here) as opened:
        opened.goto(here.address.partition("#")[0] + "nowhere")
        assert "printed" in opened.locator("section").inner_text()


def test_a_report_runs_as_a_page_of_no_origin(chromium: Any, tmp_path: Path) -> None:
    job = "20260101T120301Z-7f3a"
    run = tmp_path / "state" / "captures" / job
    run.mkdir(parents=True)
    (run / "report.html").write_text(
        "<!doctype html><p id=a>no</p><script>a.textContent = 'ran'; let c = 'none';"
        "try { c = sessionStorage.token } catch (e) { c = e.name };"
        "a.textContent += ' ' + origin + ' ' + c;"
        "a.textContent += ' ' + document.referrer + (opener || '') + location.pathname;"
        "fetch('/runs').then(() => a.textContent += ' reached', () => a.textContent += ' alone')"
        "</script>"
    )
    with bench(tmp_path, bench_rig.config(tmp_path)) as here, page(chromium, here) as opened:
        link = opened.locator("#runs .report")
        link.wait_for()
        with opened.context.expect_page() as told:
            link.click()
        text = told.value.locator("#a", has_text="alone")
        text.wait_for(timeout=READY_MS)
        said = text.inner_text()
        assert re.fullmatch(rf"ran null SecurityError /report/{job}/[0-9a-f]{{64}} alone", said), (
            said
        )
        assert here.address.partition("#")[2] not in told.value.content()
