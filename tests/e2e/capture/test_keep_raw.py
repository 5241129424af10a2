"""Runs that keep all RAW files, that of the last shot, or none: of a camera that hands over
samples, and of one that makes files."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import pytest

from drivers.mock.camera import MockReadout
from pdcd.bench import registry
from pdcd.bench.devices import PhotoFrame
from pdcd.bench.tables import CameraConfig
from pdcd.capture.engine import Engine
from pdcd.capture.salvage import decode_partial
from pdcd.capture.worker.answers import RigFacts
from pdcd.capture.worker.proxy import InProcessWorker, WorkerProxy
from pdcd.capture.worker.spawned import SpawnedWorker
from pdcd.cli.main import main
from pdcd.errors import DecodeError, PhotoError
from pdcd.pages.report.write import write_report
from pdcd.pictures.decode import decode_folder
from pdcd.planning.given import read_request_arrays
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import RunFolder, read_manifest
from pdcd.runs.verify import verify_run
from pdcd.words import KeepRawName
from tests import bench_rig

pytestmark = pytest.mark.whole

LAST = "raw/coded.dng"


class InMemory(MockReadout):
    """The mock camera without files; the second photo of a rig is lost on its way."""

    photos = 0

    def fetch(self, folder: Path, name: str, timeout_s: float) -> Any:
        settings = self._settings
        assert settings is not None and settings.f_number is not None
        ((samples, tags),) = self._sensor.photos(settings.iso, settings.f_number, 1)
        self.photos += 1
        if self.photos == 2:
            raise PhotoError("lost", device="camera", hint="take it again")
        told = {key: tags[key] for key in ("black", "white", "iso", "exposure_s", "f_number")}
        return PhotoFrame(samples, **told)  # type: ignore[arg-type]


class Taken(NamedTuple):
    """A run, and the names that were in its folder of RAW files while it went on."""

    result: CaptureResult
    folder: Path
    raw: set[str]


@pytest.fixture(autouse=True)
def in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    here = ModuleType("in_memory")
    here.InMemory = InMemory  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "in_memory", here)
    known = {**registry.DRIVERS, ("readout", "in-memory"): "in_memory:InMemory"}
    monkeypatch.setattr(registry, "DRIVERS", known)


def take(
    place: Path,
    driver: str,
    keep: KeepRawName | None,
    keep_raw: KeepRawName | None = None,
    worker: Callable[[RigFacts], WorkerProxy] = InProcessWorker,
) -> Taken:
    """White and indirect light."""
    place.mkdir(exist_ok=True)
    camera = CameraConfig(driver=driver, noise="none", f_number=16.0)
    if keep is not None:
        camera = CameraConfig(driver=driver, noise="none", f_number=16.0, keep=keep)
    engine = Engine(bench_rig.config(place, camera=camera), worker)
    engine.start()
    raw: set[str] = set()

    def emit(event: object) -> None:
        raw.update(path.name for path in place.rglob("raw/*"))

    asked = CaptureRequest(goal="indirect", codes=8, keep_raw=keep_raw)
    request, given = read_request_arrays(asked, {}, engine.grid)
    done = engine.capture(request, given, job="job", emit=emit, cancelled=lambda: False)
    engine.stop()
    return Taken(done, Path(done.folder or "."), raw)


def pictures(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((folder / "linear").iterdir())}


def raw_files(folder: Path) -> set[str]:
    return {f"raw/{path.name}" for path in (folder / "raw").iterdir()}


@pytest.mark.parametrize("driver", ["in-memory", "mock"])
def test_pictures_are_the_same_whatever_is_kept(driver: str, tmp_path: Path) -> None:
    whole = take(tmp_path / "all", driver, None)
    last = take(tmp_path / "last", driver, "last")
    none = take(tmp_path / "none", driver, None, keep_raw="none")
    assert all(run.result.state == "done" for run in (whole, last, none)), none.result
    assert pictures(whole.folder) == pictures(last.folder) == pictures(none.folder)
    listed = {name for name in read_manifest(whole.folder).files if name.startswith("raw/")}
    assert raw_files(whole.folder) == listed
    assert b"not_kept" not in (whole.folder / "capture.json").read_bytes()
    for run, kept in ((last, {LAST}), (none, set())):
        manifest = read_manifest(run.folder)
        assert raw_files(run.folder) == kept
        assert manifest.unkept.keys() == listed - kept
        told = {name for name in run.result.files if name.startswith("raw/")}
        assert told == kept
        found = verify_run(run.folder)
        assert found.whole and set(found.not_kept) == listed - kept
    if driver == "in-memory":  # the photo that was lost has no file
        assert none.raw == set() and "raw/white.dng" in listed


def test_photos_in_memory_reach_a_worker_in_a_process_of_its_own(tmp_path: Path) -> None:
    none = take(tmp_path / "none", "in-memory", "none", worker=SpawnedWorker)
    assert none.result.state == "done" and none.raw == set()
    assert pictures(none.folder) == pictures(take(tmp_path / "all", "in-memory", None).folder)


def test_what_needs_the_photos_says_that_they_were_not_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = take(tmp_path, "in-memory", "none")
    for read in (decode_folder, write_report):
        with pytest.raises(DecodeError, match="not kept") as caught:
            read(run.folder)
        assert "--keep-raw all" in (caught.value.hint or "")
    assert main(["verify", str(run.folder)]) == 0
    assert "not kept" in capsys.readouterr().out


def test_files_stay_until_the_run_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> str:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "finish", fail)
        run = take(tmp_path, "mock", "none")
    assert run.result.state == "failed"
    (partial,) = tmp_path.rglob("*.partial")
    assert LAST in raw_files(partial)
    made = decode_partial(partial, tmp_path / "again")
    assert pictures(Path(made.folder)) == pictures(take(tmp_path / "whole", "mock", None).folder)


def test_a_file_that_could_not_be_removed_is_held_against_its_digest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RunFolder, "drop", lambda *_: None)
    run = take(tmp_path, "mock", "none")
    assert verify_run(run.folder).whole
    path = run.folder / LAST
    path.chmod(0o600)
    path.write_bytes(path.read_bytes()[:-1] + b"\0")
    (finding,) = verify_run(run.folder).findings
    assert (finding.path, finding.what) == (LAST, "changed")


def test_an_aborted_run_of_photos_in_memory_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> str:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "finish", fail)
        run = take(tmp_path, "in-memory", "none")
    assert run.result.state == "failed" and "RAW files are safe" not in str(run.result.error)
    (partial,) = tmp_path.rglob("*.partial")
    with pytest.raises(DecodeError, match="no picture"):
        decode_partial(partial)
