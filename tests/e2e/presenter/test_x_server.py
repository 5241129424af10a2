"""The X servers that tests draw on: two outputs side by side, ended when the test ends."""

from __future__ import annotations

import os

import pytest

from tests import tools
from tests.xserver import XServer, run


def connected(server: XServer) -> dict[str, str]:
    """Output name -> geometry, as xrandr prints them."""
    found = {}
    for line in server.xrandr().splitlines():
        words = [w for w in line.split() if w != "primary"]
        if words[1:2] == ["connected"]:
            found[words[0]] = words[2]
    return found


def test_two_outputs_lie_side_by_side(x_quarter: XServer) -> None:
    if x_quarter.kind != "dummy":
        pytest.skip("Xvfb has one output only")
    assert connected(x_quarter) == {"DUMMY1": "256x192+0+0", "DUMMY0": "400x300+256+0"}


def test_the_fallback_covers_both_panels() -> None:
    with run(kinds=("xvfb",)) as server:
        assert connected(server) == {"screen": "656x300+0+0"}


def test_servers_side_by_side_do_not_share_a_display_and_end_with_the_test() -> None:
    with run() as first, run() as second:
        assert first.display != second.display
        pids = [first.pid, second.pid]
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_a_server_that_cannot_start_is_skipped_with_its_reason() -> None:
    broken = 'Section "Device"\n  Identifier "dummy"\n  Driver "no-such-driver"\nEndSection\n'
    with pytest.raises(pytest.skip.Exception, match=r"NO X SERVER.*dummy: "):
        with run(kinds=("dummy",), config=broken):
            pass


def test_no_server_at_all_is_a_loud_skip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tools, "find", lambda name: tools.Found("", f"no {name}"))
    with pytest.raises(pytest.skip.Exception, match=r"Xvfb IS MISSING: no xvfb.*xvfb"), run():
        pass
