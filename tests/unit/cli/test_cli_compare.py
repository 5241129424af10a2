"""`pdcd compare`: what it asks for, and the table and object that it prints."""

from __future__ import annotations

from typing import Any

import pytest

from pdcd.cli.main import main
from pdcd.protocol.request import CaptureRequest
from tests.unit.cli.cli_stubs import (
    StubClient,
    ended,
    last_object,
    stub_daemon,
)


def requests(asked: list[Any]) -> list[CaptureRequest]:
    return [entry[0] for entry in asked if isinstance(entry, tuple)]


def test_all_methods_are_asked_for_over_the_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = stub_daemon(monkeypatch)
    assert (
        main(["compare", "indirect", "--pilot", "4", "--black-level", "mask", "--seed", "3"]) == 0
    )
    asked = requests(daemon.asked)
    assert [r.method for r in asked] == ["multi-image", "nayar", "coded"]
    assert [r.pilot for r in asked] == [0, 0, 4]
    assert [r.black_level for r in asked] == ["auto", "auto", "mask"]
    assert {r.seed for r in asked} == {3}


def test_json_has_an_object_for_each_method(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stub_daemon(monkeypatch)
    assert main(["compare", "direct", "--json"]) == 0
    told = last_object(capsys.readouterr().out)
    assert told["goal"] == "direct"
    assert [row["method"] for row in told["methods"]] == ["coded", "multi-image", "nayar"]
    assert told["methods"][0]["rms_error_quads"] == 0.01234
    assert told["methods"][0]["sigma_mean"] is None
    assert told["methods"][0]["folder"] == "/runs/x"


def test_the_first_failure_ends_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon: type[StubClient] = stub_daemon(monkeypatch)
    monkeypatch.setattr(daemon, "result", ended("failed", "config"))
    assert main(["compare", "white", "--json"]) == 2
    assert len(requests(daemon.asked)) == 1
    assert last_object(capsys.readouterr().out)["state"] == "failed"


def test_a_method_cannot_be_picked(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["compare", "direct", "--method", "nayar"])
    assert "--method" in capsys.readouterr().err
