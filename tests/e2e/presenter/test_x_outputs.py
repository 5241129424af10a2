"""Outputs found, refused and watched, on a real X server whose modes are known."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from Xlib import X

from pdcd.errors import ConfigError, DeviceLost
from pdcd.presenter.outputs import Output, Watcher, find_output, find_pair, read_outputs
from pdcd.presenter.xconnection import close_x_connection, open_x_connection
from tests.edid_block import block
from tests.xserver import QUARTER, XServer, run

PROJECTOR, MASK = ("DUMMY1", QUARTER[0]), ("DUMMY0", QUARTER[1])

ANSWER_S = 5.0


@pytest.fixture
def server() -> Iterator[XServer]:
    """A server of its own: these tests unplug and rotate."""
    with run(kinds=("dummy",)) as server:
        yield server


@pytest.fixture
def display(server: XServer) -> Iterator[Any]:
    display = open_x_connection(server.display)
    yield display
    close_x_connection(display)


def read(server: XServer) -> dict[str, Output]:
    display = open_x_connection(server.display)
    try:
        return {o.name: o for o in read_outputs(display)}
    finally:
        close_x_connection(display)


def give_edid(display: Any, name: str, data: bytes) -> None:
    """Write the EDID property, as a driver would."""
    resources = display.screen().root.xrandr_get_screen_resources()
    for number in resources.outputs:
        if display.xrandr_get_output_info(number, 0).name == name:
            display.xrandr_change_output_property(
                number, display.intern_atom("EDID"), 19, X.PropModeReplace, (8, data)
            )
    display.sync()


@pytest.fixture
def watcher(server: XServer) -> Iterator[Watcher]:
    display = open_x_connection(server.display)
    yield Watcher(display)
    close_x_connection(display)


def eventually(watcher: Watcher) -> bool:
    """Whether the watcher hears of something before long."""
    end = time.monotonic() + ANSWER_S
    while time.monotonic() < end:
        if watcher.changed():
            return True
        time.sleep(0.01)
    return False


def test_outputs_have_the_geometry_and_the_rate_of_their_modelines(display: Any) -> None:
    found = {o.name: o for o in read_outputs(display)}
    # 336 x 600 total pixels at 12.096 MHz, and 480 x 450 at 12.960 MHz: 60 Hz exactly.
    left = Output("DUMMY1", True, 0, 0, 256, 192, "projector", 60.0)
    right = Output("DUMMY0", True, 256, 0, 400, 300, "mask", 60.0)
    assert replace(found["DUMMY1"], levels=left.levels, timings=()) == left
    assert replace(found["DUMMY0"], levels=right.levels, timings=()) == right
    assert read_outputs(display, anew=False) == read_outputs(display)
    assert not found["DUMMY2"].connected and not found["DUMMY2"].on


def test_the_pair_is_found_by_connector(display: Any) -> None:
    pair = find_pair(read_outputs(display), projector=PROJECTOR, mask=MASK)
    assert (pair.projector.name, pair.mask.name) == ("DUMMY1", "DUMMY0")
    assert pair.refresh_hz == 60.0
    assert pair.slip_s is None


def test_the_pair_is_found_by_serial_wherever_it_is_plugged(display: Any) -> None:
    give_edid(display, "DUMMY1", block(serial="X4K700123", name="EPSON PJ"))
    give_edid(display, "DUMMY0", block(number=77, serial="MASK-7"))
    pair = find_pair(
        read_outputs(display), projector=("X4K700123", QUARTER[0]), mask=("77", QUARTER[1])
    )
    assert (pair.projector.name, pair.mask.name) == ("DUMMY1", "DUMMY0")
    with pytest.raises(ConfigError, match="DUMMY1 \\(EPSON PJ, serial X4K700123\\)"):
        find_pair(read_outputs(display), projector=("X4K7", QUARTER[0]), mask=MASK)


def test_an_output_that_is_off_is_refused(server: XServer) -> None:
    server.xrandr("--output", "DUMMY1", "--off")
    found = read(server)["DUMMY1"]
    assert found.connected and not found.on and found.refresh_hz is None
    with pytest.raises(ConfigError, match="switched off"):
        find_output((found,), "DUMMY1", "projector")


def test_overlapping_outputs_are_refused(server: XServer) -> None:
    server.xrandr("--output", "DUMMY0", "--pos", "255x0")
    with pytest.raises(ConfigError, match="same part of the screen") as caught:
        find_pair(tuple(read(server).values()), projector=PROJECTOR, mask=MASK)
    assert caught.value.hint == "xrandr --output DUMMY0 --right-of DUMMY1"


def test_rates_that_slip_too_fast_are_refused() -> None:
    # 12.960 MHz scaled to 59.924 Hz, what a reduced-blanking mode of 1600 x 1200 has.
    with run(kinds=("dummy",), refresh_hz=(60.0, 59.924)) as server:
        outputs = tuple(read(server).values())
        with pytest.raises(ConfigError, match=r"slip by one refresh every 13\.\d s"):
            find_pair(outputs, projector=PROJECTOR, mask=MASK)


def test_the_watcher_hears_of_a_change_and_of_nothing_else(
    server: XServer, watcher: Watcher
) -> None:
    assert not any(watcher.changed() for _ in range(1000))
    server.xrandr("--output", "DUMMY1", "--off")
    assert eventually(watcher)
    assert not watcher.changed()


def test_the_watcher_hears_of_a_server_that_dies(server: XServer, watcher: Watcher) -> None:
    os.kill(server.pid, signal.SIGKILL)
    with pytest.raises(DeviceLost, match="does not answer"):
        eventually(watcher)


def test_a_server_that_dies_between_questions_is_lost(server: XServer, display: Any) -> None:
    os.kill(server.pid, signal.SIGKILL)
    with pytest.raises(DeviceLost, match=server.display):
        read_outputs(display)
