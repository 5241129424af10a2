"""The files of a bench: their texts from a proposal, written without losing existing files."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from string import Template

from pdcd.bench.reading import format_toml
from pdcd.errors import disk_errors
from pdcd.extras import SOURCE_ROOT
from pdcd.files.put import replace_file
from pdcd.setup.propose import BenchProposal, PanelModes

CONFIG, XORG, RULES, INSTALL = "pdcd.toml", "xorg.conf", "70-pdcd.rules", "install.sh"
_PACKAGE = Path(__file__).parents[1]
UNIT_FOLDER = next(
    folder for folder in (_PACKAGE / "_systemd", SOURCE_ROOT / "systemd") if folder.is_dir()
)
"""Folder of units and templates: in an installed wheel, else in the checkout."""
_VENV = "/opt/pdcd/.venv"
"""Where the units look for the program."""
_DEBIAN = (
    "xserver-xorg-core x11-xserver-utils xauth libgl1 libglx-mesa0 libgl1-mesa-dri libxcb-present0 "
    "libxrandr2 libxcursor1 libxinerama1 libxi6"
)
_HEAD = """\
# Made by pdcd init. The way from here: docs/bench-bringup.md; all keys: config/mock.toml.

"""


def make_bench_files(proposal: BenchProposal, folder: Path) -> dict[str, str]:
    """Texts of all files of a bench by name, to be put into `folder`."""
    files = {CONFIG: _HEAD + format_toml(proposal.tables, proposal.notes)}
    if proposal.modes is not None:
        files[XORG] = make_xorg_conf(proposal.modes)
    files[RULES] = make_udev_rules(proposal)
    files[INSTALL] = "\n".join(_install_lines(proposal, folder)) + "\n"
    return files


def make_xorg_conf(modes: PanelModes) -> str:
    """The template of the X server's configuration, filled in."""
    timings = modes.timings
    (width, height), (mask_width, mask_height) = (timing.size for timing in timings)
    told: dict[str, object] = {"width": width + mask_width, "height": max(height, mask_height)}
    for role, output, timing in zip(("projector", "mask"), modes.outputs, timings, strict=True):
        mode = f"{timing.size[0]}x{timing.size[1]}-matched"
        told |= {f"{role}_output": output.name, f"{role}_mode": mode}
        told |= {
            f"{role}_modeline": timing.to_modeline(mode),
            f"{role}_hz": f"{timing.refresh_hz:.4f}",
        }
    told["others"] = "".join(f'    Option "Monitor-{name}" "unused"\n' for name in modes.others)
    text = (UNIT_FOLDER / "xorg.conf.in").read_text(encoding="utf-8")
    return Template(text).substitute(told, mask_left=width)


def make_udev_rules(proposal: BenchProposal) -> str:
    """The shipped rules, with the line of the release's adapter filled in, if it has a serial
    number."""
    text = (UNIT_FOLDER / RULES).read_text(encoding="ascii")
    serial = proposal.port.serial if proposal.port else ""
    if not re.fullmatch(r"[\w.:-]+", serial):
        return text
    return re.sub(
        r'^#(ACTION.*ENV\{ID_SERIAL_SHORT\}==)"[^"]*"', rf'\1"{serial}"', text, flags=re.MULTILINE
    )


def _install_lines(proposal: BenchProposal, folder: Path) -> Iterator[str]:
    """The steps that need root, as a script; none of them ends a desktop."""
    here, units = shlex.quote(str(folder)), shlex.quote(str(UNIT_FOLDER))
    yield "#!/bin/sh"
    yield f"# Installs the bench of {CONFIG} as a service: read it, then say sudo sh {INSTALL}"
    yield "set -e"
    if proposal.modes is not None:
        yield f"apt-get install -y {_DEBIAN}"
    if (SOURCE_ROOT / "pyproject.toml").is_file():
        # Debian's python3 alone cannot make an environment with pip.
        yield f"python3 -m venv --without-pip {_VENV}"
        pip = f"python3 -m pip --python {_VENV}/bin/python"
        yield f"{pip} install {shlex.quote(f'{SOURCE_ROOT}[bench,plots]')}"
    else:
        yield f"# pdcd itself is expected in {_VENV}: install it there as it was installed here."
    yield f"install -Dm644 {units}/pdcd.sysusers.conf /usr/lib/sysusers.d/pdcd.conf"
    yield f"install -Dm644 -t /etc/systemd/system {units}/pdcd.service {units}/pdcd.socket"
    yield "# What is there already is kept beside it."
    yield f"install -D --backup=numbered -m644 -t /etc/pdcd {here}/{CONFIG}"
    yield f"install -D --backup=numbered -m644 -t /etc/udev/rules.d {here}/{RULES}"
    yield "udevadm control --reload && udevadm trigger"
    yield "systemd-sysusers"
    if proposal.modes is not None:
        yield f"install -D --backup=numbered -m644 -t /etc/pdcd {here}/{XORG}"
        yield f"install -Dm644 -t /etc/systemd/system {units}/pdcd-x.service"
        drop_in = "pdcd.service.d/x.conf"
        yield f"install -Dm644 {units}/{drop_in} /etc/systemd/system/{drop_in}"
    yield "systemctl daemon-reload"
    yield 'adduser "${SUDO_USER:-root}" pdcd'
    yield "systemctl enable pdcd.socket" + (" pdcd-x.service" if proposal.modes else "")


def write_beside(path: Path, text: str) -> str:
    """Write a file, and return in words what was done. An existing file that differs is kept under
    another name. Raises NoSpaceError and DiskError."""
    with disk_errors(str(path)):
        path.parent.mkdir(parents=True, exist_ok=True)
        said = "written"
        if path.is_symlink() or path.exists():
            if path.is_file() and path.read_bytes() == text.encode():
                return "as it was"
            names = (path.with_name(f"{path.name}.old{n or ''}") for n in count())
            old = next(name for name in names if not (name.is_symlink() or name.exists()))
            path.rename(old)
            said = f"written; what was there is now {old.name}"
    replace_file(path, text.encode())
    return said
