"""`pdcd init` at a bench: from nothing to a photo, without a configuration that anybody edited."""

from __future__ import annotations

import io
import os
import pty
import select
import threading
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from drivers.genicam import aravis
from drivers.ptp import usb_port
from drivers.serial_shutter import look
from drivers.virtual_camera import VirtualUsb
from pdcd.bench.config import load_config
from pdcd.calibration.light import metering
from pdcd.capture.engine import Engine
from pdcd.cli.main import main
from pdcd.protocol.request import CaptureRequest
from tests import whole_rig
from tests.tools import needs
from tests.unit.setup import bench_facts
from tests.xserver import QUARTER, XServer, hurry, run

BENCH = (1920, 1080), (1600, 1200)
"""A projector of full HD, before a mask of four by three."""
SMALL = (480, 270), QUARTER[1]
"""A quarter of that, which the processor draws in time."""


class Adapter(NamedTuple):
    """A serial adapter: its port, and the far end of its wire."""

    port: str
    far: int


class Terminal(io.StringIO):
    """Somebody who types these lines."""

    def __init__(self, *lines: str) -> None:
        super().__init__("".join(f"{line}\n" for line in lines))

    def isatty(self) -> bool:
        return True


@pytest.fixture
def adapter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Adapter]:
    """The only device of a machine: an adapter, whose far end nobody answers on."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    name = os.ttyname(theirs)
    find = usb_port.find_still_image_devices

    def find_virtual(backend: object, *wanted: Any) -> list[Any]:
        return [] if backend is None else find(backend, *wanted)

    monkeypatch.setattr(usb_port, "find_still_image_devices", find_virtual)
    monkeypatch.setattr(aravis, "list_cameras", list)
    monkeypatch.setattr(look, "list_serial_ports", lambda: (name,))
    for variable in ("XDG_CONFIG_HOME", "XDG_STATE_HOME"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    monkeypatch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")
    monkeypatch.setenv("LP_NUM_THREADS", "0")
    yield Adapter(name, ours)
    os.close(ours)
    os.close(theirs)


def photograph(folder: Path) -> None:
    """Doctor, calibration and capture, as somebody types them after `pdcd init`."""
    for device in ("display", "camera", "trigger"):
        assert main(["doctor", device]) == 0, device
    assert main(["calibrate", "geometry", "--local", "--yes"]) == 0
    captured = ["capture", "indirect", "--codes", "12", "--local", "--out", str(folder)]
    assert main(captured) == 0


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "sizes",
    [pytest.param(SMALL, marks=pytest.mark.whole), pytest.param(BENCH, marks=pytest.mark.long)],
)
def test_from_nothing_to_a_photo(
    sizes: Any,
    adapter: Adapter,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(metering, "WISHED", metering.LEAST)  # photos of a second each
    with run(*sizes, kinds=("dummy",)) as server:
        hurry(server)
        monkeypatch.setenv("DISPLAY", server.display)
        assert main(["init", "--yes", "--camera", "virtual"]) == 0
        said = " ".join(capsys.readouterr().out.split())
        assert adapter.port in said and "nothing to mend" in said
        part = f"{sizes[0][1] * 4 // 3} x {sizes[0][1]}"
        assert part in said and "pdcd calibrate geometry --local" in said
        photograph(tmp_path / "runs")
        told = capsys.readouterr().out
        assert "RMS error" in told and "passed over" not in told
        # Said again it changes nothing, and says so.
        assert main(["init", "--yes", "--camera", "virtual"]) == 0
        assert capsys.readouterr().out.count("as it was") == 3


@pytest.mark.whole
def test_what_cannot_be_seen_is_asked(
    adapter: Adapter,
    x_quarter: XServer,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    if x_quarter.kind == "xvfb":
        pytest.skip("XVFB HAS ONE OUTPUT, and two are to be told apart")
    monkeypatch.setenv("DISPLAY", x_quarter.display)
    # The outputs the other way round, by number and by name; a box, by bytes; no camera yet.
    answers = ["2", x_quarter.projector, "7", "none", "2", "command", "FF 01", "FF 00"]
    monkeypatch.setattr("sys.stdin", Terminal(*answers))
    assert main(["init"]) == 0
    printed = capsys.readouterr()
    assert "Which output is the projector?" in printed.err
    assert "type a number from 1 to 2" in printed.err
    config = load_config()
    assert config.projector.size_px == x_quarter.mask_px
    assert config.display.options["projector"] == x_quarter.mask
    assert config.trigger.options == {
        "port": adapter.port, "release": "command", "open_hex": "FF 01", "close_hex": "FF 00",
    }  # fmt: skip
    assert f"release: the box on {adapter.port}" in printed.out
    assert "plug in a camera" in printed.out
    monkeypatch.setattr("sys.stdin", Terminal())
    assert main(["init"]) == 2
    assert "give --yes" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    assert main(["init", "--out", str(tmp_path / "none")]) == 2
    assert not (tmp_path / "none").exists()


def press_as_told(far: int, usb: VirtualUsb, stop: threading.Event) -> None:
    """The box: its bytes press and let go of the camera's release."""
    while not stop.is_set():
        if select.select([far], [], [], 0.05)[0]:
            for level in os.read(far, 64).replace(b"\xff", b""):
                with usb._lock:
                    (usb.body.press if level else usb.body.release)()


@pytest.mark.whole
def test_a_box_on_the_port_opens_the_shutter(
    adapter: Adapter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("pdcd.setup.find.DRM", tmp_path)
    monkeypatch.setattr("sys.stdin", Terminal(adapter.port, "command", "FF 01", "FF 00"))
    assert main(["init", "--camera", "virtual"]) == 0
    engine, stop = Engine.from_config(load_config()), threading.Event()
    usb = whole_rig.usb_of(engine)
    box = threading.Thread(target=press_as_told, args=(adapter.far, usb, stop))
    box.start()
    try:
        engine.start()
        result = engine.capture(
            CaptureRequest(goal="white", codes=4),
            job="20260101T000000Z-0001",
            emit=lambda _: None,
            cancelled=lambda: False,
        )
        assert result.state == "done", result.error
    finally:
        engine.stop()
        stop.set()
        box.join()
    assert usb.body.shutter.opened >= 1


@pytest.mark.usefixtures("adapter")
def test_a_machine_without_panels_gets_a_mock_bench_that_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("pdcd.setup.find.DRM", tmp_path)
    old = tmp_path / "XDG_CONFIG_HOME/pdcd/pdcd.toml"
    old.parent.mkdir(parents=True)
    old.write_text("# mine\n")
    assert main(["init", "--yes"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "connect projector and mask" in said and "plug in a camera" in said
    assert "what was there is now pdcd.toml.old" in said
    assert old.with_name("pdcd.toml.old").read_text() == "# mine\n"
    assert main(["config", "check"]) == 0


@pytest.mark.usefixtures("adapter")
def test_a_user_without_a_home_says_where(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for variable in ("DISPLAY", "HOME", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr("os.getuid", lambda: 2**31 - 7)  # of no user that has a name
    monkeypatch.setattr("pdcd.setup.find.DRM", tmp_path)
    assert main(["init", "--yes"]) == 2
    assert "uid 2147483641 has no home folder for a configuration" in capsys.readouterr().err
    assert main(["init", "--yes", "--out", str(tmp_path / "made")]) == 0
    assert (tmp_path / "made" / "pdcd.toml").exists()


@needs("libusb")
@pytest.mark.usefixtures("adapter")
def test_a_desk_is_told_how_its_panels_become_a_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    facts = bench_facts.desk(cameras=(bench_facts.EOS,), notes=("no Aravis",))
    monkeypatch.setattr("pdcd.cli.init.find_bench_facts", lambda _: facts)
    monkeypatch.setattr("pdcd.setup.propose.SERVER", ":4711")  # never that of a bench
    assert main(["init", "--yes", "--out", str(tmp_path)]) == 5
    said = " ".join(capsys.readouterr().out.split())
    steps = (
        "note: no Aravis", "what goes where:", "mask: DP-1 (LM201U05, serial 77): 1600 x 1200",
        "left to do:", f"sudo sh {tmp_path}/install.sh", "disable --now display-manager",
        "camera: switch it on", "pdcd calibrate --socket /run/pdcd.sock",
    )  # fmt: skip
    at = [said.rindex(step) for step in steps]
    assert at == sorted(at)
    assert (tmp_path / "xorg.conf").is_file()


def test_an_oblong_grid_is_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "pdcd.toml"
    path.write_text("[projector]\nsize_px = [1920, 1080]\n")
    assert main(["config", "check", "--config", str(path)]) == 0
    assert "warning: cells of 48 x 64 are oblong, 30 x 22.5" in capsys.readouterr().out
