"""What one run tells in a list: where its figures come from, and how much of its texts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pdcd.errors import RequestError
from pdcd.protocol.entry import RunEntry
from pdcd.runs.index import pick_run, read_run_at
from tests.run_folders import HEAD, cut, finished, job


def told(folder: Path, **changes: Any) -> RunEntry:
    return read_run_at(finished(folder, job(1), **changes))


def test_texts_are_told_up_to_so_many_letters(tmp_path: Path) -> None:
    whole, cut_off = "x" * 80, "x" * 77 + "..."
    for number, (given, shown) in enumerate(((whole, whole), (whole + "y", cut_off))):
        request = {"name": given, "tags": [given], "goal": given}
        found = told(tmp_path / str(number), request=request, finished_utc=given)
        assert (found.name, found.tags, found.goal) == (shown, (shown,), shown)
        assert found.finished_utc == shown
    found = told(tmp_path / "note", request={"note": "x" * 4096}, state="partial",
                 summary={"taken": "x" * 600})  # fmt: skip
    assert (found.note, found.taken) == ("x" * 4096, "x" * 600)
    found = told(tmp_path / "more", request={"note": "x" * 4097}, state="partial",
                 summary={"taken": "x" * 601})  # fmt: skip
    assert (found.note, found.taken) == ("x" * 4093 + "...", "x" * 597 + "...")
    assert found.reason == ("made of " + "x" * 600)[:597] + "..."


def test_no_more_tags_are_told_than_a_run_may_have(tmp_path: Path) -> None:
    found = told(tmp_path, request={"tags": [str(number) for number in range(20)]})
    assert found.tags == tuple(str(number) for number in range(16))


@pytest.mark.parametrize(
    ("summary", "plan", "asked", "codes"),
    [(7, 8, 9, 7), (0, 8, 9, 0), (None, 8, 9, 8), (None, None, 9, 9), (None, None, None, None)],
)
def test_codes_are_those_taken_else_those_planned_else_those_asked_for(
    tmp_path: Path, summary: int | None, plan: int | None, asked: int | None, codes: int | None
) -> None:
    found = told(
        tmp_path, summary={"codes": summary}, plan={"codes": plan}, request={"codes": asked}
    )
    assert found.codes == codes


def test_what_nobody_can_tell_is_left_out(tmp_path: Path) -> None:
    place = finished(tmp_path, job(1), state="partial")
    bare = {
        "job": job(1), "schema": 1, "state": "partial", "request": {"goal": "direct"}, "owner": {},
        "started_utc": "2026",
    }  # fmt: skip
    (place / "capture.json").write_text(json.dumps(bare))
    found = read_run_at(place)
    assert (found.verdict, found.user, found.mock, found.codes, found.method) == (None,) * 5
    assert found.reason == "made of some of its shots" and found.taken is None


def test_of_a_run_that_was_cut_the_beginning_of_its_ledger_tells(tmp_path: Path) -> None:
    place = cut(tmp_path, job(1), {"event": "failed", "kind": "none", "message": ""}, codes=5)
    found = read_run_at(place)
    assert (found.state, found.codes, found.reason) == ("failed", 8, "it does not say why")
    assert (found.started_utc, found.mock) == (HEAD["started_utc"], True)
    (place / "ledger.jsonl").unlink()
    bare = read_run_at(place)
    assert (bare.state, bare.goal, bare.codes) == ("failed", None, None)


def entry(state: Any, name: str = "a") -> RunEntry:
    return RunEntry(job=name, state=state, folder=f"/{name}{state}")


def test_of_one_job_the_run_that_came_furthest_is_meant() -> None:
    states = ("failed", "partial", "done", "unfinished")
    for last in range(1, 5):
        found = [entry(state) for state in states[:last]]
        wanted = ("failed", "partial", "done", "done")[last - 1]
        assert pick_run(found, "a").state == pick_run(found[::-1], "a").state == wanted


def test_the_newest_three_of_many_runs_of_one_name_are_named() -> None:
    for count, hint in ((2, "b, a"), (3, "c, b, a"), (4, "d, c, b ...")):
        with pytest.raises(RequestError) as raised:
            pick_run([entry("done", name) for name in "abcd"[:count]], "vase")
        assert raised.value.message == f"{count} runs are called 'vase'"
        assert raised.value.hint == f"name one by its job: {hint}"
    with pytest.raises(RequestError, match="no run is called"):
        pick_run([], "vase")


def test_a_run_of_another_schema_is_told_as_that(tmp_path: Path) -> None:
    found = told(tmp_path, schema=3)
    assert (found.state, found.verdict) == ("damaged", None)
    assert "has schema 3;" in str(found.reason) and "reads schema 1" in str(found.reason)
