"""`capture.list` finds runs on disk, page after page."""

from __future__ import annotations

import asyncio
import threading
import time
from pathlib import Path

import pytest

from pdcd.client import Client
from pdcd.protocol.entry import Page, RunEntry, RunQuery
from pdcd.protocol.messages import MAX_LINE
from pdcd.server import connections, methods
from tests.e2e.server._server_harness import Daemon, Wire, served, threaded_daemon
from tests.run_folders import cut, find_runs, finished, job


@served
async def test_runs_are_found_by_what_is_said_of_them(wire: Wire, tmp_path: Path) -> None:
    captures = tmp_path / "state" / "captures"
    finished(captures, job(1), request={"name": "vase", "tags": ["glass"], "note": "n"})
    finished(captures, job(2), "-partial", state="partial")
    cut(captures, job(3), {"event": "failed", "kind": "sync", "message": "late"})

    assert (await wire.result("capture.list"))["found"] is None
    found = (await wire.result("capture.list", find={}))["found"]
    assert [(run["job"], run["state"], run["reason"]) for run in found["runs"]] == [
        (job(3), "failed", "late"),
        (job(2), "partial", "made of some of its shots"),
        (job(1), "done", None),
    ]
    assert found["state_folder"] == str(tmp_path / "state") and found["more"] is None
    wanted = {"tags": ["glass"], "goal": "indirect", "since": "2026-01-01T01:00:00+01:00"}
    (run,) = (await wire.result("capture.list", find=wanted))["found"]["runs"]
    assert (run["name"], run["note"], run["verdict"]) == ("vase", "n", "good")
    for wrong in ({"newest": 0}, {"gaol": "white"}, {"since": "2026-01-01"},
                  {"tags": ["a b"]}, {"before": "../../etc"}):  # fmt: skip
        answer = await wire.ask("capture.list", find=wrong)
        assert answer["error"]["data"]["kind"] == "request", wrong


def test_a_thousand_runs_with_long_notes_come_in_lines_that_may_be_sent(tmp_path: Path) -> None:
    state = tmp_path / "state"
    for second in range(60):
        for day in range(1, 7):
            finished(state, job(second, day), request={"note": "n" * 4000})
    with threaded_daemon(tmp_path) as running, Client(running.path) as client:
        told, query, pages = [], RunQuery(newest=1000), 0
        while True:
            page = client.find(query)
            told += page.runs
            pages += 1
            if page.more is None:
                break
            query = RunQuery(newest=1000, before=page.more)
    assert told == find_runs(state) and len(told) == 360
    assert pages > 360 * 4000 / MAX_LINE


@served
async def test_a_disk_that_hangs_holds_up_lists_of_runs_alone(
    running: Daemon, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A list of jobs needs no disk; and who leaves takes no turn away from the look that hangs."""
    answers = threading.Event()
    begun: list[int] = []

    def hangs(state: Path, query: RunQuery) -> Page:
        begun.append(query.newest)
        assert answers.wait(20.0)
        return Page(state_folder=str(state), runs=[])

    monkeypatch.setattr(methods, "search_runs", hangs)
    monkeypatch.setattr(connections, "LINGER_S", 0.05)

    async with running.wire() as leaves:
        params = {"find": {"newest": 1}}
        asks = {"jsonrpc": "2.0", "id": 1, "method": "capture.list", "params": params}
        await leaves.send(asks)
        while not begun:
            await asyncio.sleep(0.001)
    while (await wire.result("rig.status"))["connections"] > 1:
        await asyncio.sleep(0.001)
    await asyncio.sleep(0.2)  # until nobody waits for what was asked
    assert (await asyncio.wait_for(wire.result("capture.list"), 5.0))["found"] is None
    async with running.wire() as next_one:
        waits = asyncio.create_task(next_one.result("capture.list", find={"newest": 2}))
        await asyncio.sleep(0.1)
        assert begun == [1]
        answers.set()
        assert (await waits)["found"]["runs"] == []
    assert begun == [1, 2]


def test_a_list_of_runs_may_take_longer_than_what_needs_no_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slow(state: Path, query: RunQuery) -> Page:
        time.sleep(0.5)
        return Page(
            state_folder=str(state), runs=[RunEntry(job="j", state="done", folder=f"{state}/j")]
        )

    monkeypatch.setattr(methods, "search_runs", slow)
    with threaded_daemon(tmp_path) as running, Client(running.path, timeout_s=0.2) as client:
        assert [run.job for run in client.find(RunQuery()).runs] == ["j"]
