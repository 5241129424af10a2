"""The files that are written, and those that are there already."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from pdcd.bench.config import read_config
from pdcd.setup.files import make_bench_files, make_udev_rules, make_xorg_conf, write_beside
from pdcd.setup.propose import BenchProposal, suggest_bench, suggest_choices
from tests.tools import needs, program
from tests.unit.setup.bench_facts import ADAPTER, EOS, bare, desk

SH = "/bin/sh"


def made(**typed: str) -> BenchProposal:
    facts = desk(cameras=(EOS,), ports=(ADAPTER,))
    return suggest_bench(facts, suggest_choices(facts, dict(typed)))


def test_all_files_of_a_bench_that_gets_a_server(tmp_path: Path) -> None:
    folder = tmp_path / "my bench"
    folder.mkdir()
    files = make_bench_files(made(release=ADAPTER.path), folder)
    assert list(files) == ["pdcd.toml", "xorg.conf", "70-pdcd.rules", "install.sh"]
    for name, text in files.items():
        assert write_beside(folder / name, text) == "written"
    config, faults = read_config(folder / "pdcd.toml")
    assert not faults and config.trigger.driver == "serial"
    assert tomllib.loads(files["pdcd.toml"])["scene"] == {"grid": [60, 80]}
    assert subprocess.run([SH, "-n", folder / "install.sh"]).returncode == 0
    # Everything that is installed is there.
    lines = [line.split("#")[0] for line in files["install.sh"].splitlines()]
    for line in lines:
        if line.startswith("install"):
            named = subprocess.run(
                [SH, "-c", f"printf '%s\\n' {line}"], capture_output=True, text=True, check=True
            ).stdout.split("\n")
            sources = [n for n in named if n.startswith("/") and not n.startswith(("/etc", "/usr"))]
            assert sources and all(Path(source).is_file() for source in sources), line
    assert not any("display-manager" in line for line in lines), "that ends the desktop"


def test_a_bench_on_a_server_that_runs_gets_no_xorg_conf() -> None:
    facts = bare()
    files = make_bench_files(suggest_bench(facts, suggest_choices(facts, {})), Path("/x"))
    assert "xorg.conf" not in files and "xserver" not in files["install.sh"]


def test_the_server_shows_two_outputs_and_no_third() -> None:
    modes = made().modes
    assert modes is not None
    text = make_xorg_conf(modes)
    assert "$" not in text
    assert re.findall(r'Option "Monitor-(\S+)"\s+"(\w+)"', text) == [
        ("HDMI-1", "projector"), ("DP-1", "mask"), ("eDP-1", "unused"),
    ]  # fmt: skip
    assert 'Option "Position" "1920 0"' in text and "Virtual 3520 1200" in text


@pytest.mark.parametrize(
    ("serial", "found"), [("A50285BI", 1), ("", 0), ('x", RUN+="/bin/sh', 0), ("a\nb", 0)]
)
def test_the_adapter_gets_its_rule(tmp_path: Path, serial: str, found: int) -> None:
    proposal = made(release=ADAPTER.path)
    assert proposal.port is not None
    proposal.port = type(proposal.port)(ADAPTER.path, serial)
    text = make_udev_rules(proposal)
    rules = [line for line in text.splitlines() if line.startswith("ACTION") and "tty" in line]
    assert len(rules) == found and "RUN" not in text
    if rules:
        assert f'ENV{{ID_SERIAL_SHORT}}=="{serial}"' in rules[0]


@needs("udevadm verify")
def test_udev_takes_the_rules(tmp_path: Path) -> None:
    rules = tmp_path / "70-pdcd.rules"
    rules.write_text(make_udev_rules(made(release=ADAPTER.path)))
    command = [program("udevadm verify"), "verify", str(rules)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_file_that_is_there_is_kept_beside(tmp_path: Path) -> None:
    path = tmp_path / "below" / "pdcd.toml"
    assert write_beside(path, "a") == "written"
    assert write_beside(path, "a") == "as it was"
    assert write_beside(path, "b") == "written; what was there is now pdcd.toml.old"
    assert write_beside(path, "c") == "written; what was there is now pdcd.toml.old1"
    found = {file.name: file.read_text() for file in path.parent.iterdir()}
    assert found == {"pdcd.toml": "c", "pdcd.toml.old": "a", "pdcd.toml.old1": "b"}
    target = tmp_path / "elsewhere"
    target.write_text("mine")
    path.unlink()
    path.symlink_to(target)
    assert "is now pdcd.toml.old2" in write_beside(path, "d")
    assert target.read_text() == "mine" and not path.is_symlink()
