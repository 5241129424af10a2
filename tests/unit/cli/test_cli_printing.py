"""Texts that daemons, devices and folders give are shown, and do nothing to who reads them."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdcd.cli.main import main
from pdcd.errors import DeviceLost
from pdcd.printable import to_indented_lines, to_one_line
from pdcd.protocol.events import Event, ShotArmed, decode_event
from pdcd.protocol.line_talk import UnreachableError
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.views import OwnerView
from tests.unit.cli import cli_stubs
from tests.unit.cli.cli_stubs import JOB_VIEW, STATUS, StubClient, home_at, stub_daemon

EVIL = "x\npdcd: all is well\r\x1b[2J\x9b1m\u2028\u202e\x7f"
RESULT = CaptureResult(
    job=EVIL,
    state="failed",
    folder=f"/runs/{EVIL}",
    error={"kind": "sync", "message": EVIL, "device": EVIL, "hint": EVIL},
    summary={"codes": EVIL, "note": EVIL},
)
EVENTS: list[Event] = [
    ShotArmed(job=EVIL, seq=0, t_mono_ns=1, shot=EVIL, frames=3),
    decode_event({"job": EVIL, "seq": 1, "type": EVIL, "t_mono_ns": 2, "shot": EVIL}),
]
JOB = msgspec.structs.replace(
    JOB_VIEW, job=EVIL, goal=EVIL, folder=EVIL, owner=OwnerView(uid=1, pid=2, user=EVIL)
)


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> type[StubClient]:
    home_at(monkeypatch, tmp_path)
    stub = stub_daemon(monkeypatch)
    monkeypatch.setattr(stub, "result", RESULT)
    monkeypatch.setattr(
        stub, "status_answer", msgspec.structs.replace(STATUS, version=EVIL, running=JOB)
    )
    monkeypatch.setattr(cli_stubs, "EVENTS", EVENTS)
    monkeypatch.setattr(cli_stubs, "JOB_VIEW", JOB)
    return stub


@pytest.mark.parametrize("json_too", [[], ["--json"]])
@pytest.mark.parametrize(
    "words", ["status", "watch", "watch j", "wait j", "cancel j", "capture white"]
)
def test_a_daemon_writes_no_lines_of_its_own(
    daemon: type[StubClient], words: str, json_too: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    main([*words.split(), *json_too])
    printed = capsys.readouterr()
    shown = (printed.out + printed.err).split("\n")
    assert all(line.isprintable() for line in shown)
    assert not any(line.startswith("pdcd: all is well") for line in shown)
    assert r"x\npdcd: all is well\r\u001b[2J\u009b1m\u2028\u202e\u007f" in printed.out
    if json_too:
        told = [json.loads(line) for line in printed.out.splitlines()]
        assert EVIL in decoded(told)


def decoded(value: object) -> str:
    """All strings of a JSON value, as they are."""
    if isinstance(value, dict):
        return " ".join(map(decoded, value.values()))
    if isinstance(value, list):
        return " ".join(map(decoded, value))
    return value if isinstance(value, str) else ""


@pytest.mark.parametrize(
    "error", [DeviceLost(EVIL, device=EVIL, hint=EVIL), UnreachableError(EVIL), OSError(EVIL)]
)
def test_an_error_is_shown_with_its_further_lines_indented(
    daemon: type[StubClient],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: Exception,
) -> None:
    monkeypatch.setattr(daemon, "error", error)
    assert main(["cancel", "j"]) != 0
    first, *more, last = capsys.readouterr().err.split("\n")
    assert first.startswith("pdcd: x") and last == "" and more
    assert all(line.startswith("  ") and line.isprintable() for line in more)


@given(st.text())
def test_what_can_be_seen_stays_and_all_else_is_escaped(text: str) -> None:
    shown = to_one_line(text)
    assert shown.isprintable() and to_one_line(shown) == shown
    if text.isprintable():
        assert shown == text
    first, *more = to_indented_lines(text).split("\n")
    assert first.isprintable() and all(line[:2] == "  " and line.isprintable() for line in more)
