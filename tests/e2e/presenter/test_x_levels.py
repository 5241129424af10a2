"""What a real server tells of levels, and that the command of each finding mends it."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import Any

import pytest
from Xlib import X, Xatom

from pdcd.presenter.levels import list_level_findings
from pdcd.presenter.outputs import read_outputs
from pdcd.presenter.xconnection import close_x_connection, open_x_connection
from tests.xserver import XServer, run

NAME = "DUMMY1"


@pytest.fixture(scope="module")
def server() -> Iterator[XServer]:
    with run(kinds=("dummy",)) as server:
        yield server


@pytest.fixture
def display(server: XServer) -> Iterator[Any]:
    display = open_x_connection(server.display)
    yield display
    close_x_connection(display)


def told(display: Any) -> dict[str, tuple[str, str | None]]:
    """State and command by what was found."""
    (output,) = [o for o in read_outputs(display) if o.name == NAME]
    findings = list_level_findings(NAME, "mask", output.levels)
    return {f.what.removeprefix("mask "): (f.state, f.hint) for f in findings}


def give(display: Any, name: str, *values: int | str) -> None:
    """Write a property, as a driver would."""
    items = [display.intern_atom(v) if isinstance(v, str) else v for v in values]
    kind = Xatom.ATOM if isinstance(values[0], str) else Xatom.INTEGER
    for number in display.screen().root.xrandr_get_screen_resources_current().outputs:
        if display.xrandr_get_output_info(number, 0).name == NAME:
            display.xrandr_change_output_property(
                number, display.intern_atom(name), kind, X.PropModeReplace, (32, items)
            )
    display.sync()


@pytest.mark.parametrize(
    ("words", "state"),
    [
        (("--brightness", "0"), "fault"),
        (("--brightness", "0.9"), "fault"),
        (("--gamma", "1:0.8:0.6", "--brightness", "0.7"), "fault"),
        (("--gamma", "1.1:1.1:1.1"), "warning"),
        (("--gamma", "1:1:0.9"), "warning"),
    ],
)
def test_ramps_are_seen_and_mended(
    server: XServer, display: Any, words: tuple[str, ...], state: str
) -> None:
    server.xrandr("--output", NAME, *words)
    ((name, (found, mend)),) = told(display).items()
    assert (name, found) == ("gamma ramp", state) and mend is not None
    server.xrandr(*shlex.split(mend)[1:])
    assert told(display) == {"levels": ("good", None)}


def test_properties_are_seen_and_mended(server: XServer, display: Any) -> None:
    give(display, "Broadcast RGB", "Limited 16:235")
    give(display, "underscan", "on")
    give(display, "scaling mode", "Full")  # the mode is none that the output prefers
    give(display, "max bpc", 6)
    give(display, "CTM", 0, 1, *[0] * 6, 1 << 31, 0, *[0] * 6, 0, 1)
    give(display, "CscMatrix", *[65536, 0, 0, 0, 0] * 2, 32768, 0)
    give(display, "Border", 0, 0, 8, 8)
    found = told(display)
    assert {name: state for name, (state, _) in found.items()} == {
        "Broadcast RGB": "warning", "underscan": "fault", "scaling mode": "warning",
        "max bpc": "warning", "CTM": "fault", "CscMatrix": "fault", "Border": "fault",
    }  # fmt: skip
    for _, mend in found.values():
        assert mend is not None
        server.xrandr(*shlex.split(mend)[1:])
    assert told(display) == {"levels": ("good", None)}


def test_a_server_without_hardware_tells_nothing() -> None:
    with run(kinds=("xvfb",)) as server:
        display = open_x_connection(server.display)
        try:
            (output,) = read_outputs(display)
        finally:
            close_x_connection(display)
    assert [f.state for f in list_level_findings("screen", "mask", output.levels)] == ["unknown"]
