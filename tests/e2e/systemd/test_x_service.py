"""The X server's unit and its configuration, run as far as a machine without panels can."""

from __future__ import annotations

import os
import re
import stat
import subprocess
from pathlib import Path

import pytest

from pdcd.errors import DeviceLost
from pdcd.presenter.outputs import Output, find_pair, read_outputs
from pdcd.presenter.timings import VideoTiming
from pdcd.presenter.xconnection import close_x_connection, open_x_connection
from pdcd.setup.facts import BenchChoices, BenchFacts
from pdcd.setup.files import make_xorg_conf
from pdcd.setup.propose import suggest_bench
from tests.places import ROOT
from tests.tools import linked, needs, program
from tests.xserver import FULL, run

UNITS = ROOT / "systemd"


PROJECTOR = VideoTiming(65_000, (1024, 1048, 1184, 1344), (768, 771, 777, 806), (False, False))
MASK = VideoTiming(162_000, (1600, 1664, 1856, 2160), (1200, 1201, 1204, 1250))
"""VESA's timings of both sizes."""


def adapted() -> str:
    """The xorg.conf that is written for two such panels, for the dummy driver, which has another
    name for the card."""
    outputs = Output("DUMMY1", True, timings=(PROJECTOR,)), Output("DUMMY0", True, timings=(MASK,))
    modes = suggest_bench(BenchFacts(outputs), BenchChoices("DUMMY1", "DUMMY0")).modes
    assert modes is not None
    text = make_xorg_conf(modes)
    text = text.replace('Driver "modesetting"', 'Driver "dummy"\n    VideoRam 262144')
    # DUMMY1 has no plug that could be found connected.
    return text.replace(
        'Identifier "projector"', 'Identifier "projector"\n    Option "Enable" "true"'
    )


def unit_line(key: str) -> str:
    """The only value of a key of the unit."""
    text = (UNITS / "pdcd-x.service").read_text(encoding="utf-8")
    (value,) = re.findall(rf"^{key}=(.*)$", text, re.MULTILINE)
    return str(value)


def test_the_written_configuration_sets_matched_modes_side_by_side() -> None:
    with run(*FULL, kinds=("dummy",), config=adapted()) as server:
        display = open_x_connection(server.display)
        pair = find_pair(
            read_outputs(display), projector=("DUMMY1", FULL[0]), mask=("DUMMY0", FULL[1])
        )
        composite = display.has_extension("Composite")
        close_x_connection(display)
    assert (pair.projector.mode, pair.mask.mode) == ("1024x768-matched", "1600x1200-matched")
    assert (pair.projector.x, pair.mask.x) == (0, 1024)
    # 64.996 MHz over 1344 x 806, and VESA's own 60 Hz: apart by a refresh in 1.88 hours.
    assert pair.projector.refresh_hz == pytest.approx(60.000148, abs=1e-6)
    assert pair.mask.refresh_hz == 60.0
    assert pair.slip_s == pytest.approx(1.88 * 3600, rel=0.01)
    assert not composite, "the configuration switches it off"


def test_the_options_of_the_unit_are_options_of_the_server() -> None:
    program, number, terminal, *words = unit_line("ExecStart").split()
    assert (program, number, terminal) == ("/usr/lib/xorg/Xorg", ":7", "vt7")
    for pair in (("-config", "/etc/pdcd/xorg.conf"), ("-auth", "%t/pdcd-x/auth")):
        at = words.index(pair[0])
        assert tuple(words[at : at + 2]) == pair
        del words[at : at + 2]
    assert "none" not in words, "the background must be black when the presenter dies"
    at = words.index("-logfile")
    del words[at : at + 2]  # the fixture's own
    with run(kinds=("dummy",), more=tuple(words)) as server:
        assert server.kind == "dummy"


@needs("xauth", "mcookie")
# python-xlib leaves the socket of a refused connection to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_cookie_lets_in_and_keeps_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pdcd-x").mkdir()
    command = unit_line("ExecStartPre").replace("%t", str(tmp_path)).replace("$$", "$")
    shell, option, text = command.split(" ", 2)
    environ = {**os.environ, "PATH": linked(tmp_path / "bin", "xauth", "mcookie")}
    subprocess.run([shell, option, text.strip("'")], env=environ, check=True, timeout=20)
    cookie = tmp_path / "pdcd-x" / "auth"
    assert stat.S_IMODE(cookie.stat().st_mode) == 0o640
    xauth = program("xauth")
    listed = subprocess.run(
        [xauth, "-f", cookie, "list"], capture_output=True, text=True, check=True, timeout=20
    )
    assert re.search(r":7 +MIT-MAGIC-COOKIE-1 +[0-9a-f]{32}$", listed.stdout.strip())

    with run(kinds=("xvfb",), more=("-auth", str(cookie))) as server:
        # The same cookie under the number that this server found free.
        mine = tmp_path / "mine"
        key = listed.stdout.split()[-1]
        subprocess.run([xauth, "-q", "-f", mine, "add", server.display, ".", key], check=True)
        monkeypatch.setenv("XAUTHORITY", str(mine))
        close_x_connection(open_x_connection(server.display))
        monkeypatch.setenv("XAUTHORITY", os.devnull)
        with pytest.raises(DeviceLost, match="may this user connect"):
            open_x_connection(server.display)


def test_the_daemon_looks_where_the_server_is() -> None:
    drop_in = (UNITS / "pdcd.service.d" / "x.conf").read_text(encoding="utf-8")
    assert "Environment=DISPLAY=:7\n" in drop_in
    assert "Environment=XAUTHORITY=/run/pdcd-x/auth\n" in drop_in
    assert "BindsTo=pdcd-x.service\n" in drop_in
    assert unit_line("Group") == unit_line("RuntimeDirectory").removesuffix("-x") == "pdcd"
