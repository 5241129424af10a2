"""An X server with two panels and no hardware, for tests of everything that draws.

Xorg with the `dummy` driver offers two RandR outputs with real modes, `DUMMY1` (projector, at the
left) and `DUMMY0` (mask, right of it). Where it cannot run, Xvfb stands in with one output named
`screen` that covers both and has no refresh rate. Neither has a vblank, an EDID, DPMS that darkens
anything, or page flips.

Tests take the fixtures `x_quarter` (256 x 192 and 400 x 300) and, in `tests/presenter`, `x_full`
(1024 x 768 and 1600 x 1200), one server each for the whole session, or call `run` for a server of
their own: one that is killed, whose outputs are unplugged, or whose rates differ.
"""

from __future__ import annotations

import os
import secrets
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from select import select

import pytest

from tests import tools

Size = tuple[int, int]
"""(width, height) in pixels."""

FULL: tuple[Size, Size] = ((1024, 768), (1600, 1200))
QUARTER: tuple[Size, Size] = ((256, 192), (400, 300))

NICE = -15
"""Priority of a server where it may be had, as pdcd-x.service gives it."""
START_S = 60.0
"""How long a server may take to answer on a loaded machine."""

CONFIG = """
Section "ServerFlags"
    Option "AutoAddDevices" "false"
    Option "AutoEnableDevices" "false"
    Option "AutoAddGPU" "false"
EndSection
Section "ServerLayout"
    Identifier "panels"
    Screen "both"
    Option "BlankTime" "0"
    Option "StandbyTime" "0"
    Option "SuspendTime" "0"
    Option "OffTime" "0"
EndSection
Section "Device"
    Identifier "dummy"
    Driver "dummy"
    VideoRam 262144
EndSection
Section "Monitor"
    Identifier "any"
    HorizSync 1.0-2000.0
    VertRefresh 1.0-1000.0
    Modeline {projector_mode}
    Modeline {mask_mode}
EndSection
Section "Screen"
    Identifier "both"
    Device "dummy"
    Monitor "any"
    DefaultDepth 24
    SubSection "Display"
        Depth 24
        Modes "mask"
        Virtual {width} {height}
    EndSubSection
EndSection
"""


@dataclass(frozen=True)
class XServer:
    """A running server. The projector lies at (0, 0), the mask right of it, both at the top.

    kind : "dummy" or "xvfb"
    projector, mask : RandR output names; on Xvfb both are "screen", and geometry is all there is.
    pid : process of the server, for tests that end it.
    """

    kind: str
    display: str
    pid: int
    projector_px: Size
    mask_px: Size
    projector: str
    mask: str

    @property
    def size_px(self) -> Size:
        """The whole X screen."""
        width = self.projector_px[0] + self.mask_px[0]
        return width, max(self.projector_px[1], self.mask_px[1])

    def env(self) -> dict[str, str]:
        """Environment of a program that shall draw here, with software rendering."""
        more = {
            "DISPLAY": self.display,
            "PYGLFW_LIBRARY_VARIANT": "x11",
            "LIBGL_ALWAYS_SOFTWARE": "1",
        }
        return {**os.environ, **more}

    def xrandr(self, *words: str) -> str:
        """Run xrandr here; returns what it printed."""
        command = [tools.program("xrandr"), "-d", self.display, *words]
        done = subprocess.run(command, capture_output=True, text=True, timeout=START_S)
        if done.returncode:
            raise RuntimeError(f"xrandr {' '.join(words)}: {done.stderr.strip()}")
        return done.stdout


def modeline(name: str, size: Size, refresh_hz: float) -> str:
    """A mode whose totals make 60 Hz a whole number of kHz; `refresh_hz` scales the clock.

    The clock is rounded to 1 kHz, as the server keeps it. The dummy driver takes none below
    11 MHz, so small pictures get many lines of blanking.
    """
    width, height = size
    htotal = -(-width // 8) * 8 + 80
    vtotal = -(-max(height + 8, 200_000 // htotal + 1) // 50) * 50
    clock_mhz = htotal * vtotal * refresh_hz * 1e-6
    horizontal = f"{width} {width + 16} {width + 48} {htotal}"
    vertical = f"{height} {height + 2} {height + 5} {vtotal}"
    return f'"{name}" {clock_mhz:.3f} {horizontal} {vertical}'


@contextmanager
def run(
    projector_px: Size = QUARTER[0],
    mask_px: Size = QUARTER[1],
    *,
    refresh_hz: tuple[float, float] = (60.0, 60.0),
    kinds: tuple[str, ...] = ("dummy", "xvfb"),
    more: tuple[str, ...] = (),
    config: str | None = None,
) -> Iterator[XServer]:
    """Start a server, end it on leaving. Skips the test, loudly, where none of `kinds` runs.

    `refresh_hz` are the rates of projector and mask (dummy only), `more` further arguments of the
    server, `config` an xorg.conf to use instead of this module's.
    """
    why = []
    for kind in kinds:
        with tempfile.TemporaryDirectory(prefix="pdcd-x-") as made:
            folder = Path(made)
            try:
                process, number = _launch(
                    kind, folder, projector_px, mask_px, refresh_hz, more, config
                )
            except _StartError as err:
                why.append(f"{kind}: {err}")
                continue
            try:
                server = _ready(kind, number, process.pid, projector_px, mask_px, config)
                yield server
            finally:
                _end(process)
                for path in _traces(number):
                    path.unlink(missing_ok=True)
            return
    pytest.skip("NO X SERVER, nothing that draws is tested here. " + "; ".join(why))


class _StartError(Exception):
    """A server is missing or did not come up."""


def _launch(
    kind: str,
    folder: Path,
    projector_px: Size,
    mask_px: Size,
    refresh_hz: tuple[float, float],
    more: tuple[str, ...],
    config: str | None,
) -> tuple[subprocess.Popen[bytes], int]:
    """Start one server, on a display number that no other test takes as soon as it is free."""
    width, height = projector_px[0] + mask_px[0], max(projector_px[1], mask_px[1])
    log = folder / "server.log"
    if kind == "dummy":
        text = config or CONFIG.format(
            projector_mode=modeline("projector", projector_px, refresh_hz[0]),
            mask_mode=modeline("mask", mask_px, refresh_hz[1]),
            width=width,
            height=height,
        )
        (folder / "xorg.conf").write_text(text, encoding="utf-8")
        why = tools.missing("xorg", "dummy", "xrandr")
        program = tools.find("xorg").path
        words = ["-config", str(folder / "xorg.conf"), "-configdir", str(folder / "none")]
        words += ["-logfile", str(log), "-novtswitch", "-sharevts"]
    else:
        why = tools.missing("xvfb")
        program = tools.find("xvfb").path
        words = ["-screen", "0", f"{width}x{height}x24"]
    if why:
        raise _StartError(why)
    mine, its = os.pipe()
    # The server must not outlive a test run that was killed.
    setpriv = tools.find("setpriv").path
    leash = [setpriv, "--pdeathsig", "TERM"] if setpriv else []
    words += ["-displayfd", str(its), "-nolisten", "tcp", "-noreset", "-s", "0", *more]
    with (folder / "stderr").open("wb") as stderr:
        process = subprocess.Popen(
            [*leash, program, f":{_free_number()}", *words],
            pass_fds=(its,),
            stdout=stderr,
            stderr=stderr,
        )
    os.close(its)
    try:
        # The end of the line is a write of its own, and kills a server that nobody listens to.
        answer = b""
        while not answer.endswith(b"\n") and select([mine], [], [], START_S)[0]:
            part = os.read(mine, 32)
            if not part:
                break
            answer += part
    finally:
        os.close(mine)
    if not answer.endswith(b"\n"):
        _end(process)
        raise _StartError(_complaint(log, folder / "stderr"))
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, process.pid, NICE)
    return process, int(answer)


def _free_number() -> int:
    """A number at random: tests kill servers and then look for them, while others start some."""
    while True:
        number = secrets.randbelow(9000) + 1000
        if not any(path.exists() for path in _traces(number)):
            return number


def _traces(number: int) -> tuple[Path, Path]:
    """What a server leaves behind when it is killed."""
    return Path(f"/tmp/.X{number}-lock"), Path(f"/tmp/.X11-unix/X{number}")


def _complaint(*files: Path) -> str:
    """The error lines of a server's logs, for the message of a skip."""
    lines = [
        line.strip()
        for file in files
        if file.exists()
        for line in file.read_text(encoding="utf-8", errors="replace").splitlines()
    ]
    errors = [line for line in lines if "(EE)" in line or "rror" in line]
    return " | ".join((errors or lines)[-6:]) or "gave no reason"


def _ready(
    kind: str, number: int, pid: int, projector_px: Size, mask_px: Size, config: str | None
) -> XServer:
    """Describe a server, after setting its two outputs side by side."""
    outputs = ("DUMMY1", "DUMMY0") if kind == "dummy" else ("screen", "screen")
    server = XServer(kind, f":{number}", pid, projector_px, mask_px, *outputs)
    if kind == "dummy" and config is None:
        server.xrandr("--addmode", "DUMMY1", "projector")
        left = ("--output", "DUMMY1", "--mode", "projector", "--pos", "0x0")
        right = ("--output", "DUMMY0", "--mode", "mask", "--pos", f"{projector_px[0]}x0")
        server.xrandr(*left, *right)
    return server


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the server: politely, then not."""
    process.terminate()
    try:
        process.wait(60.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def hurry(server: XServer) -> None:
    """Let the server keep time beside whatever else this machine does, where that is permitted.

    A screen's vblank comes from its hardware; without one it is a timer of the server's.
    """
    with suppress(PermissionError):
        os.sched_setscheduler(server.pid, os.SCHED_FIFO, os.sched_param(10))


@pytest.fixture(scope="session")
def x_quarter() -> Iterator[XServer]:
    """Panels of a quarter of their size, which software rendering serves at 60 Hz."""
    with run(*QUARTER) as server:
        hurry(server)
        yield server
