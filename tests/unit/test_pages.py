"""The pages: links lead somewhere, what the program names is there, and no figure is told twice."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

import pytest

from tests.places import ROOT

PAGES = [
    *(
        ROOT / name
        for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "CODE_OF_CONDUCT.md")
    ),
    *sorted((ROOT / "docs").rglob("*.md")),
    ROOT / "systemd" / "README.md",
]
SOURCES = [
    path
    for room in ("pdcd", "drivers", "config", "systemd", "tests", "examples")
    for path in sorted((ROOT / room).rglob("*"))
    if path.suffix in (".py", ".toml", ".md", ".rules", ".service")
]
FIGURE = re.compile(r"(?<![\d.,:-])(\d+\.\d+)(?: to [\d.]+)? (%|s|ms|µs|MB|GB|MiB|GiB)(?!\w)")
TOLD_ELSEWHERE = ("benchmarks.md", "figures.md", "README.md", "tour.md")
"""The one place of figures; the paper's own, beside the bounds that a test holds; and two pages
whose figures `tests.docs` compares with what is printed."""
ALLOWED = {
    "0.1 s": "how often a run looks for a cancel, and a promise on black panels",
    "0.3 %": "limits: of a remark of the verdict, and of the judge of strangers' benches",
    "0.5 %": "what leaks at most into the next code: a limit of the planner",
}
"""Figures in several pages that are limits or definitions, and whose."""


def _anchors(page: Path) -> set[str]:
    """Anchors of a page, as GitHub makes them of headings."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    lost = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"\w+:", target):
            continue
        name, _, anchor = target.partition("#")
        there = page.parent / name if name else page
        if not there.exists() or (anchor and anchor not in _anchors(there)):
            lost.append(target)
    assert not lost


def test_pages_that_the_program_names_are_there() -> None:
    lost = set()
    for path in SOURCES:
        for name in re.findall(r"docs/[\w/-]+\.(?:md|svg|png|ipynb)", path.read_text("utf-8")):
            if not (ROOT / name).exists():
                lost.add(f"{path.relative_to(ROOT)}: {name}")
    assert not lost


def test_a_figure_stands_in_one_place() -> None:
    places = defaultdict(set)
    for page in PAGES:
        if page.name in (*TOLD_ELSEWHERE, "CHANGELOG.md") or page.parent.name == "decisions":
            continue  # these two tell of the day on which they were written
        for number, unit in FIGURE.findall(page.read_text(encoding="utf-8")):
            places[f"{number} {unit}"].add(page.name)
    twice = {figure: names for figure, names in places.items() if len(names) > 1}
    assert {figure: names for figure, names in twice.items() if figure not in ALLOWED} == {}
    assert set(ALLOWED) <= set(twice), "what stands in one place needs no leave"


def test_the_paper_cites_what_its_bibliography_has() -> None:
    folder = ROOT / "docs" / "paper"
    cited = set(re.findall(r"@(\w+)", (folder / "paper.md").read_text(encoding="utf-8")))
    held = re.findall(r"^@\w+\{(\w+),", (folder / "paper.bib").read_text(encoding="utf-8"), re.M)
    assert sorted(cited) == sorted(held)
