"""Who may do what, what the disk and the journal take, and an upgrade."""

from __future__ import annotations

import json
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from pdcd.protocol.request import CaptureRequest
from tests.places import ROOT
from tests.running_systemd.machine import TREE, Machine
from tests.running_systemd.service import CAPTURE_TOML, STATE, Service

SOCKET = ("--socket", "/run/pdcd.sock")
SMALL = CaptureRequest(goal="indirect", codes=32)


def test_members_of_the_group_may_and_others_may_not(service: Service) -> None:
    service.connect().close()  # started: the command line waits five seconds, no more
    done = service.cli("inside", "capture", "indirect", "--codes", "32", *SOCKET)
    assert done.returncode == 0, done.stderr
    (folder,) = service.captures()
    manifest = f"{STATE}/captures/{folder.name}/capture.json"
    assert json.loads(service.run_as("inside", "cat", manifest).stdout)["job"] == folder.name
    assert "ermission" in service.run_as("outside", "cat", manifest).stderr
    refused = service.cli("outside", "status", *SOCKET)
    assert refused.returncode and "ermission" in refused.stderr


def test_a_socket_for_all_does_not_let_all_in(service: Service) -> None:
    """The daemon asks the kernel who is at the other end."""
    service.connect().close()
    service.machine.run("chmod", "0666", "/run/pdcd.sock")
    assert service.cli("inside", "status", *SOCKET).returncode == 0
    refused = service.cli("outside", "status", *SOCKET)
    assert refused.returncode and "group" in refused.stderr


def test_a_full_disk_is_said_and_nothing_looks_finished(service: Service) -> None:
    """The disk fills up in the middle of a capture."""
    run = service.machine.run
    run("mkdir", "-p", STATE)
    run("mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", STATE)
    service.configure(CAPTURE_TOML + "[limits]\nmin_free_bytes = 0\n")
    with service.connect() as client:
        result = client.capture(SMALL)
        assert result.state == "failed" and result.error is not None
        assert result.error["kind"] == "no_space", result.error
        assert not list(service.machine.inside(STATE).rglob("capture.json"))
        run("mount", "-o", "remount,size=64m", STATE)
        again = client.capture(SMALL)
        assert again.state == "done", again.error


def test_a_new_version_finds_the_runs_of_the_old_one(service: Service) -> None:
    """The tree is replaced and the service restarted, in the middle of an exposure."""
    machine = service.machine
    with service.connect() as client:
        old = client.hello.version
        result = client.capture(SMALL)
        job = service.in_exposure(client)
        with _another_version(machine):
            machine.systemctl("restart", "pdcd.service")
            with service.connect() as new:
                assert new.hello.version == "99.0" != old
                assert new.capture(SMALL).state == "done"
            decoded = service.cli("pdcd", "decode", str(result.folder))
            assert decoded.returncode == 0, decoded.stderr
    assert service.last_event(job)["safe"] is True
    assert service.machine.shows("NRestarts") == "0"


def test_no_client_writes_lines_of_its_own_into_the_journal(service: Service) -> None:
    forged = "\npdcd[1]: forged\r\x1b[2Jforged\u2028forged"
    with service.connect() as client:
        for call in (
            {"method": f"rig.status{forged}", "params": {}},
            {"method": "capture.start", "params": {"goal": forged}},
            {"method": "capture.start", "params": {"goal": "white", "out": f"{STATE}/x{forged}"}},
            {"method": "capture.cancel", "params": {"job": forged}},
        ):
            _say(service, json.dumps({"jsonrpc": "2.0", "id": 1, **call}))
        _say(service, forged)
        assert client.status().state == "idle"
    entries = service.machine.journal_json("_SYSTEMD_UNIT=pdcd.service")
    assert entries
    for entry in entries:
        message = entry["MESSAGE"]
        assert isinstance(message, str), "journald found bytes that are no text"
        assert not message.lstrip("\r\x1b[2J").startswith(("pdcd[1]", "forged")), message
        assert message.isprintable(), message


def _say(service: Service, text: str) -> None:
    """One line on a connection of its own; waits until it was answered or hung up on."""
    with socket.socket(socket.AF_UNIX) as sock:
        sock.settimeout(30.0)
        sock.connect(str(service.machine.inside("/run/pdcd.sock")))
        with sock.makefile("rwb") as lines:
            lines.readline()  # hello
            lines.write(text.encode() + b"\n")
            lines.flush()
            lines.readline()


@contextmanager
def _another_version(machine: Machine) -> Iterator[None]:
    """The service starts from a copy of the tree that calls itself 99.0."""
    copy = machine.root / "opt/pdcd/next"
    (paths,) = machine.root.glob("opt/pdcd/.venv/lib/*/site-packages/pdcd.pth")
    before = paths.read_text()
    for name in ("pdcd", "drivers", "config"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    version = copy / "pdcd/version.py"
    version.write_text(f'{version.read_text()}\n__version__ = "99.0"\n')
    paths.write_text(before.replace(TREE, "/opt/pdcd/next"))
    try:
        yield
    finally:
        paths.write_text(before)
        shutil.rmtree(copy)
