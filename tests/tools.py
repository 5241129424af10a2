"""Programs and libraries of others that tests compare with: which, where, and from which package.

A name says little: `convert` may be a stand-in, `Xorg` a wrapper. So every program of a name on
PATH is asked what it is, and the first that answers as ours does is taken. `needs("xwd")` marks a
test that is skipped where there is none, and says why. `.ci/setup` asks by the same table:
`python -m tests.tools` prints the Debian packages that would bring what is missing; with the name
of a part (see `APART`), those of that part.
"""

from __future__ import annotations

import ctypes
import functools
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

_SYS_ADMIN = 21
"""Bit of CAP_SYS_ADMIN, which a container's root lacks."""
ANSWER_S = 30.0
"""How long a program may take to say what it is on a loaded machine."""


@dataclass(frozen=True)
class Tool:
    """One program.

    title : what people call it.
    package : the Debian package that has it.
    commands : its file names, the best first.
    question : arguments at which it says what it is and does nothing else.
    answer : pattern of a line of what it then prints, on either stream, whatever its exit status.
    folders : where to look before PATH.
    """

    title: str
    package: str
    commands: tuple[str, ...]
    question: tuple[str, ...]
    answer: str
    folders: tuple[str, ...] = ()


@dataclass(frozen=True)
class Library:
    """One shared library: it is there when the linker can load it."""

    title: str
    package: str
    soname: str


@dataclass(frozen=True)
class Module:
    """A file that another program loads, found by a pattern below `/`."""

    title: str
    package: str
    pattern: str


Thing = Tool | Library | Module


def _systemd(command: str, package: str = "systemd") -> Tool:
    return Tool(command, package, (command,), ("--version",), r"^systemd \d+")


def _versioned(command: str, package: str, answer: str) -> Tool:
    return Tool(command, package, (command,), ("--version",), answer)


THINGS: Mapping[str, Thing] = {
    # Pictures.
    "dcraw": Tool("dcraw", "dcraw", ("dcraw",), (), r'Raw photo decoder "dcraw"'),
    "exiftool": Tool("ExifTool", "libimage-exiftool-perl", ("exiftool",), ("-ver",), r"^\d+\.\d+$"),
    "imagemagick": Tool(
        "ImageMagick",
        "imagemagick",
        ("magick", "convert"),
        ("-version",),
        r"^Version: ImageMagick \d",
    ),
    # X servers without panels, their tools, and software GL to draw on them.
    "xorg": Tool(
        "Xorg",
        "xserver-xorg-core",
        ("Xorg",),
        ("-version",),
        r"^X\.Org X Server \d",
        ("/usr/lib/xorg",),  # /usr/bin/Xorg may be a wrapper that asks for a console
    ),
    "xvfb": Tool("Xvfb", "xvfb", ("Xvfb",), ("-help",), r"^-screen scrn WxHxD"),
    "xrandr": _versioned("xrandr", "x11-xserver-utils", r"^xrandr program version"),
    # Older ones try the display first, whatever they are asked.
    "xwd": Tool(
        "xwd", "x11-apps", ("xwd",), ("-version",), r"^(xwd \d|\S*xwd:\s+unable to open display)"
    ),
    "xauth": Tool("xauth", "xauth", ("xauth",), ("-V",), r"^\d+(\.\d+)+$"),
    "mcookie": _versioned("mcookie", "util-linux", r"^mcookie from util-linux"),
    "edid-decode": Tool(
        "edid-decode", "edid-decode", ("edid-decode",), ("--help",), r"EDID file to parse"
    ),
    "dummy": Module(
        "Xorg's dummy driver",
        "xserver-xorg-video-dummy",
        "usr/lib/xorg/modules/drivers/dummy_drv.so",
    ),
    "swrast": Module("Mesa's software GL", "libgl1-mesa-dri", "usr/lib/*/dri/swrast_dri.so"),
    "libGL": Library("libGL", "libgl1", "libGL.so.1"),
    "libGLX": Library("Mesa's libGLX", "libglx-mesa0", "libGLX_mesa.so.0"),
    "libxcb-present": Library("libxcb-present", "libxcb-present0", "libxcb-present.so.0"),
    "libXcursor": Library("libXcursor", "libxcursor1", "libXcursor.so.1"),
    "libXinerama": Library("libXinerama", "libxinerama1", "libXinerama.so.1"),
    "libXi": Library("libXi", "libxi6", "libXi.so.6"),
    "libXrandr": Library("libXrandr", "libxrandr2", "libXrandr.so.2"),
    # A browser for pages, and letters for it to write with.
    "chromium": _versioned("chromium", "chromium", r"^Chromium \d"),
    "DejaVu": Module(
        "the DejaVu fonts", "fonts-dejavu-core", "usr/share/fonts/truetype/dejavu/DejaVuSans.ttf"
    ),
    # Cameras: the libraries that talk to them, and the programs that the drivers are compared with.
    "libusb": Library("libusb", "libusb-1.0-0", "libusb-1.0.so.0"),
    "libaravis": Library("Aravis", "libaravis-0.8-0", "libaravis-0.8.so.0"),
    # Debian puts the version of its interface into the name.
    "arv-fake-gv-camera": Tool(
        "Aravis' camera simulator",
        "aravis-tools",
        ("arv-fake-gv-camera-0.8",),
        ("--help",),
        r"^Fake GigEVision camera\.",
    ),
    "gphoto2": _versioned("gphoto2", "gphoto2", r"^gphoto2 +\d"),
    # The daemon as a service, and a shell that talks to it.
    "systemd-analyze": _systemd("systemd-analyze"),
    "systemd-sysusers": _systemd("systemd-sysusers"),
    "systemd-socket-activate": _systemd("systemd-socket-activate"),
    # From systemd 254 on.
    "udevadm verify": Tool(
        "udevadm verify", "udev", ("udevadm",), ("verify", "--help"), r"^udevadm verify \["
    ),
    "bash": _versioned("bash", "bash", r"^GNU bash, version"),
    # Shells that complete commands, and a judge of manual pages.
    "zsh": _versioned("zsh", "zsh", r"^zsh \d"),
    "fish": _versioned("fish", "fish", r"^fish, version"),
    "mandoc": Tool("mandoc", "mandoc", ("mandoc",), ("-T", "lint"), r"^mandoc: <stdin>: "),
    "socat": Tool("socat", "socat", ("socat",), ("-V",), r"^socat version \d"),
    "git": _versioned("git", "git", r"^git version"),
    "jq": _versioned("jq", "jq", r"^jq-\d"),
    "systemd-nspawn": _systemd("systemd-nspawn", "systemd-container"),
    "debootstrap": _versioned("debootstrap", "debootstrap", r"^debootstrap \d"),
    "unshare": _versioned("unshare", "util-linux", r"^unshare from util-linux"),
    "nsenter": _versioned("nsenter", "util-linux", r"^nsenter from util-linux"),
    "setpriv": _versioned("setpriv", "util-linux", r"^setpriv from util-linux"),
}

APART: Mapping[str, tuple[str, ...]] = {
    "systemd": ("systemd-nspawn",),
    "docs": ("systemd-nspawn", "debootstrap"),
}
"""Things that only a target of its own asks for: `make test-systemd`, `make test-docs`. `.ci/setup
systemd` brings them, `.ci/setup dev` does not."""


@dataclass(frozen=True)
class Found:
    """What was found: `path` of the program or library, or "" and `why` not."""

    path: str
    why: str = ""


def search(thing: Thing, path: str | None = None, root: Path = Path("/")) -> Found:
    """Look for a thing now; `path` is searched instead of PATH, `root` instead of `/`."""
    if isinstance(thing, Tool):
        return _search_program(thing, os.environ.get("PATH", "") if path is None else path)
    if isinstance(thing, Library):
        try:
            ctypes.CDLL(thing.soname)
        except OSError as err:
            return Found("", f"it does not load: {err}")
        return Found(thing.soname)
    file = next(iter(sorted(root.glob(thing.pattern))), None)
    return Found(str(file)) if file else Found("", f"no {thing.pattern}")


@functools.cache
def find(name: str) -> Found:
    """Look for a thing of the table, once in a process."""
    return search(THINGS[name])


def missing(*names: str) -> str:
    """One sentence for each of these that is not there; "" where all are."""
    return "; ".join(
        f"{THINGS[name].title} IS MISSING: {found.why} (Debian package {THINGS[name].package})"
        for name in names
        if not (found := find(name)).path
    )


def say_why_no_container() -> str:
    """Why systemd-nspawn could start none here, whatever is installed; "" where it could."""
    if os.geteuid():
        return "NOT ROOT"
    status = Path("/proc/self/status").read_text()
    capabilities = int(re.findall(r"^CapEff:\s*(\w+)$", status, re.MULTILINE)[0], 16)
    return "" if capabilities >> _SYS_ADMIN & 1 else "NO MOUNTS (CAP_SYS_ADMIN)"


def needs(*names: str) -> pytest.MarkDecorator:
    """Mark a test that is skipped where one of these things is missing."""
    why = missing(*names)
    return pytest.mark.skipif(bool(why), reason=why or "all there")


def program(name: str) -> str:
    """Path of a program that answers as it should; skips the running test where there is none."""
    found = find(name)
    if not found.path:
        pytest.skip(missing(name))
    return found.path


def linked(folder: Path, *names: str) -> str:
    """A PATH for scripts that call these programs by name, which finds none of their stand-ins."""
    folder.mkdir()
    for name in names:
        tool = THINGS[name]
        assert isinstance(tool, Tool)
        (folder / tool.commands[0]).symlink_to(program(name))
    return os.pathsep.join([str(folder), os.environ.get("PATH", "")])


def _candidates(tool: Tool, path: str) -> Iterator[Path]:
    """Every file of one of the names that may be run, each once."""
    seen = set()
    for command in tool.commands:
        for folder in (*tool.folders, *path.split(os.pathsep)):
            file = Path(folder or ".") / command
            key = (command, file.resolve())
            if file.is_file() and os.access(file, os.X_OK) and key not in seen:
                seen.add(key)
                yield file


def _search_program(tool: Tool, path: str) -> Found:
    others = []
    for file in _candidates(tool, path):
        said = _ask(file, tool.question)
        if re.search(tool.answer, said, re.MULTILINE):
            return Found(str(file))
        first = next((line.strip() for line in said.splitlines() if line.strip()), "nothing")
        words = " ".join([str(file), *tool.question])
        others.append(f"`{words}` says {first[:100]!r}")
    return Found("", ", ".join(others) or f"no {' or '.join(tool.commands)} on PATH")


def _ask(file: Path, question: tuple[str, ...]) -> str:
    """What a program prints on both streams, or what kept it from that."""
    environ = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
    try:
        done = subprocess.run(
            [str(file), *question],
            env={**environ, "LC_ALL": "C"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=ANSWER_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {ANSWER_S:g} s"
    except OSError as err:
        return str(err)
    return done.stdout.decode(errors="replace")


def main(part: str = "dev") -> None:
    """Print the packages to install, on one line, and on the other stream what each is for.

    `part` is a name in `APART`, or "dev" for all that is in none.
    """
    apart = {name for names in APART.values() for name in names}
    names = [name for name in THINGS if name not in apart] if part == "dev" else APART[part]
    gone = [name for name in names if not find(name).path]
    for name in gone:
        sys.stderr.write(f"  {missing(name)}\n")
    sys.stdout.write(" ".join(sorted({THINGS[name].package for name in gone})) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
