"""What `docs/protocol.md` shows is what the daemon does."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import pytest

from pdcd.bench.tables import LimitsConfig
from pdcd.protocol import messages
from pdcd.protocol.events import COMMON_FIELDS, TYPES
from pdcd.protocol.messages import CODES, METHODS
from pdcd.protocol.views import ClientRole
from pdcd.server import callers, connections, reading
from tests.places import ROOT
from tests.real_daemon import connect
from tests.real_daemon import daemon as daemon_of
from tests.tools import linked, needs, program

pytestmark = pytest.mark.whole

DOCUMENT = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")


@contextmanager
def daemon(folder: Path) -> Iterator[Path]:
    """The socket of a daemon of its own process, on the mock bench."""
    with daemon_of(folder) as (process, path):
        connect(path).close()
        yield path
        process.terminate()
        assert process.wait(60) == 0


def section(title: str) -> str:
    """The text below a heading, up to the next of the same level."""
    found = re.search(rf"^## {title}\n(.*?)(?=^## |\Z)", DOCUMENT, re.MULTILINE | re.DOTALL)
    assert found, title
    return found[1]


def fenced(title: str, language: str) -> str:
    found = re.search(rf"^```{language}\n(.*?)^```", section(title), re.MULTILINE | re.DOTALL)
    assert found, title
    return found[1]


def same_shape(shown: Any, got: Any, where: str) -> None:
    """Every field shown is there, with the same type; null stands for any."""
    if shown is None or got is None:
        return
    if isinstance(shown, dict):
        assert isinstance(got, dict), where
        for key, value in shown.items():
            assert key in got, f"{where}.{key} is missing"
            same_shape(value, got[key], f"{where}.{key}")
    elif isinstance(shown, list):
        assert isinstance(got, list), where
        assert bool(got) == bool(shown), where
        for value in got:
            same_shape(shown[0], value, f"{where}[]")
    elif isinstance(shown, float):
        assert isinstance(got, float | int), where
    else:
        assert type(got) is type(shown), where


def read(stream: BinaryIO) -> dict[str, Any]:
    message: dict[str, Any] = json.loads(stream.readline())
    return message


def test_the_session_of_the_document_can_be_replayed(tmp_path: Path) -> None:
    lines = fenced("A session", "text").splitlines()
    shown = [json.loads(line[4:]) for line in lines if line.startswith("<-- ")]
    asked = [line[4:] for line in lines if line.startswith("--> ")]
    assert len(shown) + len(asked) == len(lines)
    job = next(m["result"]["job"] for m in shown if "state" in m.get("result", {}))
    got: dict[Any, dict[str, Any]] = {}
    events: list[dict[str, Any]] = []
    with daemon(tmp_path) as path, socket.socket(socket.AF_UNIX) as sock:
        sock.settimeout(60)
        sock.connect(str(path))
        with sock.makefile("rb") as stream:
            hello = read(stream)
            real_job = job
            for line in asked:
                sock.sendall(line.replace(job, real_job).encode() + b"\n")
                while "event" == (message := read(stream)).get("method"):
                    events.append(message["params"])
                got[message["id"]] = message
                if "job" in message.get("result", {}):
                    real_job = message["result"]["job"]
    same_shape(shown[0], hello, "hello")
    assert hello["params"]["protocol"] == shown[0]["params"]["protocol"]
    answers = [message for message in shown if "id" in message]
    assert [message["id"] for message in answers] == list(got)
    for message in answers:
        same_shape(message, got[message["id"]], f"answer {message['id']}")
        if "error" in message:
            error = got[message["id"]]["error"]
            assert error["code"] == message["error"]["code"]
            assert error["data"]["kind"] == message["error"]["data"]["kind"]
        else:
            assert message["result"].get("state") == got[message["id"]]["result"].get("state")
    types = iter(event["type"] for event in events)
    for message in shown[1:]:
        if "method" in message:
            assert message["params"]["type"] in types, "events come in another order"
    by_type = {event["type"]: event for event in events}
    for message in shown[1:]:
        if "method" in message:
            same_shape(message["params"], by_type[message["params"]["type"]], "event")


@needs("bash", "socat", "jq")
def test_the_script_of_the_document_runs(tmp_path: Path) -> None:
    programs = linked(tmp_path / "bin", "socat", "jq")
    with daemon(tmp_path) as path:
        done = subprocess.run(
            [program("bash"), "-eu", "-o", "pipefail", "-c", fenced("Try it", "bash")],
            env={**os.environ, "PATH": programs, "SOCKET": str(path)},
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    assert re.fullmatch(r"pdcd \S+ is idle", first)
    assert re.fullmatch(r"\d{8}T\d{6}Z-[0-9a-f]{4} done \S+", second)


def test_every_method_and_error_is_in_its_table() -> None:
    rows = re.findall(r"^\| `([a-z.]+)` \|", section("Methods"), re.MULTILINE)
    assert rows == list(METHODS)
    kinds = re.findall(r"^\| `(\w+)` \| ([-0-9, ]+) \|", section("Errors"), re.MULTILINE)
    assert {kind for kind, _ in kinds} == set(CODES)
    for kind, codes in kinds:
        assert str(CODES[kind]) in codes.split(", ")


def test_every_role_is_that_of_the_program() -> None:
    rows = re.findall(r"^\| `([a-z.]+)` \|.*\| (\w+)[^|]* \|$", section("Methods"), re.MULTILINE)
    assert {name: ClientRole[role.upper()] for name, role in rows} == {
        name: method.role for name, method in METHODS.items()
    }


def test_every_event_and_each_of_its_fields_is_in_the_table() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \|", section("Events"), re.MULTILINE)
    told = {kind: set(re.findall(r"`(\w+)`", names)) for kind, names in rows}
    assert list(told) == list(TYPES) and len(rows) == len(told)
    for kind, names in told.items():
        assert names == set(TYPES[kind].__struct_fields__) - COMMON_FIELDS, kind
    for name in COMMON_FIELDS:
        assert f"`{name}`" in section("Events")


def test_the_python_of_the_document_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with daemon(tmp_path) as path:
        exec(fenced("Events", "python"), {"socket": path, "__name__": "example"})
    first, queued, *events, last = capsys.readouterr().out.splitlines()
    job = queued.split()[0]
    assert (first, queued.split()[1]) == ("idle", "queued")
    assert any(re.fullmatch(rf"{job} progress \d+%", line) for line in events)
    assert last == f"done ['{job}']"


def test_the_limits_are_those_of_the_program() -> None:
    text = section("Limits")
    assert messages.MAX_LINE == 2**20 and "1 MiB" in text
    assert f"| {reading.OPEN_REQUESTS} of one client, lines of 2 MiB in all" in text
    assert reading.OPEN_BYTES == 2**21 and reading._SHORT_BYTES == 2**16 and reading._REST_S == 0.1
    limits = LimitsConfig()
    assert f"| clients | {limits.connections}, or" in text
    assert f"{connections.KEPT_PLACES} places each" in text
    assert f"| clients of one user | {limits.connections_per_user}, or" in text
    assert f"and {limits.queued_per_user} of one user, or" in text
    assert f"after {limits.idle_s:g} s, or" in text
    assert f"| {messages.MAX_FDS} that no request has named; {messages.MAX_FDS} in its" in text
    assert f"| {callers.QUEUE_LINES}, 8 MiB in all;" in text and callers.QUEUE_BYTES == 2**23
    assert f"after {callers.STUCK_S:g} s" in text
    assert f"for up to {connections.LINGER_S:g} s" in section("Life of a job")
