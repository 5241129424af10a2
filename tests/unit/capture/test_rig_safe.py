"""A rig goes black and shut whatever its devices do, and opens and closes on settled panels."""

from __future__ import annotations

import logging
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from msgspec import structs

from pdcd.bench.devices import CameraSettings, RawFile
from pdcd.bench.tables import CameraConfig, DisplayConfig, PanelConfig, RigConfig
from pdcd.capture.exposure import RigExposure
from pdcd.capture.rig import Rig
from pdcd.capture.safety import MAKE_SAFE_S
from pdcd.codes.make import make_codes
from pdcd.errors import DeviceLost, ExposureError, SyncError
from pdcd.panels.frames import Frames
from pdcd.panels.schedule import build_frames
from pdcd.sensor.dng import keep_photo
from tests import bench_rig

SETTLE_S = 0.25
SETTINGS = CameraSettings(iso=100, f_number=8.0)


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    config = bench_rig.config(
        tmp_path,
        rig=RigConfig(settle_s=SETTLE_S),
        camera=CameraConfig(noise="none", fetch_timeout_s=12.5),
        mask=PanelConfig(size_px=(1600, 1200), rise_s=0.001, fall_s=0.002),
    )
    rig = Rig(config)
    rig.connect()
    yield rig
    rig.disconnect()


def one_code() -> Frames:
    codes = make_codes("hadamard", bench_rig.GRID, 4, dual="complement")
    return build_frames(
        bench_rig.pairs(codes), bench_rig.GRID, window="whole", schedule="full", passes=1
    )


class Failing:
    """Raises at the first calls, then does what it stands for."""

    def __init__(self, real: Callable[[], Any], error: BaseException, times: int) -> None:
        self.real, self.error, self.left = real, error, times
        self.calls = 0

    def __call__(self) -> Any:
        self.calls += 1
        if self.left:
            self.left -= 1
            raise self.error
        return self.real()


def failing(
    monkeypatch: pytest.MonkeyPatch, device: Any, method: str, error: BaseException, times: int
) -> Failing:
    made = Failing(getattr(device, method), error, times)
    monkeypatch.setattr(device, method, made)
    return made


ANY = [
    DeviceLost("gone", device="display"),
    RuntimeError("a fault of the program"),
    OSError(5),
    SystemExit("no licence"),
]


@pytest.mark.parametrize("error", ANY, ids=lambda e: type(e).__name__)
def test_panels_that_never_go_black_do_not_keep_the_shutter_open(
    rig: Rig,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    error: BaseException,
) -> None:
    """Any error at all, not only those of our own tree."""
    rig.shutter.open()
    black = failing(monkeypatch, rig.display, "black", error, 1000)
    with caplog.at_level(logging.WARNING):
        assert not rig.make_safe()
    assert black.calls == 3
    assert not bench_rig.bench_of_rig(rig).shutter_open
    said = [record for record in caplog.records if record.levelno == logging.CRITICAL]
    assert [record.args[0] for record in said if record.args] == ["display"]  # type: ignore[index]


@pytest.mark.parametrize(("device", "method"), [("display", "black"), ("shutter", "close")])
def test_a_device_that_fails_twice_is_asked_again(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, device: str, method: str
) -> None:
    bench = bench_rig.bench_of_rig(rig)
    bench.lit()
    rig.shutter.open()
    asked = failing(monkeypatch, getattr(rig, device), method, RuntimeError("busy"), 2)
    assert rig.make_safe()
    assert asked.calls == 3
    assert bench_rig.are_panels_black(bench) and not bench.shutter_open


def test_a_device_that_fails_slowly_is_asked_no_more_once_its_time_is_over(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All tries share one deadline, and no device takes time from another."""
    asked: list[str] = []

    def slow(name: str, seconds: float) -> Callable[[], None]:
        def fail() -> None:
            asked.append(name)
            rig.clock.sleep_until_ns(rig.clock.now_ns() + round(seconds * 1e9))
            raise DeviceLost("silent", device=name)

        return fail

    monkeypatch.setattr(rig.display, "black", slow("display", 6.0))
    monkeypatch.setattr(rig.shutter, "close", slow("shutter", 20.0))
    assert not rig.make_safe() and rig.deaf_since_s is None
    assert asked == ["display", "display", "shutter"]
    monkeypatch.undo()


def test_a_driver_that_waits_with_patience_is_released_in_time(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    released: list[str] = []
    patience = rig.context.patience
    monkeypatch.setattr(rig.readout, "disconnect", lambda: patience.sleep(1e6))
    monkeypatch.setattr(rig.display, "disconnect", lambda: released.append("display"))
    before_ns = rig.clock.now_ns()
    rig.disconnect()
    assert released == ["display"]
    assert rig.clock.now_ns() - before_ns < (MAKE_SAFE_S + 1.0) * 1e9
    monkeypatch.undo()


def test_panels_go_black_before_the_shutter_closes(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Black panels end the exposure at once; a shutter takes its time."""
    calls: list[str] = []
    monkeypatch.setattr(rig.display, "black", lambda: calls.append("black"))
    monkeypatch.setattr(rig.shutter, "close", lambda: calls.append("close"))
    assert rig.make_safe()
    assert calls == ["black", "close"]
    monkeypatch.undo()


@pytest.mark.parametrize(
    "error",
    [DeviceLost("gone", device="camera"), OSError(5, "unplugged"), RuntimeError("a fault"),
     SystemExit(3)],
)  # fmt: skip
@pytest.mark.parametrize("broken", ["readout", "shutter", "display"])
def test_a_device_that_is_not_released_does_not_keep_the_others(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, broken: str, error: BaseException
) -> None:
    released: list[str] = []
    for name in ("readout", "shutter", "display"):
        done = Failing(lambda n=name: released.append(n), error, int(name == broken))  # type: ignore[misc]
        monkeypatch.setattr(getattr(rig, name), "disconnect", done)
    rig.disconnect()
    assert released == [n for n in ("readout", "shutter", "display") if n != broken]


@pytest.mark.parametrize("error", [SystemExit("no licence"), RuntimeError("a fault")])
@pytest.mark.parametrize("broken", ["readout", "shutter", "display"])
def test_a_driver_that_cannot_be_opened_is_named_and_the_others_are_released(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, broken: str, error: BaseException
) -> None:
    failing(monkeypatch, getattr(rig, broken), "connect", error, 1)
    with pytest.raises(DeviceLost, match=f"{broken}: its driver failed: {type(error).__name__}: "):
        rig.connect()
    assert bench_rig.are_panels_black(bench_rig.bench_of_rig(rig))
    rig.connect()


def test_a_stream_that_a_driver_closes_is_no_file_of_the_run(rig: Rig) -> None:
    """Of the process' own, which a child tries."""
    code = (
        "import os; os.close(1); from pdcd.printable import keep_standard_streams;"
        "keep_standard_streams(); os.write(2, os.readlink('/proc/self/fd/1').encode())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert done.stderr == b"/dev/null"


class Watched:
    """What a rig's devices are told, and when."""

    def __init__(self, rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[tuple[str, int, bool]] = []
        self.fetched: list[Any] = []
        bench = bench_rig.bench_of_rig(rig)
        for role, method in (
            ("display", "black"),
            ("readout", "arm"),
            ("shutter", "open"),
            ("display", "play"),
            ("shutter", "close"),
            ("readout", "fetch"),
        ):
            real = getattr(getattr(rig, role), method)

            def call(*args: Any, name: str = method, real: Callable[..., Any] = real) -> Any:
                self.calls.append((name, rig.clock.now_ns(), bench_rig.are_panels_black(bench)))
                if name == "fetch":
                    self.fetched.append(args)
                return real(*args)

            monkeypatch.setattr(getattr(rig, role), method, call)

    @property
    def names(self) -> list[str]:
        """Calls in order, each once where it is repeated at once: `play` ends in black too."""
        return [name for name, _ in groupby(name for name, _, _ in self.calls)]

    def of(self, name: str) -> tuple[int, bool]:
        """When it was first called, and whether the panels were black before."""
        (when, black), *_ = ((ns, black) for called, ns, black in self.calls if called == name)
        return when, black


def expose(rig: Rig, folder: Path) -> RigExposure:
    return rig.expose(
        one_code(),
        SETTINGS,
        folder,
        "shot",
        notify=lambda *_: None,
        progress=lambda *_: None,
        cancelled=lambda: False,
    )


def test_panels_that_show_something_go_black_before_the_camera_is_armed(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As after `pdcd show white`."""
    rig.display.show(one_code())
    assert not bench_rig.are_panels_black(bench_rig.bench_of_rig(rig))
    watched = Watched(rig, monkeypatch)
    expose(rig, tmp_path)
    assert watched.names == ["black", "arm", "open", "play", "black", "close", "fetch"]
    for name in ("arm", "open", "play", "close"):
        assert watched.of(name)[1], f"{name} on panels that are not black"


def test_panels_settle_between_the_shutter_and_the_codes(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    watched = Watched(rig, monkeypatch)
    done = expose(rig, tmp_path)
    settle_ns = round(SETTLE_S * 1e9)
    assert watched.of("play")[0] >= done.open_ns + settle_ns
    assert watched.of("close")[0] >= int(done.log.end_ns.max()) + settle_ns
    assert int(np.min(done.log.dual_ns)) >= done.open_ns + settle_ns
    assert done.close_ns >= int(done.log.end_ns.max()) + settle_ns
    assert [timeout_s for *_, timeout_s in watched.fetched] == [12.5]  # as configured


@pytest.mark.parametrize("moves", ["opened", "closed"])
def test_the_mock_bench_has_no_photo_where_the_shutter_moves_too_soon(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, moves: str
) -> None:
    """After `pdcd show white`, and after the codes."""
    rig.display.show(one_code())
    bench, sleep = bench_rig.bench_of_rig(rig), rig.clock.sleep_until_ns
    settle_ns = round(SETTLE_S * 1e9)

    def too_soon(at_ns: int) -> None:
        black_ns = bench.black_since_ns
        settles = black_ns is not None and black_ns < at_ns <= black_ns + settle_ns
        if settles and bench.shutter_open == (moves == "closed"):
            at_ns = min(at_ns, (black_ns or 0) + settle_ns // 2)
        sleep(at_ns)

    monkeypatch.setattr(rig.clock, "sleep_until_ns", too_soon)
    with pytest.raises(ExposureError, match=f"shutter {moves} on panels"):
        expose(rig, tmp_path)
    monkeypatch.undo()
    expose(rig, tmp_path)


def test_a_spoilt_exposure_goes_black_and_shut_before_its_file_is_fetched(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def play(*_: Any) -> Any:
        bench_rig.bench_of_rig(rig).lit()
        raise SyncError("a refresh was lost", device="display")

    monkeypatch.setattr(rig.display, "play", play)
    watched = Watched(rig, monkeypatch)
    with pytest.raises(SyncError):
        expose(rig, tmp_path)
    assert watched.names == ["black", "arm", "open", "play", "black", "close", "fetch"]
    assert watched.of("close")[1] and watched.fetched[0][2] == 12.5


@pytest.mark.parametrize("last", [0, 1])
def test_the_shutter_waits_for_the_panel_that_ends_last(
    last: int, rig: Rig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    play = rig.display.play

    def ends_apart(*given: Any) -> Any:
        log = play(*given)
        log.end_ns[last] += 2_000_000_000
        return log

    monkeypatch.setattr(rig.display, "play", ends_apart)
    watched = Watched(rig, monkeypatch)
    done = expose(rig, tmp_path)
    assert watched.of("close")[0] >= int(done.log.end_ns[last]) + round(SETTLE_S * 1e9)


@pytest.mark.parametrize("open_ns", [None, 0, 5])
def test_of_a_moving_exposure_that_was_given_up_a_file_is_fetched_if_there_is_one(
    open_ns: int | None, tmp_path: Path
) -> None:
    """One that was never open has none; left in the camera, it would pass for the next one."""
    spoilt: list[tuple[object, ...]] = []

    def play(*_: object) -> None:
        raise SyncError("refreshes were missed")

    rig = SimpleNamespace(
        display=SimpleNamespace(play=play),
        _context=SimpleNamespace(shared=SimpleNamespace()),
        _take_spoilt=lambda *given: spoilt.append(given),
    )
    mover = SimpleNamespace(open_ns=open_ns, over=None, failure=None, shot="bar", notify=print)
    with pytest.raises(SyncError):
        Rig._moved(cast(Any, rig), cast(Any, mover), cast(Any, None), tmp_path)
    assert spoilt == ([] if open_ns is None else [(open_ns, tmp_path, "bar", print)])


def test_what_was_measured_of_a_camera_takes_the_place_of_what_its_driver_says(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = rig.readout.connect()
    guess = replace(said, responsivity_e=np.array([2e6, 4e6, 2.4e6]))
    monkeypatch.setattr(rig.readout, "connect", lambda: guess)
    rig.disconnect()
    rig.connect()
    assert rig.camera_info is not None
    assert rig.camera_info.responsivity_e.tolist() == [2e6, 4e6, 2.4e6]
    camera = structs.replace(rig.config.camera, responsivity_e=(3e5, 5e5, 3.5e5))
    rig.config = structs.replace(rig.config, camera=camera)
    rig.disconnect()
    rig.connect()
    assert rig.camera_info.responsivity_e.tolist() == [3e5, 5e5, 3.5e5]


@pytest.mark.parametrize("photo", [None, "photo.dng", RawFile(Path("/elsewhere/a.dng"), 1, "")])
def test_what_is_no_photo_of_this_run_is_the_cameras_fault(photo: Any, tmp_path: Path) -> None:
    with pytest.raises(ExposureError, match="no photo of this run") as told:
        keep_photo(photo, tmp_path / "a.dng", "Acme", "7")
    assert told.value.device == "camera" and "PhotoFrame" in str(told.value.hint)


@pytest.mark.parametrize("delay", [0, -1, 2])
def test_the_lag_of_a_mask_is_seen_in_black_frames_where_the_display_does_not_tell_it(
    tmp_path: Path, delay: int
) -> None:
    """As the mock knows it: its vblanks, what was measured of its light, and the delay."""
    config = bench_rig.config(
        tmp_path,
        display=DisplayConfig(mask_delay_refreshes=delay),
        mask=PanelConfig(size_px=(1600, 1200), phase_s=0.004, skew_s=0.0031),
    )
    rig = Rig(config)
    told = rig.display.connect()
    silent = replace(told, mask_lag_s=None)
    rig.display.connect = lambda: silent  # type: ignore[method-assign]
    assert rig.mask_lag_s() == pytest.approx(told.mask_lag_s, abs=1e-6)
    structs.force_setattr(config.mask, "skew_s", 0.0)
    assert rig.mask_lag_s() is None, "nobody measured when the mask's light comes"
    drifting = bench_rig.config(
        tmp_path,
        mask=PanelConfig(size_px=(1600, 1200), refresh_hz=59.0, skew_s=0.0031),
    )
    assert Rig(drifting).mask_lag_s() is None
