"""A bench in this process: however it is configured, whatever is given, however it ends."""

from __future__ import annotations

import signal
import time
from itertools import islice
from pathlib import Path

import msgspec
import numpy as np
import pytest

import pdcd
from pdcd.api.local import resolve_config
from pdcd.bench.tables import Config, DisplayConfig, FaultsConfig, LimitsConfig, RigConfig
from pdcd.capture.engine import Engine
from pdcd.errors import BusyError, Cancelled, ConfigError, DeviceLost, RequestError
from pdcd.protocol.events import Event
from tests.bench_rig import GRID, config, transport


def test_a_configuration_may_be_given_in_many_ways(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    text = '[scene]\nkind = "wax-disk"\ngrid = [6, 8]\n'
    (tmp_path / "a.toml").write_text(text)
    wanted = resolve_config(text)
    assert (wanted.scene.kind, wanted.scene.grid) == ("wax-disk", (6, 8))
    assert resolve_config(tmp_path / "a.toml") == resolve_config(str(tmp_path / "a.toml")) == wanted
    assert resolve_config({"scene": {"kind": "wax-disk", "grid": np.array([6, 8])}}) == wanted
    assert resolve_config(wanted) is wanted and resolve_config(None) == Config()
    assert resolve_config({"scene": {"ambient": 0.5}}, wanted).scene == msgspec.structs.replace(
        wanted.scene, ambient=0.5
    )


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"scene": {"kin": "wax-disk"}}, "scene.kin: no such key; is kind meant"),
        ("[scene]\nkin = 1", "the text given"),
        ("a = [", "the text given is not TOML"),
        ({"schedule": {"codes": 2**70}}, "more than 64 bits"),
        ("no-such-file.toml", "cannot read"),
        (5, "a configuration of type int was given"),
        (b"a = 1", "type bytes"),
    ],
)
def test_a_wrong_configuration_is_refused(given: object, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        resolve_config(given)  # type: ignore[arg-type]


def test_a_bench_takes_one_stream_or_photo_at_a_time(tmp_path: Path) -> None:
    with pdcd.local(config(tmp_path), folder=tmp_path / "runs") as bench:
        for _ in range(2):
            with bench.stream("indirect", codes=8) as stream:
                with pytest.raises(BusyError, match="taking a photo or a stream"):
                    bench.capture("white", codes=4, progress=False)
                with pytest.raises(BusyError):
                    bench.stream("indirect", codes=8)
                with pytest.raises(BusyError):  # or the stream's plan would be lost
                    bench.plan("indirect", codes=8)
                assert next(stream).number > 0
            assert bench.capture("white", codes=4, progress=False).goal == "white"


def test_a_bench_that_is_closed_ends_its_stream(tmp_path: Path) -> None:
    with pdcd.local(config(tmp_path), folder=tmp_path / "runs") as bench:
        stream = bench.stream("indirect", codes=8)
        next(stream)
    assert len(list(islice(stream, 3))) <= 1  # what was ready by then


def test_a_stream_ends_with_its_time_however_slow_it_is(tmp_path: Path) -> None:
    with pdcd.local(config(tmp_path), folder=tmp_path / "runs") as bench:
        began_s = time.monotonic()
        assert list(bench.stream("indirect", codes=8, rate_hz=0.02, for_s=0.5))
        assert time.monotonic() - began_s < 40.0  # the next picture would be due after 50


def test_arrays_may_come_in_any_form(tmp_path: Path) -> None:
    """As an array, as rows of numbers, from a file: the same picture to the bit."""
    plane = np.linspace(0.2, 1.0, 12).reshape(GRID)
    np.save(tmp_path / "plane.npy", plane)
    with pdcd.local(config(tmp_path), folder=tmp_path / "runs") as bench:
        first, *others = (
            bench.capture("illuminated", illumination=given, progress=False)
            for given in (plane, plane.tolist(), tmp_path / "plane.npy")
        )
        told = [run.manifest.request["illumination"] for run in (first, *others)]
    assert all(np.array_equal(run.image, first.image) for run in others)
    assert len({entry["sha256"] for entry in told}) == 1 and told[2]["file"] == "plane.npy"
    assert first.folder.parent == tmp_path / "runs"


def test_a_prior_may_be_an_array(tmp_path: Path) -> None:
    matrix = transport()
    np.savez(tmp_path / "prior.npz", transport=matrix, grid=np.array(GRID))
    with pdcd.local(config(tmp_path)) as bench:
        plans = [bench.plan("indirect", prior=p) for p in (matrix, tmp_path / "prior.npz")]
        assert plans[0].prior is not None and plans[1] == msgspec.structs.replace(
            plans[0], prior=plans[1].prior
        )
        with pytest.raises(RequestError, match="prior"):
            bench.plan("indirect", prior=matrix[:5, :5])
        with pytest.raises(RequestError, match="the grid is 3 x 4"):
            bench.plan("illuminated", illumination=np.ones((2, 2)))


def test_a_failed_capture_raises_the_error_it_ended_by(tmp_path: Path) -> None:
    full = config(tmp_path, limits=LimitsConfig(min_free_bytes=2**62))
    with pdcd.local(full) as bench, pytest.raises(pdcd.errors.NoSpaceError, match="bytes are free"):
        bench.capture("white", progress=False)


def test_its_error_tells_where_what_was_taken_lies(tmp_path: Path) -> None:
    late = DisplayConfig(faults=FaultsConfig(late={"5": 2}))
    strict = config(tmp_path, display=late, rig=RigConfig(on_miss="abort", retries=0))
    with pdcd.local(strict) as bench, pytest.raises(pdcd.errors.SyncError) as caught:
        bench.capture("indirect", progress=False)
    (kept,) = (tmp_path / "state" / "captures").iterdir()
    assert caught.value.__notes__ == [f"What was taken lies in {kept}"]


def test_devices_that_did_not_open_may_be_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    start, stop = Engine.start, Engine.stop

    def starts(self: Engine) -> None:
        calls.append("start")
        if len(calls) == 1:
            raise DeviceLost("it is not there", device="camera")
        start(self)

    def stops(self: Engine) -> None:
        calls.append("stop")
        stop(self)

    monkeypatch.setattr(Engine, "start", starts)
    monkeypatch.setattr(Engine, "stop", stops)
    with pdcd.local(config(tmp_path)) as bench:
        with pytest.raises(DeviceLost):
            bench.capture("white", progress=False)
        assert bench.capture("white", progress=False).goal == "white"
    assert calls == ["start", "stop", "start", "stop"]


def test_an_interrupt_ends_the_job_first_and_is_felt_then(tmp_path: Path) -> None:
    def interrupt(event: Event) -> None:
        if event.type == "shutter_open":
            signal.raise_signal(signal.SIGINT)

    with pdcd.local(config(tmp_path), folder=tmp_path / "runs") as bench:
        with pytest.raises(KeyboardInterrupt) as caught:
            bench.capture("indirect", progress=interrupt)
        assert bench.capture("white", progress=False).goal == "white"
    (cut,) = (tmp_path / "runs").glob("*.partial")
    assert '"cancelled"' in (cut / "log.jsonl").read_text().splitlines()[-1]
    assert not isinstance(caught.value.__cause__, Cancelled)
