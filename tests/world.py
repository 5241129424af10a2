"""The world that tests live in: nobody's home, configuration, calibrations, daemon or screen.

pdcd looks for its configuration, state and socket in folders that variables name, those of the user
or those that systemd sets (`pdcd.bench.folders`). On a machine with a bench they lead to a daemon
that moves real devices, so `enter` leads them into a temporary folder: for this process and for all
that it starts. The tests' `conftest.py` enters before anything of pdcd is imported; scripts that
run captures (`tests.bench`, `tests.soak` and others) enter as well.

A worker of pytest-xdist has a world of its own inside that of the process that hands out the tests.
What a test leaves at home is removed after it (`sweep`); caches stay, for they are dear to make and
change nothing.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path

MARK = "PDCD_TEST_WORLD"
"""Variable that names the folder of the world that a process is in."""

FOLDERS = {
    "HOME": ("home", 0o700),
    "XDG_CACHE_HOME": ("cache", 0o700),
    "XDG_RUNTIME_DIR": ("run", 0o700),
    "TMPDIR": ("tmp", 0o755),  # tests of what other users may read put their files below it
}
"""Variables that lead into the world: the name of the folder there, and its mode."""

SWEPT = (".config/pdcd", ".local/state/pdcd")
"""What pdcd keeps at home."""

ABSENT = (
    # They come before the folders at home.
    "XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME",
    # What systemd tells a service: it comes before the folders of the user.
    "CONFIGURATION_DIRECTORY", "RUNTIME_DIRECTORY", "STATE_DIRECTORY", "CACHE_DIRECTORY",
    "LOGS_DIRECTORY", "NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC", "LISTEN_PID", "LISTEN_FDS",
    "LISTEN_FDNAMES", "JOURNAL_STREAM",
    # Screens that somebody may be looking at.
    "DISPLAY", "WAYLAND_DISPLAY", "XAUTHORITY",
)  # fmt: skip
"""Variables that nobody has in the world."""

PYTEST_FILES = "PYTEST_DEBUG_TEMPROOT"
"""Where pytest makes its `tmp_path`: outside, so that files of failed tests can be looked at."""


MEMORY, LEAST_FREE_BYTES = "/dev/shm", 4 << 30


def enter() -> None:
    """Lead this process and all that it starts into the world; once inside, do nothing.

    Whoever made the world removes it when its process ends.
    """
    worker, inside = os.environ.get("PYTEST_XDIST_WORKER"), os.environ.get(MARK)
    if inside and (worker is None or Path(inside).name == worker):
        return
    if inside and worker is not None:
        world, cache = Path(inside, worker), Path(os.environ["XDG_CACHE_HOME"])
        world.mkdir(0o755, exist_ok=True)
    else:
        where = _choose_disk()
        os.environ.setdefault(PYTEST_FILES, where)
        world, cache = Path(tempfile.mkdtemp(prefix="pdcd-w-", dir=where)), None
        world.chmod(0o755)
        atexit.register(_remove, world, os.getpid())
    for variable, (name, mode) in FOLDERS.items():
        (world / name).mkdir(mode, exist_ok=True)
        os.environ[variable] = str(world / name)
    if cache is not None:
        os.environ["XDG_CACHE_HOME"] = str(cache)
    for variable in ABSENT:
        os.environ.pop(variable, None)
    tempfile.tempdir = None  # as it was found before, and kept
    os.environ[MARK] = str(world)


def _choose_disk() -> str:
    """Where files of tests lie: where the caller says, else in memory where there is enough of it,
    as hundreds of runs wait for their files to be on a disk. Tests run programs that they write."""
    if "TMPDIR" in os.environ:
        return tempfile.gettempdir()
    try:
        said = os.statvfs(MEMORY)
    except OSError:
        return tempfile.gettempdir()
    roomy = said.f_bavail * said.f_frsize >= LEAST_FREE_BYTES and os.access(MEMORY, os.W_OK)
    return tempfile.gettempdir() if said.f_flag & os.ST_NOEXEC or not roomy else MEMORY


def sweep() -> None:
    """Remove what tests left of configuration, runs and calibrations at the world's home."""
    home = Path(os.environ[MARK]) / FOLDERS["HOME"][0]
    for name in SWEPT:
        if (home / name).exists():
            shutil.rmtree(home / name)


def _remove(world: Path, maker: int) -> None:
    # A child that was forked runs this as well when it ends.
    if os.getpid() == maker:
        shutil.rmtree(world, ignore_errors=True)
