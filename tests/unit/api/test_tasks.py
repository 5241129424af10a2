"""Sweeps piece by piece: keywords, tasks, rows, runs in a notebook; no photo is taken."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from pdcd.api.arguments import make_request, to_json_types
from pdcd.api.bench import open_finished_run
from pdcd.api.local import describe_bench, describe_owner
from pdcd.api.run import Run
from pdcd.api.task import Task, load_arrays, take_capture
from pdcd.bench.tables import Config, SceneConfig
from pdcd.errors import DecodeError, DeviceLost, PdcdError, RequestError
from pdcd.files.arrays import read_npz
from pdcd.files.opening import ArrayLimits
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, Quality

WHITE = CaptureRequest(goal="white")


def grid() -> tuple[int, int]:
    return 2, 3


def test_values_of_other_libraries_become_plain_ones() -> None:
    given = {"a": np.float32(0.5), 2: (np.int64(3), [Path("/x")]), "c": np.eye(2), "d": "e"}
    assert to_json_types(given) == {
        "a": 0.5,
        "2": [3, ["/x"]],
        "c": [[1.0, 0.0], [0.0, 1.0]],
        "d": "e",
    }
    assert type(to_json_types(given)["a"]) is float and to_json_types(None) is None


def test_keywords_that_are_easily_given_otherwise_are_understood() -> None:
    request, arrays = make_request(
        "white", {"tags": "one", "out": Path("here"), "note": None}, grid
    )
    assert request.tags == ("one",) and not arrays
    assert request.out == str(Path.cwd() / "here") and request.note == ""
    many, _ = make_request("white", {"tags": ["one", "two"], "white_patch": [0.5, 0.25]}, grid)
    assert (many.tags, many.white_patch) == (("one", "two"), (0.5, 0.25))
    with pytest.raises(RequestError, match="name: it takes") as caught:
        make_request("white", {"name": "\n"}, grid)
    assert caught.value.hint


def test_a_prior_is_in_words_a_file_or_an_array() -> None:
    request, arrays = make_request("indirect", {"prior": "decay:3"}, grid)
    assert (request.prior, arrays) == ("decay:3", {})
    _, arrays = make_request("indirect", {"prior": Path("t.npz")}, grid)
    assert arrays["prior"] == Path("t.npz")
    matrix = np.arange(36.0).reshape(6, 6)
    _, arrays = make_request("indirect", {"prior": matrix.tolist()}, grid)
    content: Any = arrays["prior"]
    found = read_npz(content, {"transport": ArrayLimits(99), "grid": ArrayLimits(2)})
    assert np.array_equal(found["transport"], matrix) and found["grid"].tolist() == [2.0, 3.0]


def test_arrays_of_files_go_with_a_task_by_their_content(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(b"content")
    array = np.eye(2)
    found = load_arrays(
        {"kernel": array, "warp": tmp_path / "a.npy", "matrix": str(tmp_path / "a.npy")}
    )
    assert found["kernel"] is array and found["warp"] == found["matrix"] == b"content"
    with pytest.raises(RequestError, match=r"warp \(.*none\): it cannot be opened") as caught:
        load_arrays({"warp": tmp_path / "none"})
    assert caught.value.hint


def test_whatever_goes_wrong_in_a_capture_of_a_sweep_is_a_row(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    closed: list[bool] = []

    class Bench:
        def __init__(self, config: Config, folder: Path | None) -> None:
            self.config = config

        def __enter__(self) -> Bench:
            return self

        def __exit__(self, *_: object) -> None:
            closed.append(True)

        def take(self, request: CaptureRequest, arrays: object) -> CaptureResult:
            raise error

    monkeypatch.setattr("pdcd.api.task.LocalBench", Bench)
    error: Exception = DeviceLost("gone", device="camera")
    assert take_capture(Task(Config(), WHITE))["error_kind"] == "device_lost"
    error = ZeroDivisionError("oh")
    row = take_capture(Task(Config(), WHITE))
    assert row["state"] == "failed" and "ZeroDivisionError: oh" in str(row["error"])
    assert closed == [True, True]


def test_the_run_of_a_job_or_the_error_that_it_ended_by() -> None:
    told: dict[str, str | None] = {
        "kind": "device_lost",
        "message": "gone",
        "device": "camera",
        "hint": "look",
    }
    with pytest.raises(DeviceLost) as caught:
        open_finished_run(CaptureResult(job="j", state="failed", error=told, folder="/kept"))
    error = caught.value
    assert (error.message, error.device, error.hint) == ("gone", "camera", "look")
    assert error.__notes__ == ["What was taken lies in /kept"]
    with pytest.raises(PdcdError, match="the job is cancelled") as bare:
        open_finished_run(CaptureResult(job="j", state="cancelled"))
    assert not hasattr(bare.value, "__notes__")


def test_a_bench_is_told_by_its_configuration_and_its_files(tmp_path: Path) -> None:
    scene = tmp_path / "scene.npz"
    scene.write_bytes(b"one")
    config = msgspec.structs.replace(Config(), scene=SceneConfig(kind="matrix", path=str(scene)))
    first = describe_bench(config)
    assert json.loads(json.dumps(first["config"]))["scene"]["path"] == str(scene)
    assert [*first["files"]] == [str(scene)]
    scene.write_bytes(b"two")
    assert describe_bench(config)["files"] != first["files"]
    scene.unlink()
    assert describe_bench(config)["files"] == {}


def run_of(**fields: Any) -> Run:
    told: Any = Run.__new__(Run)
    summary = fields.pop("summary", {})
    quality = summary.get("quality", Quality(verdict="good"))
    told.folder = fields.pop("folder", Path("/x"))
    told.manifest = SimpleNamespace(
        job="j", run=SimpleNamespace(
            goal=SimpleNamespace(name="white"), grid=(2, 3), cells=None, responsivity_e=(1.0,) * 3
        ),
        summary=summary, quality=quality, warnings=("<w>",), files=fields.pop("files", {}),
    )  # fmt: skip
    made: Run = told
    return made


def test_a_preview_that_cannot_be_read_is_left_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    names = ("white", "direct", "indirect", "high", "low", "odd")
    run: Any = run_of(
        summary={"picture": "low"}, files=dict.fromkeys(f"preview/{n}.png" for n in names)
    )
    run.pictures = dict.fromkeys(names[:5])
    faults: dict[str, Exception] = {}
    black = cv2.imencode(".png", np.zeros((2, 2, 3), np.uint8))[1].tobytes()
    (tmp_path / "a.png").write_bytes(black)

    def checked(self: Run, name: str) -> Path:
        if Path(name).stem in faults:
            raise faults[Path(name).stem]
        return tmp_path / "a.png"

    monkeypatch.setattr(Run, "checked", checked)

    def shown() -> list[str]:
        return re.findall(r'alt="(\w+)"', run._repr_html_())

    # The answer first, and no more than four; one without linear values is none.
    assert shown() == ["low", "direct", "high", "indirect"]
    faults |= {"direct": DecodeError("damaged"), "low": OSError("gone")}
    assert shown() == ["high", "indirect"]
    (tmp_path / "a.png").write_bytes(b"no picture")
    assert shown() == []
    (tmp_path / "a.png").write_bytes(black)
    faults["high"] = ZeroDivisionError()
    with pytest.raises(ZeroDivisionError):
        shown()


def test_a_user_whom_no_table_names_is_told_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(uid: int) -> None:
        raise KeyError(uid)

    known = describe_owner()
    monkeypatch.setattr("pwd.getpwuid", none)
    bare = describe_owner()
    assert (bare.uid, bare.pid, bare.user) == (known.uid, known.pid, str(known.uid))
