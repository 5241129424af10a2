"""What a page says in words: figures, tables, the verdict; and what it leaves out, and says so."""

from __future__ import annotations

import json
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.pages.render import encode_page_json
from pdcd.pages.report.facts import MOST_ROWS, ReportTable, list_tables
from pdcd.pages.report.write import render_report_page
from pdcd.protocol.result import Quality
from pdcd.verdict.error_budget import ErrorRow


def manifest(**fields: Any) -> Any:
    """As much of a manifest as is told in words."""
    told: dict[str, Any] = {
        "job": "job", "state": "done", "mock": False, "started_utc": "2026-01-01T12:03:01.2Z",
        "request": {}, "plan": {}, "realised": {}, "summary": {}, "warnings": (), "versions": {},
        "git_commit": None, "exif": {}, "drivers": {}, "config": {}, "files": {}, "missing": (),
        "run": SimpleNamespace(
            goal=SimpleNamespace(name="indirect"), projector=SimpleNamespace(field_px=None),
            grid=(3, 4),
        ),
        "quality": Quality(verdict="good"),
    }  # fmt: skip
    return SimpleNamespace(**(told | fields))


def material(layers: dict[str, Any] | None = None, **fields: Any) -> Any:
    told = {"quads": 1.0, "left_out": (), "data": [{"kind": "picture"}], "size_px": (4, 3),
            "scale": 1.0, "balance": (1.0, 1.0, 1.0), **(layers or {})}  # fmt: skip
    made = {"kind": "measured", "budget": [], "answer": "indirect", "matrices": [], "shots": [],
            "errors": (), "slice_png": b"",
            "layers": SimpleNamespace(**told), **fields}  # fmt: skip
    return SimpleNamespace(**made)


def shown(told: Any = None, made: Any = None) -> str:
    """The page without its head and its data, spaces as a browser shows them."""
    text = render_report_page(told or manifest(), made or material())
    return " ".join(text[text.index("<body>") : text.index('<script type="application')].split())


def table(title: str, told: Any, made: Any = None) -> ReportTable:
    (found,) = [one for one in list_tables(told, made or material()) if one.title == title]
    return found


def test_tables_say_what_was_given_and_not_what_was_left_open() -> None:
    request = {
        "goal": "mix", "mix": [0.25, 0.5], "guards": False, "white": True, "seed": 0, "p": None,
        "note": "", "tags": [], "more": {}, "pair": (),
    }  # fmt: skip
    for title, field in (
        ("What was asked", "request"),
        ("The plan", "plan"),
        ("Configuration", "config"),
    ):
        assert table(title, manifest(**{field: request})).rows == [
            ("goal", "mix"), ("mix", "0.25, 0.5"), ("guards", "no"), ("white", "yes"),
            ("seed", "0"),
        ]  # fmt: skip


def test_tables_below_others_have_dotted_names() -> None:
    rig = {"camera": {"body": {"lens": "50 mm"}, "iso": 200, "none": None}, "empty": ""}
    assert table("The rig", manifest(drivers=rig)).rows == [
        ("camera.body.lens", "50 mm"), ("camera.iso", "200"), ("empty", ""),
    ]  # fmt: skip
    exif = {"coded": {"f": 1.23456789}}
    assert table("What the camera's files say", manifest(exif=exif)).rows == [
        ("coded.f", "1.23457")
    ]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (list(range(64)), ", ".join(map(str, range(64)))),
        (list(range(65)), ", ".join(map(str, range(64))) + ", ..."),
        ([{"a": 1, "b": True}], "a 1, b yes"),
        (["x" * 4096], "x" * 4096),
        ("x" * 4097, "x" * 4096),
        (2**70, str(2**70)),
    ],
)
def test_long_values_are_cut(value: object, words: str) -> None:
    assert table("The rig", manifest(drivers={"it": value})).rows == [("it", words)]


@pytest.mark.parametrize(("more", "said"), [(0, []), (1, ["and 1 more"])])
def test_what_has_no_room_on_a_page_is_counted(more: int, said: list[str]) -> None:
    words = tuple(f"w{n}" for n in range(MOST_ROWS + more))
    rows = shown(manifest(drivers=dict.fromkeys(words, "x")))
    assert rows.count("<td>w") == MOST_ROWS and f"<td>w{MOST_ROWS - 1}</td>" in rows
    told = shown(manifest(warnings=words))
    assert told.count('<li class="warning">') == MOST_ROWS
    for text in (rows, told):
        assert re.findall(r"and \d+ more", text) == said


def test_the_verdict_comes_with_all_that_speaks_for_and_against() -> None:
    quality = Quality(verdict="doubtful", reasons=("too dark",), remarks=("late",))
    summary = {"decided": "by the user", "taken": ""}
    cut = {"state": "partial", "missing": ("a", "b")}
    told = shown(manifest(summary=summary, quality=quality, warnings=("<w>",), **cut))
    assert 'class="verdict doubtful">doubtful</p>' in told
    kinds = re.findall(r'<li class="(\w+)"><b>\w+</b> ([^<]*)</li>', told)
    assert kinds == [
        ("partial", "missing shots: a, b"), ("reason", "too dark"), ("decided", "by the user"),
        ("remark", "late"), ("warning", "&lt;w&gt;"),
    ]  # fmt: skip
    assert 'class="verdict good">good</p> <ul class="reasons"> </ul>' in shown()


def test_the_head_says_whose_photo_it_is() -> None:
    request = {"name": "vase", "tags": ["a", "b"], "note": "one\n<two>\x1b"}
    rig = {"scene": "wax", "name": "bench 1"}
    told = shown(manifest(request=request, drivers=rig, mock=True))
    assert "virtual scene wax, 2026-01-01 12:03:01 UTC, rig bench 1" in told
    said = re.findall(r'<p class="said">(.*?)</p>', told)
    assert said == ["name: vase", "tags: a, b", "note: one<br>&lt;two&gt;\\u001b"]
    plain = shown(manifest(started_utc="yesterday"))
    assert "job: a real scene, yesterday, rig ?" in plain and 'class="said"' not in plain


@pytest.mark.parametrize(
    ("fields", "made", "there", "not_there"),
    [
        ({}, {"quads": 1.0}, "about one Bayer quad", "mean of"),
        ({}, {"quads": 6.25}, "the mean of 6.25 Bayer quads", "about one"),
        ({}, {"balance": (1.0,)}, "about one of the camera", "Bayer"),
        ({}, {"balance": (1.0,), "quads": 6.25}, "mean of 6.25 pixels of the camera", "Colours"),
        ({"mock": True}, {}, "truth of the virtual scene was not kept", "Left out"),
        ({"mock": False}, {}, "values have none", "truth of the virtual"),
        ({"mock": True}, {"data": [{"kind": "truth"}]}, "values have none", "truth of the virtual"),
        ({}, {"left_out": ("a", "<b>")}, "Left out for room: a, &lt;b&gt;.", "truth of the"),
    ],
)
def test_the_note_below_the_pictures_says_what_they_are(
    fields: dict[str, Any], made: dict[str, Any], there: str, not_there: str
) -> None:
    for kind in ("sensor", "measured"):
        text = shown(manifest(**fields), material({"data": [], **made}, kind=kind))
        told = text[text.index("Scene units:") : text.index('<section id="matrix"')]
        assert there in told and not_there not in told
        assert ("The error of the codes is not in it" in told) == (kind == "sensor")


def test_data_ends_no_element_and_has_no_value_that_is_no_number() -> None:
    told = {"a": [np.float64("nan"), (np.inf, 1.5)], "b": {"c": -np.inf, "d": "</script>&"}}
    text = encode_page_json(told)
    assert not re.search("[<>& ]", text)
    assert json.loads(text) == {"a": [None, [None, 1.5]], "b": {"c": None, "d": "</script>&"}}


def test_a_picture_of_entries_is_there_where_they_were_photographed() -> None:
    assert "<img" not in shown()
    assert 'src="data:image/png;base64,cG5n"' in shown(made=material(slice_png=b"png"))


def test_the_error_budget_has_no_number_where_nobody_knows() -> None:
    rows = (
        ErrorRow("scale", None, None, "nobody <knows>"),
        ErrorRow("noise", 0.0123, 0.5, "by a profile"),
    )
    made = material(errors=rows)
    found = table("Error budget", manifest(), made)
    assert [*found.rows] == [
        ("scale", "not known", "not known", "nobody <knows>"),
        ("noise", "1.23 %", "0.5", "by a profile"),
    ]
    assert "nobody &lt;knows&gt;" in shown(made=made)
    assert "Error budget" not in shown()
