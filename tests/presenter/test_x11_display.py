"""The contract of every display on real windows, and what this one does when things die."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.x11 import X11Display
from pdcd.bench.tables import Config, PanelConfig
from pdcd.capture.rig import Rig
from pdcd.capture.show import make_pattern_frames
from pdcd.errors import ConfigError, DeviceLost
from pdcd.panels.frames import BLACK
from pdcd.presenter.client import DisplayProcess, make_open_request
from pdcd.presenter.messages import Column
from pdcd.presenter.timing import make_random_codes
from pdcd.presenter.xgrab import RootGrabber
from pdcd.testing import DisplayContract
from tests import x11_rig
from tests.contract.test_display import GRID, frames
from tests.panel_pixels import planned, upright
from tests.xserver import QUARTER, XServer, run

pytestmark = pytest.mark.whole


@pytest.fixture(scope="class")
def started(tmp_path_factory: pytest.TempPathFactory, x_quarter: XServer) -> Iterator[Rig]:
    """One for all tests of the contract: a display process takes half a second to start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")
        rig = Rig(x11_rig.config(tmp_path_factory.mktemp("rig"), x_quarter))
        yield rig
        rig.disconnect()


@pytest.fixture
def lit(x_quarter: XServer) -> Iterator[Callable[[], bool]]:
    """Whether any pixel of the X screen is lit; answers within a millisecond."""
    grabber = RootGrabber(x_quarter.display)
    yield lambda: bool(grabber.grab().any())
    grabber.close()


class TestX11Display(DisplayContract):
    """Windows of an X server without hardware."""

    lit: Callable[[], bool]

    @pytest.fixture
    def rig(self, started: Rig, lit: Callable[[], bool]) -> Rig:
        self.lit = lit
        started.display.connect()
        return started

    def find_lit(self, rig: Rig) -> bool:
        return self.lit()


GUARD_S = 60.0
"""What would hang otherwise; it takes milliseconds when the machine is free."""

LOOK_S = 0.002
"""Between two looks at the screen: others need the processor, too."""


def pid_of(display: X11Display) -> int:
    assert display._presenter is not None
    return display._presenter.pid


def until(condition: Callable[[], bool], within_s: float) -> float | None:
    """Time until a condition held, in s; None if it did not in time."""
    begun = time.monotonic()
    while not condition():
        if time.monotonic() - begun > within_s:
            return None
        time.sleep(LOOK_S)
    return time.monotonic() - begun


def test_software_renderers_draw_on_the_thread_that_asks(
    x_quarter: XServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mesa's own threads damage memory, once in a thousand starts."""
    monkeypatch.delenv("LP_NUM_THREADS")
    display = x11_rig.display(x11_rig.config(tmp_path, x_quarter))
    display.connect()
    try:
        tasks = Path(f"/proc/{pid_of(display)}/task").glob("*/comm")
        assert not [name for task in tasks if "llvmpipe" in (name := task.read_text())]
    finally:
        display.disconnect()


def killed_in_play(display: X11Display, lit: Callable[[], bool]) -> float:
    """Kill the display process while it plays; returns for how long the panels stayed lit, in s."""
    display.load(frames(128))
    failed: list[Exception] = []

    def play() -> None:
        try:
            display.play(lambda *_: None, lambda: False)
        except DeviceLost as err:
            failed.append(err)

    thread = threading.Thread(target=play)
    thread.start()
    assert until(lit, GUARD_S) is not None
    os.kill(pid_of(display), signal.SIGKILL)
    took_s = until(lambda: not lit(), GUARD_S)
    thread.join(GUARD_S)
    assert took_s is not None
    assert failed and "signal 9" in str(failed[0])
    return took_s


def test_a_killed_presenter_leaves_black_panels_and_is_started_again(
    tmp_path: Path, x_quarter: XServer, lit: Callable[[], bool]
) -> None:
    display = x11_rig.display(x11_rig.config(tmp_path, x_quarter))
    display.connect()
    lit_s: list[float] = []
    try:
        while x11_rig.again(lit_s):
            lit_s.append(killed_in_play(display, lit))
            display.black()
            display.load(frames())
            assert len(display.play(lambda *_: None, lambda: False)) == len(frames())
    finally:
        display.disconnect()
    x11_rig.assert_dark_in_time(lit_s)


OWNER = """
import sys
from pathlib import Path
from typing import Any
from tests import x11_rig
from tests.contract.test_display import frames
from tests.xserver import XServer
import msgspec
server = msgspec.json.decode(sys.argv[2], type=XServer)
display = x11_rig.display(x11_rig.config(Path(sys.argv[1]), server))
display.connect()
display.show(frames())
sys.stdin.read()
"""


def test_a_signal_to_the_whole_service_is_not_for_the_presenter(
    tmp_path: Path, x_quarter: XServer
) -> None:
    display = x11_rig.display(x11_rig.config(tmp_path, x_quarter))
    display.connect()
    try:
        display.load(frames())
        for number in (signal.SIGTERM, signal.SIGINT):
            os.kill(pid_of(display), number)
        assert len(display.play(lambda *_: None, lambda: False)) == len(frames())
    finally:
        display.disconnect()


def owner_killed(folder: Path, server: XServer, lit: Callable[[], bool]) -> float:
    """Kill a process that holds a row; returns for how long the panels stayed lit, in s."""
    words = [str(folder), msgspec.json.encode(server).decode()]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    owner = subprocess.Popen(
        [sys.executable, "-c", OWNER, *words], stdin=subprocess.PIPE, env=environment
    )
    try:
        assert until(lit, GUARD_S) is not None
        owner.kill()
        owner.wait()
        took_s = until(lambda: not lit(), GUARD_S)
        assert took_s is not None
        return took_s
    finally:
        owner.kill()
        owner.communicate()


@pytest.mark.long
def test_panels_go_black_when_their_idle_owner_is_killed(
    tmp_path: Path, x_quarter: XServer, lit: Callable[[], bool]
) -> None:
    """While a row is held; test_daemon_killed.py does it in mid-exposure."""
    lit_s: list[float] = []
    while x11_rig.again(lit_s):
        lit_s.append(owner_killed(tmp_path, x_quarter, lit))
    x11_rig.assert_dark_in_time(lit_s)


@pytest.mark.long
def test_a_presenter_that_hangs_is_killed(tmp_path: Path, x_quarter: XServer) -> None:
    display = x11_rig.display(x11_rig.config(tmp_path, x_quarter, more={"hang_s": 0.5}))
    display.connect()
    try:
        display.load(frames(64))
        pid = pid_of(display)

        def stop(*_: int) -> None:
            os.kill(pid, signal.SIGSTOP)

        with pytest.raises(DeviceLost, match="hung"):
            display.play(stop, lambda: False)
        display.black()
        assert not x11_rig.root_pixels(x_quarter).any()
        display.load(frames())  # started anew
        assert pid_of(display) != pid
    finally:
        display.disconnect()


@pytest.mark.parametrize("call", ["load", "show"])
def test_a_stopped_presenter_is_waited_for_with_signs_of_life(
    tmp_path: Path, x_quarter: XServer, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    """The watchdog would end the daemon otherwise."""
    monkeypatch.setattr("pdcd.presenter.client.LOAD_S", 0.5)
    rig = Rig(x11_rig.config(tmp_path, x_quarter, more={"hang_s": 0.5}))
    beats: list[float] = []
    rig.pulse.heard_by = lambda: beats.append(time.monotonic())
    rig.display.connect()
    try:
        rig.display.load(frames())
        assert isinstance(rig.display, X11Display)
        os.kill(pid_of(rig.display), signal.SIGSTOP)
        begun_s = time.monotonic()
        with pytest.raises(DeviceLost, match=r"did not answer|takes no patterns"):
            getattr(rig.display, call)(frames())
        silences = np.diff([begun_s, *(b for b in beats if b > begun_s)])
        assert len(silences) >= 4 and silences.max() < 0.4
    finally:
        rig.display.disconnect()


@pytest.mark.long
def test_a_server_that_dies_is_a_lost_device(tmp_path: Path) -> None:
    with run(*QUARTER) as server:
        display = x11_rig.display(x11_rig.config(tmp_path, server))
        display.connect()
        display.load(frames(64))
        with pytest.raises(DeviceLost):
            display.play(lambda *_: os.kill(server.pid, signal.SIGKILL), lambda: False)
        with pytest.raises(DeviceLost, match="does not answer"):
            display.black()
        with pytest.raises(DeviceLost, match="does not answer"):
            display.load(frames())
        display.disconnect()


def test_an_unplugged_output_ends_the_pass_black(tmp_path: Path) -> None:
    with run(*QUARTER, kinds=("dummy",)) as server:
        display = x11_rig.display(x11_rig.config(tmp_path, server))
        display.connect()
        display.load(frames(256))
        pulled = threading.Event()

        def pull(*_: int) -> None:
            if not pulled.is_set():
                pulled.set()
                server.xrandr("--output", server.projector, "--off")

        with pytest.raises((ConfigError, DeviceLost), match=r"projector|outputs"):
            display.play(pull, lambda: False)
        assert not x11_rig.root_pixels(server).any()
        display.disconnect()


@pytest.mark.parametrize(
    ("more", "tables", "message"),
    [
        ({"allow_software": False}, {}, "renderer is software"),
        ({}, {"projector": PanelConfig(size_px=(640, 480))}, "not 640 x 480|do not lie"),
        ({"time_source": "present-complete"}, {}, "no vblank"),
        ({"display": ":4711"}, {}, "does not answer"),
    ],
)
def test_what_does_not_fit_is_refused(
    tmp_path: Path,
    x_quarter: XServer,
    more: dict[str, Any],
    tables: dict[str, Any],
    message: str,
) -> None:
    display = x11_rig.display(x11_rig.config(tmp_path, x_quarter, more=more, **tables))
    with pytest.raises((ConfigError, DeviceLost), match=message):
        display.connect()
    assert not x11_rig.root_pixels(x_quarter).any()
    display.black()
    display.disconnect()


def test_levels_that_change_are_found_before_light(tmp_path: Path) -> None:
    """A night light comes while the panels are open, and the server tells nobody."""
    with run(*QUARTER, kinds=("dummy",)) as server:
        display = x11_rig.display(x11_rig.config(tmp_path, server))
        ramp = ("--output", server.mask, "--gamma")
        try:
            assert display.connect().warnings == ()
            display.load(frames())
            server.xrandr(*ramp, "1:1:1", "--brightness", "0")
            with pytest.raises(ConfigError, match="mask gamma ramp: DUMMY0: all 0"):
                display.load(frames())
            server.xrandr(*ramp, "1:1:1")
            display.load(frames())
            # After light, too: nobody knows for which part of it.
            server.xrandr(*ramp, "1:0.9:0.8", "--brightness", "0.9")
            with pytest.raises(ConfigError, match=r"green 0, .*; blue 0, "):
                display.play(lambda *_: None, lambda: False)
            server.xrandr(*ramp, "1:0.9:0.8")  # black and white as ever
            with pytest.raises(DeviceLost, match=r"the outputs have changed: .*green 0, "):
                display.load(frames())
            (told,) = display.connect().warnings
            assert "levels 0, 128, 255 come out as red 0, 128, 255; green 0, 119, 255" in told
            assert told.endswith("xrandr --output DUMMY0 --gamma 1:1:1")
            display.load(frames())
        finally:
            display.disconnect()


def test_xvfb_with_places_from_the_configuration(tmp_path: Path) -> None:
    """One output named "screen" without a refresh rate stands for both panels."""
    with run(*QUARTER, kinds=("xvfb",)) as server:
        display = x11_rig.display(x11_rig.config(tmp_path, server))
        try:
            assert display.connect().refresh_hz == pytest.approx(60.0, rel=0.02)
            shown = make_pattern_frames("checker", 0, GRID, Config())
            display.show(shown)
            projector, mask, rest = x11_rig.panels(server)
        finally:
            display.disconnect()
    assert not rest
    for found, size, is_mask in (
        (projector, server.projector_px, False),
        (mask, server.mask_px, True),
    ):
        wanted = planned(shown, 0, upright(size, mask=is_mask))
        np.testing.assert_array_equal(found, np.repeat(wanted[..., None], 3, axis=2))


@pytest.mark.long
def test_the_first_code_costs_no_more_than_the_others(tmp_path: Path, x_quarter: XServer) -> None:
    """Whatever the graphics library compiles, it has compiled when the patterns are loaded."""
    presenter = DisplayProcess(make_open_request(x11_rig.config(tmp_path, x_quarter)))
    try:
        presenter.load(make_random_codes(GRID))
        # Rows with both panels lit, all of other patterns, after one that is black.
        rows = np.append(BLACK, np.arange(1, 90, 3)).astype(np.int32)[:, None]
        log = presenter.play(rows, rows, lambda *_: None, lambda: False)
    finally:
        presenter.close()
    spent_ns = np.diff(log[:-1, Column.CPU_NS])
    # It was 5 to 10 ms of processor time against 1, however busy the machine is.
    assert spent_ns[0] < 3.0 * np.median(spent_ns[1:])
