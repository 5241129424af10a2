"""Who holds a device: looked up in a made-up /proc, and in the real one."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from drivers.ptp.holders import Holder, build_node_path, describe_holders, list_holders


@pytest.fixture
def proc(tmp_path: Path) -> Path:
    node = build_node_path(1, 5)
    for pid, name, targets in (
        (7, "bash", ("/dev/pts/0",)),
        (312, "gvfsd-gphoto2", ("/dev/null", str(node))),
        (40, "pdcd", (str(node),)),
        (41, "other", (str(build_node_path(1, 6)),)),
    ):
        folder = tmp_path / str(pid) / "fd"
        folder.mkdir(parents=True)
        (tmp_path / str(pid) / "comm").write_text(f"{name}\n")
        for number, target in enumerate(targets):
            (folder / str(number)).symlink_to(target)
    (tmp_path / "999").mkdir()  # it ended between two looks
    (tmp_path / "meminfo").write_text("")
    return tmp_path


def test_those_that_hold_the_device_are_named(proc: Path) -> None:
    assert build_node_path(1, 5) == Path("/dev/bus/usb/001/005")
    found = list_holders(build_node_path(1, 5), proc)
    assert found == [Holder(40, "pdcd"), Holder(312, "gvfsd-gphoto2")]
    assert describe_holders(found, own_pid=40) == "gvfsd-gphoto2 (process 312)"


def test_a_holder_that_cannot_be_seen_is_said_to_be_there(proc: Path) -> None:
    assert "may not see" in describe_holders(list_holders(build_node_path(2, 1), proc), own_pid=40)


def test_the_kernel_tells_the_same_of_this_process(tmp_path: Path) -> None:
    path = tmp_path / "node"
    path.touch()
    with path.open():
        assert os.getpid() in [holder.pid for holder in list_holders(path.resolve())]
    assert os.getpid() not in [holder.pid for holder in list_holders(path.resolve())]


def test_processes_that_cannot_be_seen_hold_nothing(tmp_path: Path) -> None:
    node = tmp_path / "node"
    for pid in ("5", "6", "x7"):
        (tmp_path / pid / "fd").mkdir(parents=True)
        (tmp_path / pid / "fd" / "3").symlink_to(node)
    (tmp_path / "6" / "fd" / "0").touch()  # no link any more: it was closed meanwhile
    (tmp_path / "5" / "comm").write_bytes(b"caf\xe9\n")
    assert list_holders(node, tmp_path) == [Holder(5, "caf\ufffd"), Holder(6, "unknown")]
