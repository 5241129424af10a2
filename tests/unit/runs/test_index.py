"""The list of runs: what each tells of itself, what is found, and what cannot fool or stop it."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import pytest

from pdcd.errors import DiskError, RequestError
from pdcd.protocol.entry import RunEntry, RunQuery
from pdcd.runs import index, look, walk
from pdcd.runs.folder import RunFolder
from pdcd.runs.index import make_name_query, pick_run, read_run_at, search_runs
from pdcd.runs.place import HeldFolder
from tests.run_folders import HEAD, cut, find_runs, finished, job

FAILED = {
    "event": "failed", "kind": "sync", "message": "the panels missed refreshes",
    "device": "display", "hint": "look at the cable", "taken": "1 of 3 shots",
}  # fmt: skip


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    """Every descriptor is closed in the end."""
    before = len(list(Path("/proc/self/fd").iterdir()))
    yield
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def states(found: list[RunEntry]) -> list[tuple[str, str]]:
    return [(run.job, run.state) for run in found]


def test_every_run_says_how_it_came_out(tmp_path: Path) -> None:
    captures = tmp_path / "captures"
    request = {"name": "Chart, first", "tags": ["glass", "wax"], "note": "in\nmilk"}
    finished(captures, job(1), request=request)
    finished(
        captures,
        job(2),
        "-partial",
        state="partial",
        summary={
            "taken": "3 of 5 shots",
            "rms_error_quads": None,
            "quality": {"verdict": "doubtful"},
        },
    )
    cut(captures, job(3), {"event": "armed"}, FAILED, name="lost")
    cut(captures, job(4), {**FAILED, "event": "cancelled"})
    cut(captures, job(5), {"event": "shutter_open"})
    going = cut(captures, job(6))
    (captures / job(7)).mkdir()
    cut(captures, job(8)).rename(captures / f"{job(8)}-partial-decoded-2.partial")
    finished(captures, job(9)).rename(captures / f"{job(9)}.removed")
    held = os.open(going, os.O_RDONLY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX)
        found = find_runs(tmp_path)
    finally:
        os.close(held)
    assert states(found) == [
        (job(9), "unfinished"), (job(8), "unfinished"), (job(7), "unfinished"),
        (job(6), "running"), (job(5), "unfinished"), (job(4), "cancelled"), (job(3), "failed"),
        (job(2), "partial"), (job(1), "done"),
    ]  # fmt: skip
    assert [run.failed for run in found] == [True, True, True, False, True, True, True, True, False]
    done, part, lost = found[-1], found[-2], found[-3]
    assert (done.name, done.tags, done.note) == ("Chart, first", ("glass", "wax"), "in\nmilk")
    assert (done.goal, done.codes, done.exposure_s, done.verdict) == ("indirect", 8, 0.5, "good")
    assert (done.rms_error_quads, done.rms_sigma, done.user, done.mock) == (
        0.0321,
        0.02,
        "ada",
        True,
    )
    assert done.folder == str(captures / job(1)) and done.reason is None
    assert part.verdict == "doubtful" and part.reason == "made of 3 of 5 shots"
    assert (lost.goal, lost.codes, lost.name, lost.user) == ("indirect", 8, "lost", "ada")
    assert lost.reason == "display: the panels missed refreshes (look at the cable)"
    assert lost.taken == "1 of 3 shots"
    reasons = [run.reason or "" for run in found]
    assert "removal" in reasons[0] and "decoding" in reasons[1] and "no manifest" in reasons[2]
    assert "without a word" in reasons[4]


def test_what_is_asked_for_is_found_whatever_the_pages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for second in range(12):
        fields = {"goal": "direct" if second % 2 else "indirect", "tags": ["a", "b"][: second % 3]}
        finished(tmp_path / "series" / str(second % 4), job(second), request=fields)
    finished(tmp_path / "preview", job(50))
    cut(tmp_path / "captures", job(51), FAILED)
    (tmp_path / "calibrations" / job(52)).mkdir(parents=True)
    every = find_runs(tmp_path)
    assert [run.job for run in every] == [job(51), *(job(s) for s in range(11, -1, -1))]
    assert [run.kind for run in find_runs(tmp_path, previews=True)].count("preview") == 1
    assert [r.job for r in find_runs(tmp_path, goal="direct")] == [
        job(s) for s in (11, 9, 7, 5, 3, 1)
    ]
    assert [r.job for r in find_runs(tmp_path, tags=("b", "a"))] == [job(s) for s in (11, 8, 5, 2)]
    assert [r.job for r in find_runs(tmp_path, failed=True)] == [job(51)]
    since = datetime(2026, 1, 1, 0, 0, 10, tzinfo=UTC)
    assert [r.job for r in find_runs(tmp_path, since=since)] == [job(51), job(11), job(10)]
    told, query, pages = [], RunQuery(newest=5), 0
    while True:
        page = search_runs(tmp_path, query)
        told += page.runs
        pages += 1
        if page.more is None:
            break
        query = msgspec.structs.replace(query, before=page.more)
    assert told == every and pages == 3
    monkeypatch.setattr(index, "PAGE_BYTES", 1)  # a page for each run
    assert find_runs(tmp_path, goal="direct") == [run for run in every if run.goal == "direct"]
    assert len(search_runs(tmp_path, RunQuery()).runs) <= 2
    with pytest.raises(RequestError, match="no place"):
        search_runs(tmp_path, RunQuery(before="elsewhere"))


def test_a_run_is_meant_by_its_job_its_name_or_its_folder(tmp_path: Path) -> None:
    place = finished(tmp_path, job(1), request={"name": "vase"})
    cut(tmp_path, job(1))
    finished(tmp_path, job(2), request={"name": "twice"})
    finished(tmp_path, job(3), request={"name": "twice"})

    def meant(text: str) -> RunEntry:
        return pick_run(search_runs(tmp_path, make_name_query(text)).runs, text)

    assert meant("vase") == meant(job(1)) == read_run_at(place) and meant("vase").state == "done"
    for text, why in (("twice", "2 runs"), ("wax", "no run"), ("a/b\x1b", "no name")):
        with pytest.raises(RequestError, match=why):
            meant(text)
    with pytest.raises(RequestError, match="cannot open"):
        read_run_at(tmp_path / job(9))


def test_nothing_is_waited_for_and_no_link_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, elsewhere = tmp_path / "state", tmp_path / "elsewhere"
    for second in range(1, 8):
        (finished(state, job(second)) / "capture.json").unlink()
    os.mkfifo(state / job(1) / "capture.json")
    (state / job(2) / "capture.json").symlink_to("/dev/zero")
    (state / job(3) / "capture.json").mkdir()
    monkeypatch.setattr(look, "MOST_LISTED_BYTES", 3000)
    (state / job(4) / "capture.json").write_text(json.dumps({**HEAD, "pad": "x" * 3000}))
    (state / job(5) / "capture.json").write_text("[" * 2000)
    (state / job(6) / "capture.json").write_text(json.dumps({**HEAD, "job": job(5)}))
    (state / job(7) / "capture.json").write_text(json.dumps({**HEAD, "job": job(7), "owner": 1}))
    (state / job(8)).symlink_to(finished(elsewhere, job(8)))
    (state / "more").symlink_to(elsewhere)
    leftover = state / f"{job(9)}.partial"
    leftover.mkdir()
    os.mkfifo(leftover / "ledger.jsonl")
    os.mkfifo(leftover / "log.jsonl")
    with walk.open_state_folder(state) as (top, owners):
        for led_away in (job(8), f"more/{job(8)}"):  # what a name has come to mean since
            with pytest.raises(OSError), walk.open_run_folder(top, led_away, owners):
                pass
    found = find_runs(state)
    assert states(found) == [
        (job(9), "unfinished"), *((job(second), "damaged") for second in range(7, 0, -1)),
    ]  # fmt: skip
    assert all(run.reason for run in found)


def test_folders_of_others_are_not_looked_into(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finished(tmp_path / "captures", job(1))
    opened = walk.open_state_folder

    @contextlib.contextmanager
    def of_nobody(state: Path) -> Iterator[tuple[int, frozenset[int]]]:
        with opened(state) as (top, _):
            yield top, frozenset({os.geteuid() + 1})

    monkeypatch.setattr(walk, "open_state_folder", of_nobody)
    page = search_runs(tmp_path, RunQuery())
    assert (page.runs, page.closed) == ([], ("captures",))
    (tmp_path / "captures" / job(1)).rename(tmp_path / job(1))
    (found,) = search_runs(tmp_path, RunQuery()).runs
    assert (found.state, found.goal) == ("foreign", None)


def test_a_folder_that_is_not_there_has_no_runs_and_a_file_is_an_error(tmp_path: Path) -> None:
    assert find_runs(tmp_path / "nowhere") == []
    (tmp_path / "file").touch()
    with pytest.raises(DiskError, match="cannot read the folder of runs"):
        find_runs(tmp_path / "file")


def test_the_search_says_when_there_are_more_names_than_it_looks_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(walk, "MOST_ENTRIES", 5)
    for second in range(9):
        finished(tmp_path, job(second))
    page = search_runs(tmp_path, RunQuery())
    assert len(page.runs) == 5 and page.cut


def test_no_run_has_its_name_before_it_is_locked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So whoever lists or removes runs never takes one that begins for one that has ended."""
    rename, looked = os.rename, []

    def look_first(old: str, new: str, *, src_dir_fd: int, dst_dir_fd: int) -> None:
        folder = os.open(old, os.O_RDONLY, dir_fd=src_dir_fd)
        with pytest.raises(BlockingIOError):
            fcntl.flock(folder, fcntl.LOCK_SH | fcntl.LOCK_NB)
        os.close(folder)
        looked.append((old, new, states(find_runs(tmp_path))))
        rename(old, new, src_dir_fd=src_dir_fd, dst_dir_fd=dst_dir_fd)

    monkeypatch.setattr(os, "rename", look_first)
    with HeldFolder.at(tmp_path) as place, RunFolder(place, job(1)) as made:
        made.create(min_free_bytes=0)
        assert looked == [(f".{job(1)}.partial.new", f"{job(1)}.partial", [])]
        assert states(find_runs(tmp_path)) == [(job(1), "running")]
        with RunFolder(place, job(1)) as again, pytest.raises(DiskError, match="exists"):
            again.create(min_free_bytes=0)
    assert states(find_runs(tmp_path)) == [(job(1), "unfinished")]
    assert os.listdir(tmp_path) == [f"{job(1)}.partial"]  # noqa: PTH208


def test_how_a_run_ended_is_told_by_the_last_whole_line_of_its_log(tmp_path: Path) -> None:
    failed = {"event": "failed", "kind": "sync", "message": "late", "taken": "3 of 5"}
    place = cut(tmp_path, job(1), {"event": "armed"}, failed)
    (found,) = find_runs(tmp_path)
    assert (found.state, found.taken) == ("failed", "3 of 5") and "late" in str(found.reason)
    (place / "log.jsonl").write_text(json.dumps(failed) + "\n" + '{"event": "half a li')
    assert find_runs(tmp_path)[0].state == "failed"
    long = {"event": "noted", "text": "x" * 70_000}
    none = "unfinished"
    for log, state in (([failed, long], none), ([long, failed], "failed"), ([], none)):
        (place / "log.jsonl").write_text("".join(json.dumps(line) + "\n" for line in log))
        assert find_runs(tmp_path)[0].state == state
    (place / "log.jsonl").write_text(json.dumps({"event": "cancelled"}) + "\n")
    (found,) = find_runs(tmp_path)
    assert found.state == "cancelled" and found.reason


def test_a_page_of_runs_ends_where_enough_was_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for second in (1, 2, 3):
        place = finished(tmp_path, job(second))
    size = (place / "capture.json").stat().st_size
    for most, count in ((size - 1, 1), (size, 2), (2 * size, 3)):
        monkeypatch.setattr("pdcd.runs.index.PAGE_BYTES", most)
        page = search_runs(tmp_path, RunQuery())
        assert len(page.runs) == count and (page.more is None) == (count == 3)
        assert len(find_runs(tmp_path)) == 3
    told = len(msgspec.json.encode(page.runs[0]))
    monkeypatch.setattr("pdcd.runs.index.ANSWER_BYTES", told)
    page = search_runs(tmp_path, RunQuery())
    assert [run.job for run in page.runs] == [job(3), job(2)] and page.more == job(2)
    rest = search_runs(tmp_path, RunQuery(before=page.more))
    assert [run.job for run in rest.runs] == [job(1)] and rest.more is None


def test_no_more_runs_are_told_than_were_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where one that takes long to read ends a page early, and the next is full."""
    for second in (1, 2, 3, 4):
        place = finished(tmp_path, job(second))
    size = (place / "capture.json").stat().st_size
    (place / "capture.json").write_bytes((place / "capture.json").read_bytes() + b" " * 2 * size)
    monkeypatch.setattr("pdcd.runs.index.PAGE_BYTES", 2 * size)
    for newest in (1, 2, 3, 4):
        found = index.find_runs(tmp_path, newest)
        assert [run.job for run in found] == [job(4), job(3), job(2), job(1)][:newest]


@pytest.mark.parametrize("below", ["captures", ""])
def test_a_run_that_goes_while_names_are_looked_at_hides_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, below: str
) -> None:
    """As every run does when it ends: its folder gets another name."""
    for number in range(4):
        finished(tmp_path / below, job(number))
    scandir = os.scandir

    @contextlib.contextmanager
    def gone(folder: int) -> Iterator[Iterator[os.DirEntry[str]]]:
        with scandir(folder) as entries:
            yield (_gone(entry) for entry in entries)

    def _gone(entry: os.DirEntry[str]) -> os.DirEntry[str]:
        if entry.name == job(2):
            (tmp_path / below / job(2)).rename(tmp_path / f"{job(2)}-away")
        return entry

    monkeypatch.setattr(os, "scandir", gone)
    page = search_runs(tmp_path, RunQuery())
    assert [run.job for run in page.runs] == [job(3), job(1), job(0)] and not page.closed
