"""Workers of a sweep: what they are asked and answer, and how they and a cluster are lost."""

from __future__ import annotations

import socket
import sys
import threading
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from pdcd.api import pool, task, worker
from pdcd.api.pool import in_processes, on_cluster
from pdcd.api.task import Record, Task
from pdcd.bench.tables import Config
from pdcd.capture.worker.birth import Newborn
from pdcd.capture.worker.pipe import Inbox, packed
from pdcd.errors import ConfigError, PdcdError
from pdcd.protocol.request import CaptureRequest


def tasks(*notes: str) -> list[Task]:
    return [Task(Config(), CaptureRequest(goal="white", note=note)) for note in notes]


class Crew:
    """Processes that are threads; each answers until it meets the note "deadly"."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.commands: list[Any] = []
        self.ended: list[str] = []
        patch.setattr(pool, "born", self.born)

    def born(self, command: object) -> Newborn:
        number = len(self.commands)
        self.commands.append(command)
        ours, theirs = socket.socketpair()
        ours.setblocking(False)  # as it comes
        threading.Thread(target=self.work, args=(theirs, number), daemon=True).start()
        process: Any = SimpleNamespace(returncode=-9)
        process.kill = lambda: self.ended.append(f"kill {number}")
        process.wait = lambda: self.ended.append(f"wait {number}")
        return Newborn(process, ours)

    def work(self, theirs: socket.socket, number: int) -> None:
        inbox = Inbox()
        with theirs:
            while data := theirs.recv(1 << 20):
                for asked in inbox.take(data):
                    if asked.request.note == "deadly":
                        return
                    answer = packed({"state": "done", "job": f"{number} {asked.request.note}"})
                    theirs.sendall(answer[:3])  # as it may come
                    theirs.sendall(answer[3:])


def test_one_process_is_used_again_and_one_that_died_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    crew = Crew(monkeypatch)
    rows = dict(in_processes(tasks("a", "b", "deadly", "c"), 1))
    assert [rows[n]["job"] for n in range(4)] == ["0 a", "0 b", "", "1 c"]
    assert (rows[2]["state"], rows[2]["goal"]) == ("failed", "white")
    assert "its process ended with -9" in str(rows[2]["error"])
    assert "out of memory" in str(rows[2]["error"])
    assert crew.commands == [(sys.executable, "-P", "-m", "pdcd.api.worker")] * 2
    # The dead one at once, the other in the end; neither stays.
    assert crew.ended[:2] == ["kill 0", "wait 0"]
    assert crew.ended.count("wait 1") == 1 and crew.ended.index("kill 1") < len(crew.ended) - 1


def test_a_process_that_cannot_be_started_is_a_failed_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def born(command: object) -> Newborn:
        raise PdcdError("no more processes")

    monkeypatch.setattr(pool, "born", born)
    rows = dict(in_processes(tasks("a", "b"), 1))
    assert [rows[n]["state"] for n in range(2)] == ["failed"] * 2
    assert "no more processes" in str(rows[0]["error"])


def test_a_pipe_that_breaks_is_a_process_that_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[bool] = []

    class Broken:
        def setblocking(self, flag: bool) -> None:
            raise BrokenPipeError

        def close(self) -> None:
            closed.append(True)

    process: Any = SimpleNamespace(returncode=7, kill=lambda: None, wait=lambda: None)
    talk: Any = Broken()
    monkeypatch.setattr(pool, "born", lambda command: Newborn(process, talk))
    rows = dict(in_processes(tasks("a"), 1))
    assert "its process ended with 7" in str(rows[0]["error"]) and closed


def test_a_sweep_that_is_ended_early_ends_its_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    crew = Crew(monkeypatch)
    ends = in_processes(tasks(*"abcdef"), 1)
    number, row = next(ends)
    assert (number, row["state"]) == (0, "done")
    ends.close()
    assert "kill 0" in crew.ended and crew.ended[-1].startswith("wait")


def test_a_worker_answers_until_the_other_end_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[str] = []

    def take(asked: Task) -> Record:
        taken.append(asked.request.note)
        return {"state": "done", "job": asked.request.note}

    monkeypatch.setattr(task, "taken", take)
    ours, theirs = socket.socketpair()
    with ours, theirs:
        first, second = (packed(each) for each in tasks("a", "b"))
        ours.sendall(first + second)
        ours.shutdown(socket.SHUT_WR)
        worker.serve(theirs)
        theirs.shutdown(socket.SHUT_WR)
        inbox = Inbox()
        found: list[Any] = []
        while data := ours.recv(1 << 16):
            found += inbox.take(data)
    assert taken == ["a", "b"] and [row["job"] for row in found] == ["a", "b"]


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


def test_the_other_end_of_a_worker_may_hold_a_path() -> None:
    asked = Task(Config(), CaptureRequest(goal="white"), {"kernel": b"x"}, Path("/there"))
    (found,) = Inbox().take(packed(asked))
    assert found == asked
