"""Messages come whole, in whatever pieces they travel; errors keep what they say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdcd.capture.worker.keeper import _for_child
from pdcd.capture.worker.pipe import Call, Done, Failed, Inbox, Sign, Stop, packed
from pdcd.capture.worker.work import FIRST, WORK, broken, out_of_memory
from pdcd.capture.worker.worker import Worker
from pdcd.errors import DecodeError, DeviceLost, PlanError

MESSAGES = [
    Call("plan", (1, "two"), {}),
    Stop(),
    Sign(1.0, 2.0, "codes"),
    Done(None),
    Done("x" * 5000),
]


@pytest.mark.parametrize("size", [1, 7, 100, 1 << 20])
def test_messages_are_put_together_from_pieces_of_any_size(size: int) -> None:
    stream = b"".join(map(packed, MESSAGES))
    inbox, found = Inbox(), []
    for start in range(0, len(stream), size):
        found += list(inbox.take(stream[start : start + size]))
    assert found == MESSAGES


def test_what_is_left_after_an_answer_is_kept_for_the_next_look() -> None:
    inbox = Inbox()
    assert next(inbox.take(packed(Done(1)) + packed(Done(2)))) == Done(1)
    assert list(inbox.take(b"")) == [Done(2)]


def test_arrays_and_errors_come_out_as_they_went_in() -> None:
    array = np.arange(12.0).reshape(3, 4)
    error = DeviceLost("gone", device="camera", hint="look for it")
    back, failed = Inbox().take(packed(Done(array)) + packed(Failed(error, spent=True)))
    assert np.array_equal(back.value, array)
    assert type(failed.error) is DeviceLost and failed.spent
    assert (failed.error.message, failed.error.device, failed.error.hint) == (
        "gone", "camera", "look for it",
    )  # fmt: skip


def test_the_table_names_its_tasks_and_says_what_broke() -> None:
    assert all(getattr(Worker, name) is task for name, task in WORK.items())
    for name in FIRST:
        assert isinstance(out_of_memory(name), PlanError)
    for name in WORK.keys() - FIRST:
        error = broken(name, "ended with status 1", "look")
        assert isinstance(error, DecodeError)
        assert error.message == "the decoding process ended with status 1"
        assert error.hint == "the RAW files are kept; look"


def test_only_paths_by_a_descriptor_are_told_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.getpid", lambda: 77)
    assert _for_child(Path("/proc/self/fd/5/job")) == Path("/proc/77/fd/5/job")
    for other in (Path("/proc/self/fdinfo/5"), Path("/runs/job"), "/proc/self/fd/5"):
        assert _for_child(other) == other
