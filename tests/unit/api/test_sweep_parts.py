"""Sweeps without a photo: who takes what, where it goes, and how the rows are told."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.api import sweep as module
from pdcd.api.bench import Bench
from pdcd.api.local import LocalBench, describe_bench
from pdcd.api.sweep import sweep
from pdcd.api.task import Task, TaskRecord, hash_capture, hold_place
from pdcd.bench.choosing import CALIBRATIONS_FOLDER as CALIBRATIONS
from pdcd.bench.tables import Config, ServerConfig
from pdcd.errors import ConfigError, DeviceLost, DiskError, RequestError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from tests.unit.bench._calibrations import record, written

WHITE = CaptureRequest(goal="white")


class Hands:
    """Who takes photos in the place of processes, a cluster, or this process."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.asked: list[tuple[str, object]] = []
        self.tasks: list[Task] = []
        patch.setattr(module, "Processes", lambda count: ("processes", count))
        patch.setattr(module, "connect_cluster", lambda at: nullcontext(("cluster", at)))
        patch.setattr(module, "_all_on", self._ends)
        patch.setattr(module, "take_capture", self._taken)
        patch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 2})

    def _taken(self, task: Task) -> TaskRecord:
        self.asked.append(("here", 1))
        self.tasks.append(task)
        return {"state": "done", "job": task.request.note, "folder": None}

    def _ends(self, who: Any, tasks: Sequence[Task]) -> Iterator[tuple[Task, TaskRecord]]:
        self.asked.append(who)
        self.tasks += tasks
        for task in reversed(tasks):
            yield task, {"state": "done", "job": task.request.note, "folder": None}


@pytest.fixture
def hands(monkeypatch: pytest.MonkeyPatch) -> Hands:
    return Hands(monkeypatch)


def noted(*notes: str) -> list[Any]:
    return [{"goal": "white", "note": note} for note in notes]


@pytest.mark.parametrize(
    ("how", "asked"),
    [
        ({}, [("processes", 3)]), ({"workers": 1}, [("processes", 1)]),
        ({"workers": 5}, [("processes", 5)]), ({"workers": 0}, [("here", 1)] * 2),
        ({"cluster": "tcp://there:1"}, [("cluster", "tcp://there:1")]),
        ({"cluster": "tcp://there:1", "workers": 0}, [("cluster", "tcp://there:1")]),
    ],
)  # fmt: skip
def test_photos_are_taken_by_whom_it_was_asked_for(
    how: Any, asked: list[Any], hands: Hands
) -> None:
    table = sweep(Config(), noted("a", "b"), progress=False, **how)
    assert hands.asked == asked
    # In the order of the requests, whoever was first.
    assert [*table["job"]] == ["a", "b"] and [*table["number"]] == [0.0, 1.0]
    assert [*table["asked.note"]] == ["a", "b"]
    assert all(task.folder is None for task in hands.tasks)


def test_real_devices_take_one_photo_after_the_other(hands: Hands) -> None:
    real = msgspec.structs.replace(Config().camera, driver="gphoto2")
    config = msgspec.structs.replace(Config(), camera=real)
    for workers in (None, 0):
        sweep(config, ["white", "white"], workers=workers, progress=False)
    assert hands.asked == [("here", 1)] * 4
    one_of_two: list[Any] = [
        "white",
        {"goal": "white", "config": {"camera": {"driver": "gphoto2"}}},
    ]
    sweep(Config(), one_of_two, progress=False)
    assert hands.asked == [("here", 1)] * 6
    with pytest.raises(RequestError, match="real devices") as caught:
        sweep(config, ["white"], workers=1)
    assert caught.value.hint == "leave out workers"


def test_a_folder_gets_one_of_its_own_for_each_and_knows_what_is_done(
    hands: Hands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    requests = [*noted("a", "b", "a"), WHITE]
    first = sweep(Config(), requests, workers=1, folder="s", progress=False)
    folders = [task.folder for task in hands.tasks]
    assert len({*folders}) == 4
    for folder in folders:
        assert folder is not None and folder.parent == tmp_path / "s" / "runs"
        assert len(folder.name) == 16 and set(folder.name) <= set("0123456789abcdef")
    # Equal ones are counted from 0, so that a later sweep finds each of them.
    for number, again in ((0, 0), (1, 0), (2, 1), (3, 0)):
        key = hash_capture(describe_bench(Config()), hands.tasks[number].request, {}, again)
        assert folders[number] == tmp_path / "s" / "runs" / key[:16]
    assert len(first) == 4
    hands.tasks.clear()
    # Nothing lies there, so all are taken again, under the same names.
    later = sweep(Config(), requests, workers=1, folder=tmp_path / "s", progress=False)
    assert [task.folder for task in hands.tasks] == folders
    assert list(first) == list(later)
    with hold_place(tmp_path / "s"):  # it is let go of
        pass


def test_a_bench_that_was_calibrated_anew_is_another_one(tmp_path: Path) -> None:
    """The next photo is by the new calibration: what was taken before it is not done for it."""
    config = Config(server=ServerConfig(state_dir=str(tmp_path)))
    before = describe_bench(config)
    assert describe_bench(config) == before
    written(tmp_path / CALIBRATIONS / "one", record(name="one"))
    first = describe_bench(config)
    written(tmp_path / CALIBRATIONS / "two", record(name="two"))
    assert (
        len({hash_capture(told, WHITE, {}, 0) for told in (before, first, describe_bench(config))})
        == 3
    )


class Own(Bench):
    """A bench that is none of this process."""

    grid = (2, 3)

    def __init__(self) -> None:
        self.taken: list[CaptureRequest] = []
        self.arrays: list[Any] = []

    def described(self) -> dict[str, Any]:
        return {"bench": "own"}

    def close(self) -> None:
        """Nothing is open."""

    def foresee(self, request: CaptureRequest, arrays: Any = None) -> Any:
        raise AssertionError

    def take(self, request: CaptureRequest, arrays: Any = None, **_: Any) -> CaptureResult:
        self.taken.append(request)
        self.arrays.append(arrays)
        if request.note == "lost":
            raise DeviceLost("gone", device="camera")
        if request.note == "fault":
            raise ZeroDivisionError
        return CaptureResult(job=request.note, state="done", folder=f"/x/{len(self.taken)}")


class Here(Own, LocalBench):
    """One that is of this process."""


def test_a_bench_takes_one_after_the_other_and_a_fault_of_ours_ends_it(tmp_path: Path) -> None:
    bench = Own()
    table = sweep(bench, noted("a", "lost", "b"), folder=tmp_path / "s", progress=False)
    # Its own places are linked to where the sweep looks for them.
    links = [str(link.readlink()) for link in sorted((tmp_path / "s").glob("runs/*/*"))]
    assert sorted(links) == ["/x/1", "/x/3"]
    assert [*table["job"]] == ["a", "", "b"] and [*table["state"]] == ["done", "failed", "done"]
    assert [request.out for request in bench.taken] == [None] * 3  # it has places of its own
    with pytest.raises(ZeroDivisionError):
        sweep(bench, noted("a", "fault", "b"), folder=tmp_path / "t", progress=False)
    assert len(bench.taken) == 5
    with hold_place(tmp_path / "t"):
        pass


def test_a_bench_of_this_process_puts_runs_where_the_sweep_is(tmp_path: Path) -> None:
    bench = Here()
    elsewhere = CaptureRequest(goal="white", out="/elsewhere")
    sweep(bench, ["white", elsewhere], folder=tmp_path, progress=False)
    sweep(bench, ["white"], progress=False)
    outs = [request.out for request in bench.taken]
    assert str(outs[0]).startswith(f"{tmp_path}/runs/") and outs[1:] == ["/elsewhere", None]


def test_a_folder_that_cannot_be_had_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(DiskError, match="file"):
        sweep(Own(), ["white"], folder=tmp_path / "file")
    with pytest.raises(ConfigError):
        sweep("none.toml", ["white"])


def test_a_prior_is_over_the_cells_of_the_bench_that_takes_the_photo(
    hands: Hands, monkeypatch: pytest.MonkeyPatch
) -> None:
    def grid_of(content: Any) -> list[int]:
        with np.load(io.BytesIO(content)) as stored:
            assert np.array_equal(stored["transport"], np.eye(6))
            return [int(side) for side in stored["grid"]]

    asked: list[Config] = []

    def bench_of(config: Config) -> Any:
        asked.append(config)
        return SimpleNamespace(grid=(3, 2))

    prior: list[Any] = [{"goal": "indirect", "prior": np.eye(6)}]
    bench = Own()
    sweep(bench, prior, progress=False)
    assert grid_of(bench.arrays[0]["prior"]) == [2, 3]
    monkeypatch.setattr(module, "LocalBench", bench_of)
    sweep(Config(), prior, workers=1, progress=False)
    assert grid_of(hands.tasks[0].arrays["prior"]) == [3, 2] and asked == [Config()]


def test_where_all_is_done_the_bar_has_a_length_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[Any] = []

    @contextmanager
    def drawn(first: str) -> Iterator[Any]:
        told.append(first)
        yield lambda *said: told.append(said)

    monkeypatch.setattr(module, "draw_progress", drawn)
    assert len(sweep(Own(), [])) == 0
    assert told == ["0 of 0 captures", ("0 of 0 captures", (0.0, 1.0), True)]
    sweep(Own(), noted("lost", "lost"))
    assert told[3:] == [
        ("0 of 2 captures", (0.0, 2.0), True),
        ("1 of 2 captures, 1 failed", (1.0, 2.0), False),
        ("2 of 2 captures, 2 failed", (2.0, 2.0), False),
    ]


def test_nobody_takes_photos_with_less_than_no_process(hands: Hands) -> None:
    with pytest.raises(RequestError, match="-1 workers") as caught:
        sweep(Config(), ["white"], workers=-1)
    assert "1 or more" in str(caught.value.hint) and not hands.asked
