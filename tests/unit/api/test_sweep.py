"""Sweeps: every request has its row, what fails harms no other, what is done is not done again."""

from __future__ import annotations

import csv
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pdcd
from pdcd.api.local import LocalBench
from pdcd.api.task import ENDING, TaskRecord, hash_capture
from pdcd.bench.tables import Config
from pdcd.errors import BusyError, DeviceLost, RequestError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from tests.bench_rig import config, matrix_scene, transport

REQUESTS: list[Any] = [
    {"goal": "indirect", "codes": 8, "parts": 1, "pilot": 0, "white": False},
    {"goal": "long-range", "codes": 8},  # which needs a radius
    {"goal": "white", "config": {"scene": {"ambient": 0.1}}},
    CaptureRequest(goal="white"),
    "white",
]


@pytest.fixture
def rig(tmp_path: Path) -> Config:
    return config(tmp_path)


def test_every_request_has_its_row(rig: Config, tmp_path: Path) -> None:
    seen: list[TaskRecord] = []
    table = pdcd.sweep(rig, REQUESTS, workers=0, folder=tmp_path / "s", progress=seen.append)
    assert len(table) == len(seen) == 5 and [row["number"] for row in table] == [0, 1, 2, 3, 4]
    asked = ("codes", "parts", "pilot", "white", "config.scene.ambient")
    assert table.columns == ("number", *(f"asked.{name}" for name in asked), *ENDING)
    assert all(tuple(row) == table.columns for row in table)
    assert [*table["state"]] == ["done", "failed", "done", "done", "done"]
    (bad,) = table.failed
    assert (bad["error_kind"], bad["goal"]) == ("request", "long-range")
    assert "needs radius" in str(bad["error"])
    assert np.array_equal(table["codes"][:2], [8.0, np.nan], equal_nan=True)
    for row in table.where(state="done"):
        run = pdcd.open(str(row["folder"]))
        assert run.goal == row["goal"] and run.summary["rms_error_quads"] == row["rms_error_quads"]
        assert run.folder.is_relative_to(tmp_path / "s" / "runs")
    scenes = [pdcd.open(str(table[n]["folder"])).manifest.config["scene"] for n in (2, 3)]
    assert [scene["ambient"] for scene in scenes] == [0.1, 0.0]
    table.to_csv(tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="") as file:
        lines = [*csv.DictReader(file)]
    assert [line["asked.config.scene.ambient"] for line in lines] == ["", "", "0.1", "", ""]
    assert float(lines[0]["rms_error_quads"]) == table[0]["rms_error_quads"]
    assert "long-range" in table._repr_html_() and "1 failed" in repr(table)
    with pytest.raises(KeyError, match="columns are number"):
        table["speed"]
    with pytest.raises(RequestError, match="no column speed"):
        table.where(speed=1)


def _jobs(table: pdcd.Table) -> list[str]:
    return [str(job) for job in table["job"]]


def test_it_goes_on_where_it_was_ended(rig: Config, tmp_path: Path) -> None:
    requests: list[Any] = ["white", "white", {"goal": "white", "codes": 4}]
    place = tmp_path / "s"

    def stop(row: TaskRecord) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pdcd.sweep(rig, requests, workers=0, folder=place, progress=stop)
    first = pdcd.sweep(rig, requests, workers=0, folder=place, progress=False)
    told: list[TaskRecord] = []
    again = pdcd.sweep(rig, requests, workers=0, folder=place, progress=told.append)
    assert not told and list(again) == list(first) and len(set(_jobs(first))) == 3
    assert len([*(place / "runs").glob("*/*")]) == 3  # the one before the interrupt is kept
    # One that lies elsewhere, as those of a daemon do, is found by a link.
    run = Path(str(first[2]["folder"]))
    moved = run.rename(tmp_path / run.name)
    run.symlink_to(moved)
    linked = pdcd.sweep(rig, requests, workers=0, folder=place, progress=told.append)
    assert not told and linked[2] == first[2] | {"folder": str(moved)}

    # Another scene under the same name, a run that was changed: taken anew, and nothing else.
    changed = Path(str(first[1]["folder"])) / "capture.json"
    changed.write_bytes(changed.read_bytes() + b"\n")
    mended = pdcd.sweep(rig, requests, workers=0, folder=place, progress=told.append)
    same = [a == b for a, b in zip(_jobs(mended), _jobs(first), strict=True)]
    assert same == [True, False, True] and len(told) == 1
    scene = matrix_scene(tmp_path)
    assert scene.path is not None
    np.savez(scene.path, transport=2.0 * transport(), grid=np.array((3, 4)))
    other = pdcd.sweep(rig, requests, workers=0, folder=place, progress=False)
    assert not {*_jobs(other)} & {*_jobs(mended)}


def test_a_capture_is_named_by_all_that_makes_it() -> None:
    plane, request = np.eye(2), CaptureRequest(goal="illuminated")
    names = {
        hash_capture({"a": 1}, request, {"illumination": plane}, 0),
        hash_capture({"a": 2}, request, {"illumination": plane}, 0),
        hash_capture(
            {"a": 1}, CaptureRequest(goal="illuminated", seed=1), {"illumination": plane}, 0
        ),
        hash_capture({"a": 1}, request, {"illumination": plane * 2.0}, 0),
        hash_capture({"a": 1}, request, {"illumination": plane.ravel()}, 0),
        hash_capture({"a": 1}, request, {"illumination": b"of a file"}, 0),
        hash_capture({"a": 1}, request, {"illumination": plane}, 1),
    }
    assert len(names) == 7
    out = CaptureRequest(goal="illuminated", out="/elsewhere")
    assert hash_capture({"a": 1}, out, {"illumination": np.eye(2)}, 0) in names


def test_two_sweeps_do_not_fill_one_folder(rig: Config, tmp_path: Path) -> None:
    def meddle(row: TaskRecord) -> None:
        with pytest.raises(BusyError, match="another sweep"):
            pdcd.sweep(rig, ["white"], workers=0, folder=tmp_path / "s")

    pdcd.sweep(rig, ["white"], workers=0, folder=tmp_path / "s", progress=meddle)


@pytest.mark.parametrize(
    ("request_", "told"),
    [
        ({"goal": "white", "code": 4}, "request 1: code: no such keyword; is codes meant"),
        ({"codes": 4}, "request 1: None: no such goal"),
        ({"goal": "white", "config": {"scen": {}}}, "request 1: .*scen: no such key"),
        ({"goal": "illuminated", "illumination": "no.npy"}, "request 1: illumination"),
        (
            {"goal": "illuminated", "illumination": np.ones((3, 4), complex)},
            "request 1: illumination: must be rows and columns of real numbers",
        ),
        (
            {"goal": "fraction", "p": Fraction(1, 3)},
            "request 1: p: it takes a number over 0 and below 1",
        ),
        ({"goal": "white", 3: 4}, "request 1: 3: no such keyword"),
        (["white"], r"request 1: \['white'\] is no request"),
    ],
)
def test_a_wrong_request_is_refused_before_any_photo(
    rig: Config, tmp_path: Path, request_: Any, told: str
) -> None:
    with pytest.raises(RequestError, match=f"(?s){told}"):
        pdcd.sweep(rig, ["white", request_], workers=0, folder=tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_on_one_bench_one_after_the_other(
    rig: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = LocalBench.take

    def take(self: LocalBench, request: CaptureRequest, *rest: Any, **more: Any) -> CaptureResult:
        if request.codes == 5:
            raise DeviceLost("it was unplugged", device="camera")
        return whole(self, request, *rest, **more)

    monkeypatch.setattr(LocalBench, "take", take)
    requests = [{"goal": "white", "codes": codes} for codes in (4, 5, 6)]
    with pdcd.local(rig, folder=tmp_path / "runs") as bench:
        table = pdcd.sweep(bench, requests, progress=False)
        assert [*table["error_kind"]] == [None, "device_lost", None]
        assert [*table["asked.codes"]] == [4.0, 5.0, 6.0]
        assert len([*(tmp_path / "runs").iterdir()]) == 2
        for wrong in ({"workers": 2}, {"cluster": "tcp://nowhere:1"}):
            with pytest.raises(RequestError, match="one photo at a time"):
                pdcd.sweep(bench, requests, **wrong)
        with pytest.raises(RequestError, match="keeps its configuration"):
            pdcd.sweep(bench, [{"goal": "white", "config": {}}])


@pytest.mark.long
def test_in_processes_as_in_this_one(rig: Config, tmp_path: Path) -> None:
    here = pdcd.sweep(rig, REQUESTS, workers=0, progress=False)
    there = pdcd.sweep(rig, REQUESTS, workers=2, folder=tmp_path / "s", progress=False)
    for name in ("state", "codes", "rms_error_quads", "rms_sigma", "error"):
        assert [str(value) for value in here[name]] == [str(value) for value in there[name]]


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")  # of the engine, not ours
def test_on_a_cluster_as_in_this_process(rig: Config) -> None:
    import distributed

    here = pdcd.sweep(rig, REQUESTS, workers=0, progress=False)
    with distributed.LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=1, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        there = pdcd.sweep(rig, REQUESTS, cluster=cluster.scheduler_address, progress=False)
        with distributed.Client(cluster) as client:  # type: ignore[no-untyped-call]
            again = pdcd.sweep(rig, REQUESTS[:1], cluster=client, progress=False)
    for name in ("state", "codes", "rms_error_quads", "rms_sigma", "error"):
        assert [str(value) for value in here[name]] == [str(value) for value in there[name]]
    assert again[0]["rms_error_quads"] == here[0]["rms_error_quads"]
