"""What a worker can be asked, in which words it fails, and how it is started."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pdcd.capture.worker.calls import start_worker
from pdcd.capture.worker.spawned import _for_child
from pdcd.capture.worker.work import FRESH_JOBS, WORK, make_memory_error, make_work_error
from pdcd.capture.worker.worker import Worker
from pdcd.errors import DecodeError, PdcdError, PlanError
from tests.child_rig import Children, stand_ins


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> Iterator[Children]:
    yield from stand_ins(monkeypatch)


def test_a_worker_is_a_module_of_ours_with_one_thread_for_linear_algebra(
    children: Children, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    child = start_worker()
    assert children.last.command[:-1] == [sys.executable, "-P", "-m", "pdcd.capture.worker"]
    assert children.last.how["env"] == {**os.environ, "OMP_NUM_THREADS": "1"}
    child.kill()
    children.refusal = OSError(12, "Cannot allocate memory")
    with pytest.raises(PdcdError, match="the process that plans and decodes: Cannot allocate"):
        start_worker()


def test_the_table_names_its_tasks_and_says_what_broke() -> None:
    assert all(getattr(Worker, name) is task for name, task in WORK.items())
    for name in FRESH_JOBS:
        assert isinstance(make_memory_error(name), PlanError)
    for name in WORK.keys() - FRESH_JOBS:
        error = make_work_error(name, "ended with status 1", "look")
        assert isinstance(error, DecodeError)
        assert error.message == "the decoding process ended with status 1"
        assert error.hint == "the RAW files are kept; look"


def test_only_paths_by_a_descriptor_are_told_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.getpid", lambda: 77)
    assert _for_child(Path("/proc/self/fd/5/job")) == Path("/proc/77/fd/5/job")
    for other in (Path("/proc/self/fdinfo/5"), Path("/runs/job"), "/proc/self/fd/5"):
        assert _for_child(other) == other
