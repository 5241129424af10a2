"""Whatever fails, whenever: panels black, shutter closed, a typed error, nothing half done."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import msgspec
import pytest

from pdcd.capture.engine import Engine
from pdcd.errors import DeviceLost, ExposureError
from pdcd.protocol.events import Event
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.manifest import MANIFEST
from tests import bench_rig

REQUEST = CaptureRequest(goal="indirect", codes=4)


class Tripwire:
    """Counts the calls to a rig's drivers and raises at one of them, once.

    `at` is the number of the call, or the name whose first call it shall be.
    """

    def __init__(self, at: int | str | None, error: Exception) -> None:
        self.at = at
        self.error = error
        self.calls: list[str] = []

    def guard(self, role: str, device: Any) -> Any:
        wire = self

        class Guarded:
            def __getattr__(self, name: str) -> Any:
                real = getattr(device, name)

                def call(*args: Any) -> Any:
                    called = f"{role}.{name}"
                    first = called not in wire.calls
                    wire.calls.append(called)
                    if wire.at == len(wire.calls) - 1 or (wire.at == called and first):
                        raise wire.error
                    return real(*args)

                return call

        return Guarded()


def rigged(folder: Path, wire: Tripwire) -> Engine:
    engine = Engine.from_config(bench_rig.config(folder))
    rig = engine._rig
    rig.display = wire.guard("display", rig.display)
    rig.shutter = wire.guard("shutter", rig.shutter)
    rig.readout = wire.guard("readout", rig.readout)
    return engine


def assert_closed(engine: Engine, result: CaptureResult, folder: Path) -> None:
    bench = bench_rig.bench_of(engine)
    assert bench_rig.are_panels_black(bench)
    assert not bench.shutter_open
    for found in folder.rglob(MANIFEST):
        raise AssertionError(f"{found} looks like a finished run")
    for job in (folder / "state").rglob("job*"):
        assert job.name.endswith(".partial")
    assert result.error is not None and result.error["message"]
    if result.folder is not None:
        kept = Path(result.folder)
        assert kept.name == "job.partial"
        assert result.files == tuple(
            sorted(str(p.relative_to(kept)) for p in kept.rglob("*") if p.is_file())
        )


def calls_of_a_good_run(folder: Path) -> list[str]:
    wire = Tripwire(None, DeviceLost("never"))
    engine = rigged(folder, wire)
    engine.start()
    started = len(wire.calls)
    assert bench_rig.capture(engine, REQUEST).state == "done"
    return wire.calls[started:]


@pytest.mark.long
def test_a_driver_that_raises_at_every_single_call(tmp_path: Path) -> None:
    good = tmp_path / "good"
    good.mkdir()
    calls = calls_of_a_good_run(good)
    wanted = {"display.load", "display.black", "display.play", "shutter.open", "shutter.close",
              "readout.arm", "readout.fetch"}  # fmt: skip
    assert wanted <= set(calls)
    survived = []
    for step, call in enumerate(calls):
        folder = tmp_path / str(step)
        folder.mkdir()
        wire = Tripwire(None, DeviceLost("pulled the plug", device=call, hint="plug it in"))
        engine = rigged(folder, wire)
        engine.start()
        wire.at = len(wire.calls) + step
        result = bench_rig.capture(engine, REQUEST, "job")
        if result.state == "done":
            survived.append(step)  # the last black and close: asked again, and then fine
            assert bench_rig.are_panels_black(bench_rig.bench_of(engine))
            assert not bench_rig.bench_of(engine).shutter_open
            continue
        assert result.state == "failed"
        assert result.error == {
            "kind": "device_lost", "message": "pulled the plug", "device": call,
            "hint": "plug it in",
        }  # fmt: skip
        assert_closed(engine, result, folder)
    # Only the final make-safe, after everything was written, may fail once without harm.
    assert survived == [len(calls) - 2, len(calls) - 1]


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (ExposureError("no file came"), "exposure"),
        (OSError(errno.ENOSPC, "No space left on device"), "no_space"),
        (OSError(errno.EROFS, "Read-only file system"), "disk"),
        (RuntimeError("a bug"), "internal"),
    ],
)
def test_kind_of_what_a_driver_raises(tmp_path: Path, error: Exception, kind: str) -> None:
    engine = rigged(tmp_path, Tripwire("readout.fetch", error))
    engine.start()
    result = bench_rig.capture(engine, REQUEST, "job")
    assert result.state == "failed"
    assert result.error is not None and result.error["kind"] == kind
    assert_closed(engine, result, tmp_path)


def test_a_rig_that_does_not_open_is_left_safe(tmp_path: Path) -> None:
    for step in range(6):
        folder = tmp_path / str(step)
        folder.mkdir()
        wire = Tripwire(step, DeviceLost("not there", device="camera"))
        engine = rigged(folder, wire)
        try:
            engine.start()
        except DeviceLost:
            bench = bench_rig.bench_of(engine)
            assert bench_rig.are_panels_black(bench) and not bench.shutter_open
            assert wire.calls.count("display.black") >= 1
            assert wire.calls.count("shutter.close") >= 1
        else:
            assert step >= 3  # connect is three calls
    assert step == 5


def stops_after(polls: int) -> Callable[[], bool]:
    left = iter(range(polls))
    return lambda: next(left, None) is None


@pytest.mark.long
def test_cancel_at_every_stage(tmp_path: Path) -> None:
    states: list[str] = []
    for polls in range(200):
        folder = tmp_path / str(polls)
        folder.mkdir()
        engine = Engine.from_config(bench_rig.config(folder))
        engine.start()
        events: list[str] = []

        def emit(event: Event, seen: list[str] = events) -> None:
            seen.append(event.type)

        result = engine.capture(REQUEST, job="job", emit=emit, cancelled=stops_after(polls))
        states.append(result.state)
        if result.state == "done":
            break
        assert result.state == "cancelled"
        assert result.error is not None and result.error["kind"] == "cancelled"
        assert_closed(engine, result, folder)
    assert states[-1] == "done"
    assert len(states) > 20  # there were that many chances to stop


FILES = ["codes.npz.new", "ledger.jsonl", "log.jsonl", "frames.csv", "white.dng",
         "coded.dng", "white.tif", "probe.npz", "indirect.png", "capture.json.new"]  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_full_disk_at_every_file(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = Engine.from_config(bench_rig.config(tmp_path))
    engine.start()
    real = Path.open

    def full(self: Path, mode: str = "r", *args: Any, **kwargs: Any) -> IO[Any]:
        if self.name == name and mode[0] in "wa":
            raise OSError(errno.ENOSPC, "No space left on device", str(self))
        return real(self, mode, *args, **kwargs)

    monkeypatch.setattr(Path, "open", full)
    result = bench_rig.capture(engine, REQUEST, "job")
    monkeypatch.undo()
    assert result.state == "failed"
    assert result.error is not None and result.error["kind"] == "no_space"
    assert_closed(engine, result, tmp_path)


def test_a_folder_that_cannot_get_its_name_does_not_look_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = Engine.from_config(bench_rig.config(tmp_path))
    engine.start()
    real = os.rename

    def refused(source: Any, target: Any, **given: int) -> None:
        if source == "job.partial":
            raise OSError(errno.EACCES, "Permission denied", source)
        real(source, target, **given)

    monkeypatch.setattr(os, "rename", refused)
    result = bench_rig.capture(engine, REQUEST, "job")
    monkeypatch.undo()
    assert result.state == "failed"
    assert_closed(engine, result, tmp_path)


def test_too_little_space_is_refused_before_the_shutter_opens(tmp_path: Path) -> None:
    limits = msgspec.structs.replace(bench_rig.config(tmp_path).limits, min_free_bytes=2**60)
    engine = Engine.from_config(bench_rig.config(tmp_path, limits=limits))
    engine.start()
    events: list[str] = []
    result = engine.capture(
        REQUEST, job="job", emit=lambda e: events.append(e.type), cancelled=lambda: False
    )
    assert result.error is not None and result.error["kind"] == "no_space"
    assert "shutter_open" not in events
    assert_closed(engine, result, tmp_path)
