"""`pdcd doctor display` on servers whose faults are known, and without any."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from Xlib import X

from pdcd.cli.main import main
from pdcd.presenter import examine
from pdcd.presenter.xconnection import close_x_connection, open_x_connection
from tests.xserver import XServer, run

CONFIG = """
[rig]
clock = "real"
[projector]
size_px = [256, 192]
[mask]
size_px = [400, 300]
[display]
driver = "x11"
[display.options]
projector = "{projector}"
mask = "{mask}"
display = "{display}"
allow_software = {software}
{more}
"""


def config(folder: Path, server: XServer, *, software: str = "true", **names: str) -> str:
    path = folder / "rig.toml"
    more = "positions_px = [[0, 0], [256, 0]]" if server.kind == "xvfb" else ""
    names = {"projector": server.projector, "mask": server.mask, **names}
    text = CONFIG.format(display=server.display, software=software, more=more, **names)
    path.write_text(text, encoding="utf-8")
    return str(path)


def ask(capfd: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    """Exit code, and findings by what was looked at (the last of each)."""
    code = main(["doctor", "display", "--json", *words])
    (line,) = capfd.readouterr().out.splitlines()
    answer = json.loads(line)
    assert answer["fit"] is (code == 0)
    return code, {f["what"]: f for f in answer["findings"]}


@pytest.mark.long
def test_two_panels_that_can_be_driven(
    x_quarter: XServer, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    code, found = ask(capfd, "--config", config(tmp_path, x_quarter))
    assert code == 0
    assert found["X server"]["found"].startswith(f"{x_quarter.display}: The X.Org Foundation")
    assert found["desktop"]["state"] == found["panels"]["state"] == "good"
    # The server makes its vblanks up from a clock, and reports no swap.
    assert found["time by present-msc"]["found"].endswith("proves no presentation")
    assert found["time by present-complete"]["found"] == "does not deliver"
    assert found["renderer"]["state"] == "warning"
    assert "llvmpipe" in found["renderer"]["found"]
    assert {"real time", "memory lock"} <= set(found)
    if x_quarter.kind == "dummy":
        assert found["lockstep"]["found"] == "60.0000 and 60.0000 Hz by the modes: never slip"


def test_software_that_is_not_allowed_is_to_be_mended(
    x_quarter: XServer,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # One time source will do here; those that deliver nothing take seconds to say so.
    monkeypatch.setattr(examine, "get_args", lambda _: ("clock",))
    path = config(tmp_path, x_quarter, software="false")
    assert main(["doctor", "display", "--config", path]) == 5
    out = capfd.readouterr().out
    assert "software: llvmpipe" in out
    assert out.endswith("1 to mend\n")


def test_every_fault_of_a_bad_server_is_found_at_once(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with run(kinds=("dummy",), refresh_hz=(60.0, 59.9)) as server:
        other = open_x_connection(server.display)
        window = other.screen().root.create_window(0, 0, 9, 9, 0, X.CopyFromParent)
        window.set_selection_owner(other.intern_atom("WM_S0"), X.CurrentTime)
        window.map()
        other.set_screen_saver(60, 600, X.DefaultBlanking, X.DefaultExposures)
        other.sync()
        code = main(["doctor", "display", "--config", config(tmp_path, server)])
        text = " ".join(capfd.readouterr().out.split())  # whatever lines it is in
        close_x_connection(other)
    assert code == 5
    for part in ("slip by one refresh every", "window manager", "blanks the panels after 60 s"):
        assert part in text, text
    # A window that is there may be a run's: nothing is drawn over it.
    assert "not tried: a window is on the screen" in text
    assert text.endswith("3 to mend")


def test_a_wrong_name_lists_what_there_is(
    x_quarter: XServer, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    code, found = ask(capfd, "--config", config(tmp_path, x_quarter, projector="HDMI-1"))
    assert code == 5
    assert found["panels"]["state"] == "fault"
    assert x_quarter.mask in found["panels"]["found"]
    assert found["panels"]["hint"] == "set [display.options] projector to exactly one of them"


def test_without_a_display(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    code, found = ask(capfd)
    assert code == 5
    assert found["X server"]["found"] == "no X server is named: DISPLAY is not set"
    assert found["outputs"]["state"] == "unknown"
    code, found = ask(capfd, "--display", ":4242")
    assert code == 5 and "does not answer" in found["X server"]["found"]
