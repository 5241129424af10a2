"""The verdict and all warnings reach the terminal, in 80 columns, and the last JSON object."""

from __future__ import annotations

import json

import pytest

from pdcd.cli.main import main
from pdcd.cli.output import WIDTH, say_result
from pdcd.protocol.result import CaptureResult, Quality
from tests.unit.cli.cli_stubs import StubClient, home_at, stub_daemon

LONG = "shot coded: 1.2 % of the field is saturated (limit 0.2 %); " + "close the aperture " * 8
EVIL = "x\npdcd: all is well\x1b[2J"
QUALITY = Quality(verdict="doubtful", reasons=(LONG, EVIL), remarks=("bars are modelled",))
RESULT = CaptureResult(
    job="j",
    state="done",
    folder="/runs/j",
    summary={"codes": 8, "quality": QUALITY},
    warnings=("shot white: 3 pixels are saturated", EVIL),
)


def test_verdict_reasons_remarks_and_warnings(capsys: pytest.CaptureFixture[str]) -> None:
    assert say_result(RESULT, as_json=False) == 0
    shown = capsys.readouterr().out
    lines = shown.split("\n")
    assert "verdict  doubtful" in lines
    assert all(len(line) <= WIDTH and line.isprintable() for line in lines)
    joined = " ".join(line.strip() for line in lines)
    assert f"doubtful: {LONG.strip()}" in joined
    assert "remark: bars are modelled" in lines
    assert "warning: shot white: 3 pixels are saturated" in lines
    assert not any(line.startswith("pdcd:") for line in lines)


@pytest.mark.parametrize("command", [["capture", "white"], ["wait", "j"]])
def test_json_and_daemon(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: pytest.TempPathFactory,
    capsys: pytest.CaptureFixture[str],
    command: list[str],
) -> None:
    home_at(monkeypatch, tmp_path)  # type: ignore[arg-type]
    stub: type[StubClient] = stub_daemon(monkeypatch)
    monkeypatch.setattr(stub, "result", RESULT)
    assert main([*command, "--json"]) == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert last["summary"]["quality"]["verdict"] == "doubtful"
    assert last["warnings"] == list(RESULT.warnings)
    assert main(command) == 0
    assert "verdict  doubtful" in capsys.readouterr().out
