"""Who takes the photos of a sweep: processes of their own, a cluster, and how they are lost."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from concurrent.futures import Future
from types import ModuleType
from typing import Any

import pytest

from pdcd.api.executors import Processes, answer_calls, connect_cluster
from pdcd.api.sweep import sweep
from pdcd.bench.tables import Config
from pdcd.child import PICKLES, MessageLine
from pdcd.errors import ConfigError, PdcdError
from pdcd.protocol.request import CaptureRequest


def test_calls_are_made_in_other_processes_and_one_that_dies_fails_its_own() -> None:
    with Processes(1) as pool:
        first = pool.submit(os.getpid).result()
        assert first != os.getpid() and pool.submit(os.getpid).result() == first
        lost = pool.submit(signal.raise_signal, signal.SIGKILL)
        after = pool.submit(os.getpid)
        with pytest.raises(PdcdError, match=r"its process was ended by signal 9 \(SIGKILL\)") as no:
            lost.result()
        assert "out of memory" in str(no.value.hint)
        assert after.result() not in (first, os.getpid())
        assert pool.submit(os.getenv, "OMP_NUM_THREADS").result()
        last = pool.submit(os.getpid).result()
    # Nobody is left, and nobody is started any more.
    with pytest.raises(ProcessLookupError):
        os.kill(last, 0)
    with pytest.raises(RuntimeError):
        pool.submit(os.getpid)


def test_what_still_runs_is_ended_with_the_pool() -> None:
    pool = Processes(1)
    running, waiting = pool.submit(signal.pause), pool.submit(os.getpid)
    while not running.running():
        threading.Event().wait(0.001)
    pool.shutdown(wait=False, cancel_futures=True)
    assert isinstance(running.exception(), PdcdError) and waiting.cancelled()


def test_a_process_that_cannot_be_started_fails_its_call(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pdcd.api.executors.COMMAND", ("/none/such",))
    table = sweep(Config(), ["white", "white"], workers=1, progress=False)
    assert [*table["state"]] == ["failed"] * 2
    assert "cannot start a process that takes photos" in str(table[0]["error"])


def test_a_worker_answers_until_the_other_end_is_gone() -> None:
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours, theirs = (MessageLine(end, PICKLES) for end in ends)
    thread = threading.Thread(target=answer_calls, args=(theirs,))
    with ours, theirs:
        thread.start()
        for power in (2, 3):
            ours.send((pow, (5, power)))
        assert [ours.receive() for _ in range(2)] == [25, 125]
        ours.close()
        thread.join(60.0)
        assert not thread.is_alive()


class Cluster:
    """A client of a cluster, and the executor of it; `ends` is how photos end, by their notes."""

    def __init__(self, **ends: Any) -> None:
        self.ends, self.calls = ends, list[Any]()

    def get_executor(self, **how: Any) -> Cluster:
        self.calls.append(how)
        return self

    def submit(self, function: Any, task: Any) -> Future[Any]:
        future: Future[Any] = Future()
        end = self.ends[task.request.note]
        if isinstance(end, Exception):
            future.set_exception(end)
        elif end is None:
            future.cancel()
            future.set_running_or_notify_cancel()
        else:
            future.set_result({"state": "done", "job": end, "folder": None})
        return future

    def shutdown(self, wait: bool = True) -> None:
        self.calls.append(("shutdown", wait))

    def close(self) -> None:
        self.calls.append("close")


def test_a_cluster_that_loses_a_capture_loses_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = {"a": "first", "lost": ValueError("worker died"), "none": None, "b": "last"}
    requests = [CaptureRequest(goal="white", note=note) for note in ends]
    mine = Cluster(**ends)
    table = sweep(Config(), requests, cluster=mine, progress=False)
    assert [*table["state"]] == ["done", "failed", "failed", "done"]
    assert (table[0]["job"], table[3]["job"]) == ("first", "last")
    assert "the cluster lost it: worker died" in str(table[1]["error"])
    # Equal photos differ by their noise; and a client that was given stays open.
    how = {"pure": False, "retries": 0}
    assert mine.calls == [how, ("shutdown", False)]
    named = Cluster(**ends)
    module: Any = ModuleType("distributed")
    module.Client = lambda address, **how: named
    monkeypatch.setitem(sys.modules, "distributed", module)
    assert len(sweep(Config(), requests, cluster="tcp://there:1", progress=False)) == 4
    assert named.calls == [how, ("shutdown", False), "close"]


def test_a_cluster_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    module: Any = ModuleType("distributed")
    monkeypatch.setitem(sys.modules, "distributed", module)
    for error in (OSError("nobody there"), ValueError("no address")):

        def client(address: str, _error: Exception = error, **how: object) -> Any:
            raise _error

        module.Client = client
        with pytest.raises(ConfigError, match=str(error)), connect_cluster("tcp://there:1"):
            pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"install distributed\)"):
        sweep(Config(), ["white"], cluster="tcp://127.0.0.1:1", progress=False)
