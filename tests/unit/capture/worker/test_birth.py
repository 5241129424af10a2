"""How a work process is started, and what it may do: played without one."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.capture.worker import limits
from pdcd.capture.worker.birth import COMMAND, Newborn, born
from pdcd.errors import PdcdError


def test_it_is_started_on_one_end_of_a_talk_that_never_blocks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: dict[str, Any] = {}

    def started(words: list[str], **how: Any) -> str:
        seen.update(how, words=words)
        seen["other"] = os.dup(how["pass_fds"][0])
        return "process"

    monkeypatch.setattr("pdcd.capture.worker.birth.subprocess.Popen", started)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    newborn = born(("program", "word"))
    other = socket.socket(fileno=seen["other"])
    with newborn.talk, other:
        assert str(newborn.process) == "process" and not newborn.talk.getblocking()
        assert seen["words"] == ["program", "word", str(seen["pass_fds"][0])]
        assert seen["stdin"] == seen["stdout"] == subprocess.DEVNULL
        assert seen["start_new_session"] is True and len(seen["pass_fds"]) == 1
        assert seen["env"] == {**os.environ, "OMP_NUM_THREADS": "1"}
        other.sendall(b"x")
        assert newborn.talk.recv(9) == b"x"
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(seen["pass_fds"][0])
    assert COMMAND == (sys.executable, "-P", "-m", "pdcd.capture.worker")


def test_threads_are_as_many_as_the_operator_says(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.setattr(
        "pdcd.capture.worker.birth.subprocess.Popen",
        lambda _, env, **__: seen.append(env["OMP_NUM_THREADS"]),
    )
    born(("program",)).talk.close()
    assert seen == ["3"]


def test_a_process_that_cannot_be_started_is_an_error_of_ours(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise error

    before = len(list(Path("/proc/self/fd").iterdir()))
    monkeypatch.setattr("pdcd.capture.worker.birth.subprocess.Popen", refused)
    error: Exception = BlockingIOError(11, "Resource temporarily unavailable")
    with pytest.raises(PdcdError, match="plans and decodes: Resource temporarily"):
        born(("program",))
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_a_newborn_that_is_not_wanted_is_killed_waited_for_and_left() -> None:
    steps: list[str] = []
    names = ("kill", "wait")
    process: Any = SimpleNamespace(**{name: lambda n=name: steps.append(n) for name in names})
    talk: Any = SimpleNamespace(close=lambda: steps.append("close"))
    Newborn(process, talk).end()
    assert steps == ["kill", "wait", "close"]


@pytest.mark.parametrize(
    ("limit", "hard", "most"), [(100, -1, 100), (100, 50, 50), (40, 50, 40), (50, 50, 50)]
)
def test_memory_is_bounded_for_good(
    limit: int, hard: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[object] = []
    monkeypatch.setattr(limits, "resource", SimpleNamespace(
        RLIMIT_DATA=2, RLIM_INFINITY=-1, getrlimit=lambda which: (7, hard),
        setrlimit=lambda which, pair: seen.append((which, pair)),
    ))  # fmt: skip
    limits.bound_memory(limit)
    assert seen == [(2, (most, most))]


@pytest.mark.parametrize("refused", [False, True])
def test_a_work_process_ends_with_its_parent_and_goes_first(
    refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[object] = []

    def written(path: Path, text: str) -> None:
        seen.append((str(path), text))
        if refused:
            raise PermissionError(13, "Permission denied")

    library = SimpleNamespace(prctl=lambda *words: seen.append(words))
    monkeypatch.setattr(
        "pdcd.capture.worker.limits.signal.signal", lambda number, how: seen.append((number, how))
    )
    monkeypatch.setattr("pdcd.capture.worker.limits.ctypes.CDLL", lambda name: library)
    monkeypatch.setattr(Path, "write_text", written)
    limits.confine()
    ignored = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    assert seen == [
        *((number, signal.SIG_IGN) for number in ignored),
        (1, signal.SIGKILL, 0, 0, 0),
        ("/proc/self/oom_score_adj", "500"),
    ]
