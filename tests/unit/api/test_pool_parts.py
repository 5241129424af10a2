"""Workers of a sweep: what they are asked and answer, and how they and a cluster are lost."""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from pdcd.api import pool, task, worker
from pdcd.api.pool import in_processes, on_cluster
from pdcd.api.task import Record, Task
from pdcd.bench.tables import Config
from pdcd.child import PICKLES, Line, LineClosedError
from pdcd.errors import ConfigError
from pdcd.protocol.request import CaptureRequest
from tests.child_rig import Children, Process, stand_ins


def tasks(*notes: str) -> list[Task]:
    return [Task(Config(), CaptureRequest(goal="white", note=note)) for note in notes]


class Crew:
    """Processes that are threads; each answers until it meets the note "deadly"."""

    def __init__(self, children: Children) -> None:
        self.children = children
        children.on_start = self.start

    def start(self, process: Process) -> None:
        process.status = -9
        line = process.line(PICKLES)
        threading.Thread(target=self.work, args=(process, line), daemon=True).start()

    def work(self, process: Process, line: Line[Any]) -> None:
        with suppress(LineClosedError):
            while True:
                asked = line.receive()
                if asked.request.note == "deadly":
                    process.die(-9)
                    return
                line.send({"state": "done", "job": f"{process.pid} {asked.request.note}"})


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> Iterator[Children]:
    yield from stand_ins(monkeypatch)


@pytest.fixture
def crew(children: Children) -> Crew:
    return Crew(children)


def test_one_process_is_used_again_and_one_that_died_is_not(crew: Crew) -> None:
    rows = dict(in_processes(tasks("a", "b", "deadly", "c"), 1))
    assert [rows[n]["job"] for n in range(4)] == ["100 a", "100 b", "", "101 c"]
    assert (rows[2]["state"], rows[2]["goal"]) == ("failed", "white")
    assert "its process was ended by signal 9 (SIGKILL)" in str(rows[2]["error"])
    assert "out of memory" in str(rows[2]["error"])
    first, second = crew.children.started
    for process in (first, second):
        assert process.command[:-1] == [sys.executable, "-P", "-m", "pdcd.api.worker"]
        assert process.how["env"]["OMP_NUM_THREADS"]
    # Neither stays.
    assert first.done[-1] == second.done[-1] == ("wait", 5.0) and "kill" in second.done


def test_no_more_processes_than_workers_and_each_photo_once(crew: Crew) -> None:
    rows = dict(in_processes(tasks(*"abcde"), 2))
    assert sorted(rows) == [0, 1, 2, 3, 4] and 1 <= len(crew.children.started) <= 2
    assert sorted(str(row["job"])[-1] for row in rows.values()) == [*"abcde"]


def test_nobody_is_started_for_a_sweep_that_has_ended(crew: Crew) -> None:
    ended = pool._Crew()
    ended.dismiss()
    assert "the sweep has ended" in str(ended.take(tasks("a")[0])["error"])
    assert crew.children.started == []


def test_a_process_that_cannot_be_started_is_a_failed_row(crew: Crew) -> None:
    crew.children.refusal = OSError(11, "no more processes")
    rows = dict(in_processes(tasks("a", "b"), 1))
    assert [rows[n]["state"] for n in range(2)] == ["failed"] * 2
    assert "a process that takes photos: no more processes" in str(rows[0]["error"])


def test_a_process_that_ended_before_it_was_asked_is_gone(children: Children) -> None:
    children.on_start = lambda process: process.die(7)
    rows = dict(in_processes(tasks("a"), 1))
    assert "its process ended with status 7" in str(rows[0]["error"])


def test_a_sweep_that_is_ended_early_ends_its_processes(crew: Crew) -> None:
    ends = in_processes(tasks(*"abcdef"), 1)
    number, row = next(ends)
    assert (number, row["state"]) == (0, "done")
    ends.close()
    assert "kill" in crew.children.last.done and crew.children.last.done[-1] == ("wait", 5.0)


def test_a_worker_answers_until_the_other_end_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    def take(asked: Task) -> Record:
        return {"state": "done", "job": asked.request.note}

    monkeypatch.setattr(task, "taken", take)
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours, theirs = (Line(end, PICKLES) for end in ends)
    asked = Task(Config(), CaptureRequest(goal="white"), {"kernel": b"x"}, Path("/there"))
    thread = threading.Thread(target=worker.serve, args=(theirs,))
    with ours, theirs:
        thread.start()
        for each in (*tasks("a", "b"), asked):
            ours.send(each)
        assert [ours.receive()["job"] for _ in range(3)] == ["a", "b", ""]
        ours.close()
        thread.join(60.0)
        assert not thread.is_alive()


class Cluster:
    """One that answers when it is told to; `calls` is what else it was asked."""

    def __init__(self) -> None:
        self.futures: list[Future] = []
        self.calls: list[Any] = []

    def submit(self, function: Any, task: Task, **how: object) -> Any:
        future = Future(task.request.note)
        self.futures.append(future)
        return future

    def cancel(self, futures: list[Any]) -> None:
        self.calls.append(("cancel", len(futures)))

    def close(self) -> None:
        self.calls.append("close")


class Future:
    """One photo on a cluster; `told` are those who wait for it."""

    def __init__(self, note: str) -> None:
        self.note = note
        self.told: list[Any] = []

    def add_done_callback(self, call: Any) -> None:
        self.told.append(call)

    def exception(self) -> None:
        """Nothing went wrong."""

    def result(self) -> Record:
        return {"state": "done", "job": self.note}


def test_a_cluster_tells_in_its_own_order_and_is_let_go_of_early() -> None:
    cluster = Cluster()
    ends = on_cluster(tasks("a", "b", "c"), cluster)
    found: list[Any] = []
    thread = threading.Thread(target=lambda: found.append(next(ends)))
    thread.start()
    while len(cluster.futures) < 3 or not cluster.futures[2].told:
        threading.Event().wait(0.001)
    cluster.futures[2].told[0](cluster.futures[2])
    thread.join(60.0)
    assert found == [(2, {"state": "done", "job": "c"})]
    ends.close()
    assert cluster.calls == [("cancel", 3)]


@pytest.mark.parametrize("error", [OSError("nobody there"), ValueError("no address")])
def test_a_cluster_that_does_not_answer_is_named(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def client(address: str, **how: object) -> Any:
        asked.append((address, how))
        raise error

    module: Any = ModuleType("distributed")
    module.Client = client
    monkeypatch.setitem(sys.modules, "distributed", module)
    with pytest.raises(ConfigError, match=f"no cluster answers at tcp://there:1: {error}"):
        next(on_cluster(tasks("a"), "tcp://there:1"))
    assert asked == [("tcp://there:1", {"set_as_default": False, "timeout": 10.0})]

    def faulty(address: str, **how: object) -> Any:
        raise ZeroDivisionError

    module.Client = faulty
    with pytest.raises(ZeroDivisionError):
        next(on_cluster(tasks("a"), "tcp://there:1"))
