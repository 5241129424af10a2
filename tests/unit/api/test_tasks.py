"""Sweeps piece by piece: keywords, ledgers, tables, pools, interrupts; no photo is taken."""

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

from pdcd.api import pool, sweep
from pdcd.api.arguments import asked, plain
from pdcd.api.bench import finished
from pdcd.api.ledger import NAME, Ledger
from pdcd.api.local import described, owner
from pdcd.api.pool import on_cluster
from pdcd.api.run import Run
from pdcd.api.table import Table
from pdcd.api.task import ENDING, Record, Task, ended, failed, held, taken
from pdcd.bench.tables import Config, SceneConfig
from pdcd.errors import BusyError, DecodeError, DeviceLost, PdcdError, RequestError
from pdcd.files.arrays import read_npz
from pdcd.files.opening import Limits
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, Quality

WHITE = CaptureRequest(goal="white")


def grid() -> tuple[int, int]:
    return 2, 3


def test_values_of_other_libraries_become_plain_ones() -> None:
    given = {"a": np.float32(0.5), 2: (np.int64(3), [Path("/x")]), "c": np.eye(2), "d": "e"}
    assert plain(given) == {"a": 0.5, "2": [3, ["/x"]], "c": [[1.0, 0.0], [0.0, 1.0]], "d": "e"}
    assert type(plain(given)["a"]) is float and plain(None) is None


def test_keywords_that_are_easily_given_otherwise_are_understood() -> None:
    request, arrays = asked("white", {"tags": "one", "out": Path("here"), "note": None}, grid)
    assert request.tags == ("one",) and not arrays
    assert request.out == str(Path.cwd() / "here") and request.note == ""
    many, _ = asked("white", {"tags": ["one", "two"], "white_patch": [0.5, 0.25]}, grid)
    assert (many.tags, many.white_patch) == (("one", "two"), (0.5, 0.25))
    with pytest.raises(RequestError, match="name: it takes") as caught:
        asked("white", {"name": "\n"}, grid)
    assert caught.value.hint


def test_a_prior_is_in_words_a_file_or_an_array() -> None:
    request, arrays = asked("indirect", {"prior": "decay:3"}, grid)
    assert (request.prior, arrays) == ("decay:3", {})
    _, arrays = asked("indirect", {"prior": Path("t.npz")}, grid)
    assert arrays["prior"] == Path("t.npz")
    matrix = np.arange(36.0).reshape(6, 6)
    _, arrays = asked("indirect", {"prior": matrix.tolist()}, grid)
    content: Any = arrays["prior"]
    found = read_npz(content, {"transport": Limits(99), "grid": Limits(2)})
    assert np.array_equal(found["transport"], matrix) and found["grid"].tolist() == [2.0, 3.0]


@pytest.mark.parametrize("kernel", [[[1j]], [["a"]], [1.0], [[[1.0]]]])
def test_arrays_are_rows_of_real_numbers(kernel: Any) -> None:
    with pytest.raises(RequestError, match="rows and columns of real numbers"):
        asked("filtered", {"kernel": kernel}, grid)
    for kind in (np.bool_, np.int8, np.uint16, np.float32):
        _, arrays = asked("filtered", {"kernel": np.ones((1, 1), kind)}, grid)
        assert np.asarray(arrays["kernel"]).dtype == kind


def test_arrays_of_files_go_with_a_task_by_their_content(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(b"content")
    array = np.eye(2)
    found = held({"kernel": array, "warp": tmp_path / "a.npy", "matrix": str(tmp_path / "a.npy")})
    assert found["kernel"] is array and found["warp"] == found["matrix"] == b"content"
    with pytest.raises(RequestError, match=r"warp \(.*none\): it cannot be opened") as caught:
        held({"warp": tmp_path / "none"})
    assert caught.value.hint


def test_how_a_capture_ended_is_one_row() -> None:
    summary: dict[str, Any] = {
        "codes": 8,
        "rms_sigma": 0.5,
        "quality": Quality(verdict="good"),
        "secret": 1,
    }
    result = CaptureResult(
        job="j", state="done", folder="/x", manifest_sha256="0" * 64, summary=summary
    )
    row = ended(WHITE, result)
    assert tuple(row) == ENDING
    assert (row["goal"], row["state"], row["job"], row["folder"]) == ("white", "done", "j", "/x")
    assert (row["verdict"], row["codes"], row["rms_sigma"], row["parts"]) == ("good", 8, 0.5, None)
    assert (row["manifest_sha256"], row["error"]) == ("0" * 64, None)
    lost = failed(WHITE, DeviceLost("gone", device="camera"))
    assert (lost["state"], lost["error_kind"], lost["folder"]) == ("failed", "device_lost", None)
    assert "gone" in str(lost["error"]) and lost["verdict"] is None and lost["job"] == ""


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
    assert taken(Task(Config(), WHITE))["error_kind"] == "device_lost"
    error = ZeroDivisionError("oh")
    row = taken(Task(Config(), WHITE))
    assert row["state"] == "failed" and "internal error: ZeroDivisionError: oh" in str(row["error"])
    assert closed == [True, True]


def test_the_run_of_a_job_or_the_error_that_it_ended_by() -> None:
    told: dict[str, str | None] = {
        "kind": "device_lost",
        "message": "gone",
        "device": "camera",
        "hint": "look",
    }
    with pytest.raises(DeviceLost) as caught:
        finished(CaptureResult(job="j", state="failed", error=told, folder="/kept"))
    error = caught.value
    assert (error.message, error.device, error.hint) == ("gone", "camera", "look")
    assert error.__notes__ == ["What was taken lies in /kept"]
    with pytest.raises(PdcdError, match="the job is cancelled") as bare:
        finished(CaptureResult(job="j", state="cancelled"))
    assert not hasattr(bare.value, "__notes__")


def test_a_ledger_knows_what_is_done_and_still_there(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (run / "capture.json").write_bytes(b"manifest")
    import hashlib

    digest = hashlib.sha256(b"manifest").hexdigest()
    done: Record = {"state": "done", "folder": str(run), "manifest_sha256": digest}
    ledger = Ledger(tmp_path / "s")
    assert ledger.known == {}
    rows: dict[str, Record] = {
        "good": done, "failed": done | {"state": "failed"},
        "other": done | {"manifest_sha256": "0"},
        "gone": done | {"folder": str(tmp_path / "none")}, "nowhere": done | {"folder": None},
    }  # fmt: skip
    for key, row in rows.items():
        ledger.add(key, row)
    with pytest.raises(BusyError):
        Ledger(tmp_path / "s")
    ledger.close()
    with (tmp_path / "s" / NAME).open("ab") as file:
        file.write(b'{"key": "half')
    again = Ledger(tmp_path / "s")
    assert again.known == {"good": done}
    again.add("late", done)
    again.close()
    last = Ledger(tmp_path / "s")
    assert last.known == {"good": done, "late": done}
    last.close()


def test_tables_have_columns_in_the_order_of_what_was_asked() -> None:
    rows: list[Record] = [
        {"number": 0, "asked.b": 1, "goal": "white", "state": "done", "codes": 8},
        {"number": 1, "asked.a": "x", "goal": "white", "state": "failed", "codes": None},
    ]
    table = Table(rows)
    assert table.columns == ("number", "asked.b", "asked.a", *ENDING)
    assert table[1]["asked.a"] == "x" and table[0]["asked.a"] is None and len(table) == 2
    assert table["codes"].dtype == np.float64 and np.isnan(table["codes"][1])
    assert table["asked.a"].tolist() == [None, "x"] and table["asked.a"].dtype == object
    assert [row["number"] for row in table.where(**{"asked.b": 1})] == [0]
    assert [row["number"] for row in table.failed] == [1]
    assert repr(table) == "<Table of 2 captures, 1 failed>"
    with pytest.raises(IndexError):
        table[2]
    assert Table([]).columns == ("number", *ENDING) and len(Table([])) == 0


@pytest.mark.parametrize(("count", "more"), [(40, None), (41, "and 1 more"), (45, "and 5 more")])
def test_a_notebook_shows_so_many_rows(count: int, more: str | None) -> None:
    table = Table(
        {"number": n, "asked.p": 1 / 3, "state": "done", "goal": "<g>"} for n in range(count)
    )
    shown = table._repr_html_()
    assert shown.count("<tr>") == 41 and "<td>0.3333</td>" in shown and "&lt;g&gt;" in shown
    assert ("more" in shown) == (more is not None) and (more is None or more in shown)
    heads = shown.split("</tr>")[0]
    assert heads.index("number") < heads.index("asked.p") < heads.index("goal")


def test_what_was_asked_fits_into_a_cell_of_a_table() -> None:
    assert [sweep._said(v) for v in (None, 1, 0.5, "x" * 99, True)] == [
        None,
        1,
        0.5,
        "x" * 99,
        True,
    ]
    assert sweep._said((1, 2)) == "[1,2]"
    fits = ["x" * 76]
    assert sweep._said(fits) == '["' + "x" * 76 + '"]' and len(str(sweep._said(fits))) == 80
    cut = str(sweep._said(["x" * 77]))
    assert len(cut) == 80 and cut.endswith("x ...")
    assert [*sweep._flat({"a": {"b": 1, "c": {"d": 2}}, "e": 3})] == [
        ("a.b", 1), ("a.c.d", 2), ("e", 3),
    ]  # fmt: skip
    assert [*sweep._flat("text")] == [("text", "text")] and [*sweep._flat(None)] == []


def test_only_a_bench_that_is_mock_throughout_is_shared_out() -> None:
    assert sweep._mock(Config())
    for table in ("display", "trigger", "camera"):
        other = msgspec.structs.replace(getattr(Config(), table), driver="x11")
        assert not sweep._mock(msgspec.structs.replace(Config(), **{table: other}))


def test_sweeps_that_cannot_be_are_refused() -> None:
    with pytest.raises(RequestError, match="-1 workers"):
        sweep.sweep(Config(), ["white"], workers=-1)
    real = msgspec.structs.replace(Config().camera, driver="gphoto2")
    config = msgspec.structs.replace(Config(), camera=real)
    for wrong in ({"workers": 2}, {"cluster": "tcp://nowhere:1"}):
        with pytest.raises(RequestError, match="real devices take one photo at a time"):
            sweep.sweep(config, ["white"], **wrong)


def test_a_sweep_tells_how_many_are_done(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Any] = []
    from contextlib import contextmanager

    @contextmanager
    def drawn(first: str) -> Any:
        yield lambda *said: told.append(said)

    monkeypatch.setattr(sweep, "drawn", drawn)
    with sweep._counting(True, 2, 5) as tell:
        tell({"state": "done"})
        tell({"state": "failed"})
        tell({"state": "done"})
    assert told == [
        ("2 of 5 captures", (0.0, 3.0), True),
        ("3 of 5 captures", (1.0, 3.0), False),
        ("4 of 5 captures, 1 failed", (2.0, 3.0), False),
        ("5 of 5 captures, 1 failed", (3.0, 3.0), False),
    ]
    with sweep._counting(False, 0, 1) as silent:
        silent({"state": "done"})
    assert len(told) == 4


class Future:
    def __init__(self, value: Any, error: Exception | None = None) -> None:
        self.value, self.error = value, error

    def exception(self) -> Exception | None:
        return self.error

    def result(self) -> Any:
        return self.value

    def add_done_callback(self, call: Any) -> None:
        call(self)


class Cluster:
    """A cluster that takes every photo at once, and loses those of a note."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.how: dict[str, object] = {}

    def submit(self, function: Any, task: Task, **how: object) -> Future:
        assert function is taken
        self.how = how
        lost = ValueError("worker died") if task.request.note == "lost" else None
        return Future({"state": "done", "job": task.request.note}, lost)

    def cancel(self, futures: list[Any]) -> None:
        self.calls.append(f"cancel {len(futures)}")

    def close(self) -> None:
        self.calls.append("close")


def test_a_cluster_that_loses_a_capture_loses_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    tasks = [Task(Config(), CaptureRequest(goal="white", note=n)) for n in ("a", "lost", "b")]
    mine = Cluster()
    rows = dict(on_cluster(tasks, mine))
    assert [rows[n]["state"] for n in range(3)] == ["done", "failed", "done"]
    assert (rows[0]["job"], rows[2]["job"]) == ("a", "b")
    assert "the cluster lost it: worker died" in str(rows[1]["error"])
    assert mine.calls == ["cancel 3"]  # one that was given stays open
    assert mine.how == {"pure": False, "retries": 0}
    named = Cluster()
    monkeypatch.setattr(pool, "_client", lambda address: named)
    assert len(dict(on_cluster(tasks, "tcp://there:1"))) == 3
    assert named.calls == ["cancel 3", "close"]


def test_a_bench_is_told_by_its_configuration_and_its_files(tmp_path: Path) -> None:
    scene = tmp_path / "scene.npz"
    scene.write_bytes(b"one")
    config = msgspec.structs.replace(Config(), scene=SceneConfig(kind="matrix", path=str(scene)))
    first = described(config)
    assert json.loads(json.dumps(first["config"]))["scene"]["path"] == str(scene)
    assert [*first["files"]] == [str(scene)]
    scene.write_bytes(b"two")
    assert described(config)["files"] != first["files"]
    scene.unlink()
    assert described(config)["files"] == {}


def test_a_user_whom_no_table_names_is_told_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(uid: int) -> None:
        raise KeyError(uid)

    known = owner()
    monkeypatch.setattr("pdcd.api.local.pwd.getpwuid", none)
    bare = owner()
    assert (bare.uid, bare.pid, bare.user) == (known.uid, known.pid, str(known.uid))


def run_of(**fields: Any) -> Run:
    told: Any = Run.__new__(Run)
    summary = fields.pop("summary", {})
    quality = summary.get("quality", Quality(verdict="good"))
    told.folder = fields.pop("folder", Path("/x"))
    told.manifest = SimpleNamespace(
        job="j", run=SimpleNamespace(goal=SimpleNamespace(name="white"), grid=(2, 3), cells=None),
        summary=summary, quality=quality, warnings=("<w>",), files=fields.pop("files", {}),
    )  # fmt: skip
    made: Run = told
    return made


def test_a_run_tells_its_figures_as_far_as_they_are_known() -> None:
    known = run_of(
        summary={"rms_sigma": 1, "rms_error_quads": "x", "quality": Quality(verdict="bad")}
    )
    assert (known.rms_sigma, known.rms_error_quads, known.verdict) == (1.0, None, "bad")
    assert repr(known) == "<Run j: white, bad>" and known.sigma_kind == "sensor"
    good = Quality(verdict="good")
    bare = run_of(summary={"codes": 8, "sigma_kind": "measured", "quality": good})
    assert (bare.quality, bare.sigma_kind) == (good, "measured")
    assert repr(bare) == "<Run j: white, 8 codes, good>" and bare.codes == {} and bare.truth is None


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
