"""The kernel's vblank counters in the display process: over a fake kernel, without any, and, on a
bench, on real cards."""

from __future__ import annotations

import errno
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from Xlib import X, Xatom

from pdcd.errors import ConfigError
from pdcd.presenter import drm, examine
from pdcd.presenter.drm import Counter, read_routes
from pdcd.presenter.outputs import read_outputs
from pdcd.presenter.xconnection import connect, disconnect
from pdcd.presenter.xpresent import KIND_MSC
from tests import fake_drm_presenter, x11_rig
from tests.contract.test_display import frames
from tests.fake_drm import PERIOD_NS
from tests.fake_drm_presenter import LAG_NS, MASK, PROJECTOR
from tests.places import ROOT
from tests.xserver import XServer, run

NUMBERS = {"DUMMY1": PROJECTOR, "DUMMY0": MASK}


@pytest.fixture(scope="module")
def server() -> Iterator[XServer]:
    """A server that publishes the kernel's numbers, as the modesetting driver does."""
    with run(kinds=("dummy",)) as server:
        x11_rig.hurry(server)
        display = connect(server.display)
        name = display.intern_atom("CONNECTOR_ID")
        for output in display.screen().root.xrandr_get_screen_resources().outputs:
            number = NUMBERS.get(display.xrandr_get_output_info(output, 0).name)
            if number is not None:
                display.xrandr_change_output_property(
                    output, name, Xatom.INTEGER, X.PropModeReplace, (32, [number])
                )
        display.sync()
        yield server
        disconnect(display)


@pytest.fixture
def fake_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Display processes run over a fake kernel."""
    script = tmp_path / "python"
    module = fake_drm_presenter.__name__
    script.write_text(
        f'#!/bin/sh\nshift 3\ncd {ROOT}\nexec {sys.executable} -m {module} "$@"\n',
        encoding="utf-8",
    )
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))


def test_the_kernels_numbers_are_read_from_the_server(server: XServer) -> None:
    display = connect(server.display)
    try:
        found = {o.name: o.connector for o in read_outputs(display) if o.on}
    finally:
        disconnect(display)
    assert found == NUMBERS


@pytest.mark.usefixtures("fake_kernel")
def test_frames_are_shown_and_timed_by_the_counters(tmp_path: Path, server: XServer) -> None:
    more = {"time_source": "auto", "stalls_ms": {"30": 50.0}}
    display = x11_rig.display(x11_rig.config(tmp_path, server, more=more))
    identity = display.connect().identity
    try:
        assert identity["time source"] == "drm"
        assert identity["vblank counters"] == (
            "projector /dev/dri/card0, CRTC 41; mask /dev/dri/card0, CRTC 45"
        )
        assert identity["phase"].endswith(f"mask later by {LAG_NS * 1e-6:.2f} ms")
        display.load(frames(20))
        log = display.play(lambda *_: None, lambda: False)
    finally:
        display.disconnect()
    assert log.source == "drm" and not log.verified
    assert log.missed[31] >= 2
    assert np.median(np.diff(log.primal_ns)) == pytest.approx(1e9 / 60, rel=1e-3)
    # Stamps are the kernel's, to the nanosecond.
    assert np.all((log.primal_ns - LAG_NS) % PERIOD_NS == 0)


def test_asked_for_by_name_where_there_is_none(tmp_path: Path, x_quarter: XServer) -> None:
    display = x11_rig.display(x11_rig.config(tmp_path, x_quarter, more={"time_source": "drm"}))
    with pytest.raises(ConfigError, match="no vblank counter: ") as caught:
        display.connect()
    assert caught.value.hint


def doctor(monkeypatch: pytest.MonkeyPatch, kernel: Any) -> Any:
    monkeypatch.setattr(drm, "LINUX", kernel)
    return examine._nodes()


def test_the_doctor_tells_of_the_node(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = fake_drm_presenter.kernel()
    monkeypatch.setattr(os, "access", lambda path, mode: True)
    assert doctor(monkeypatch, kernel).state == "good"
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    found = doctor(monkeypatch, kernel)
    assert (found.state, found.found) == ("warning", "not permitted: /dev/dri/card0")
    assert "video" in found.hint
    kernel.cards.clear()
    assert doctor(monkeypatch, kernel).found == "the kernel drives no graphics card"


@pytest.mark.bench
def test_real_cards_count_their_vblanks() -> None:
    """Each CRTC that shows something: numbers, rate, and clock."""
    routes = []
    for node in drm.LINUX.nodes():
        try:
            routes += read_routes(drm.LINUX, node)
        except OSError as err:
            if err.errno not in (errno.EOPNOTSUPP, errno.EACCES):
                raise
    if not routes:
        pytest.skip("no card that shows anything may be opened")
    for route in routes:
        counter = Counter(drm.LINUX, route)
        try:
            counter.ask(0)
            assert counter.wait(KIND_MSC, 1.0)
            stamps = []
            for msc in range(counter.msc + 2, counter.msc + 62):
                counter.ask(msc)
                assert counter.wait(KIND_MSC, 1.0)
                assert counter.msc == msc
                # The first pixel's time: at most the blanking ahead of the event.
                assert abs(counter.ns - time.monotonic_ns()) < 10_000_000
                stamps.append(counter.ns)
        finally:
            counter.close()
        steps = np.diff(stamps)
        assert 4e6 < np.median(steps) < 50e6, route
        assert np.std(steps) < 1e5, route
