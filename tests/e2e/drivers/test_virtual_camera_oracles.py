"""libgphoto2 takes the virtual camera for a Canon EOS 450D: two versions of it, over PTP/IP.

Each client runs in a process of its own, and so does the camera.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.virtual_camera.films import make_chart_finder
from tests.places import ROOT
from tests.tools import needs, program

CLIENT_S = 60.0

cli = needs("gphoto2")
wheel = pytest.mark.skipif(
    importlib.util.find_spec("gphoto2") is None,
    reason="gphoto2 IS MISSING: see .venv/gphoto2.log",
)


class Camera:
    """The virtual camera in another process, until `report` ends it."""

    def __init__(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.virtual_eos_server"],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        assert self.process.stdout is not None
        self.port = int(self.process.stdout.readline())

    @property
    def name(self) -> str:
        return f"ptpip:127.0.0.1:{self.port}:{self.port}"

    def report(self) -> dict[str, Any]:
        out, _ = self.process.communicate(timeout=60.0)
        assert self.process.returncode == 0
        found: dict[str, Any] = json.loads(out)
        return found


@pytest.fixture
def camera() -> Iterator[Camera]:
    made = Camera()
    try:
        yield made
    finally:
        if made.process.poll() is None:
            made.process.kill()
        made.process.communicate()


def gphoto2(camera: Camera, folder: Path, *arguments: str) -> str:
    """Output of Debian's gphoto2 in an empty home."""
    done = subprocess.run(
        [program("gphoto2"), "--camera", "PTP/IP Camera", "--port", camera.name, *arguments],
        cwd=folder,
        env={**os.environ, "HOME": str(folder), "LANG": "C"},
        capture_output=True,
        text=True,
        timeout=CLIENT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def only_file(folder: Path) -> str:
    """SHA-256 of the one RAW file there."""
    (path,) = (p for p in folder.iterdir() if p.suffix.lower() == ".cr2")
    return hashlib.sha256(path.read_bytes()).hexdigest()


@cli
def test_the_command_recognises_a_450d(camera: Camera, tmp_path: Path) -> None:
    summary = gphoto2(camera, tmp_path, "--summary")
    assert "Model: Canon EOS 450D" in summary
    assert "Canon EOS Capture" in summary
    isos = gphoto2(camera, tmp_path, "--get-config", "iso")
    choices = [line.split()[-1] for line in isos.splitlines() if line.startswith("Choice:")]
    assert choices == ["Auto", "100", "200", "400", "800", "1600"]
    assert "DCIM/100CANON" in gphoto2(camera, tmp_path, "--list-files")


@pytest.mark.long
@cli
def test_the_command_takes_a_bulb_photo_to_memory(camera: Camera, tmp_path: Path) -> None:
    gphoto2(
        camera, tmp_path, "--set-config", "capturetarget=0", "--set-config", "shutterspeed=bulb",
        "--set-config", "bulb=1", "--wait-event=1s", "--set-config", "bulb=0",
        "--wait-event-and-download=3s",
    )  # fmt: skip
    told = camera.report()
    assert told["sha256"] == [only_file(tmp_path)]
    assert told["left"] == 0  # it said that the transfer is complete
    assert not told["session"]
    (seconds,) = told["seconds"]
    assert 1.0 <= seconds < 3.0  # it waits for a second at least; this machine may be slow


@pytest.mark.long
@cli
def test_the_command_takes_a_bulb_photo_to_the_card(camera: Camera, tmp_path: Path) -> None:
    out = gphoto2(
        camera, tmp_path, "--set-config", "capturetarget=1", "--set-config", "shutterspeed=bulb",
        "--capture-image-and-download", "-B", "1",
    )  # fmt: skip
    assert "/DCIM/100CANON/IMG_0001.CR2" in out
    told = camera.report()
    assert told["sha256"] == [only_file(tmp_path)]
    assert told["left"] == 0  # it deletes what it has fetched
    (seconds,) = told["seconds"]
    assert 0.95 < seconds < 3.0


WHEEL_CLIENT = """
import sys, time
import gphoto2 as gp

port, target = sys.argv[1:]
camera = gp.Camera()
abilities = gp.CameraAbilitiesList()
abilities.load()
camera.set_abilities(abilities[abilities.lookup_model("PTP/IP Camera")])
ports = gp.PortInfoList()
ports.load()
camera.set_port_info(ports[ports.lookup_path(port)])
camera.init()
print(str(camera.get_summary()).splitlines()[1])

def put(name, value):
    widget = camera.get_single_config(name)
    widget.set_value(value)
    camera.set_single_config(name, widget)

put("capturetarget", "Internal RAM")
put("iso", "400")
put("shutterspeed", "bulb")
put("bulb", 1)
time.sleep(0.7)
put("bulb", 0)
for _ in range(100):
    kind, found = camera.wait_for_event(200)
    if kind == gp.GP_EVENT_FILE_ADDED:
        camera.file_get(found.folder, found.name, gp.GP_FILE_TYPE_NORMAL).save(target)
        break
camera.exit()
"""


@pytest.mark.long
@wheel
def test_the_wheel_takes_a_bulb_photo(camera: Camera, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WHEEL_CLIENT, camera.name, str(tmp_path / "photo.cr2")],
        env={**os.environ, "HOME": str(tmp_path), "LANG": "C"},
        capture_output=True,
        text=True,
        timeout=CLIENT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Canon EOS 450D" in done.stdout
    told = camera.report()
    assert told["sha256"] == [only_file(tmp_path)]
    assert told["left"] == 0
    (seconds,) = told["seconds"]
    assert 0.7 <= seconds < 2.5


@pytest.mark.long
def test_the_command_line_serves_until_it_is_interrupted() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "pdcd", "virtual-camera", "--port", "0", "--small"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    try:
        assert process.stdout is not None
        assert "ptpip:127.0.0.1:" in process.stdout.readline()
        assert "gphoto2 --camera" in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60.0)
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
    assert process.returncode == 0
    assert errors == ""


@cli
def test_libgphoto2_sees_through_its_finder(camera: Camera, tmp_path: Path) -> None:
    gphoto2(camera, tmp_path, "--capture-preview")
    (picture,) = tmp_path.glob("*.jpg")
    assert picture.read_bytes() == make_chart_finder()()
