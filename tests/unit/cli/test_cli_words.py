"""How results are put into words: plans, and ends of jobs."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from pdcd.cli.main import main
from pdcd.cli.output import WIDTH, say_result
from pdcd.protocol.plan_summary import PilotCost, PlanSummary, Prediction, ShotSummary
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, Quality
from tests.unit.cli.cli_stubs import JOB, PLAN, stub_daemon

# --- plans ----------------------------------------------------------------------------------------


def planned(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], summary: PlanSummary
) -> list[list[str]]:
    """The rows of the table of a plan."""

    class Planner(stub_daemon(monkeypatch)):  # type: ignore[misc]
        def plan(self, *unused: Any, **how: Any) -> PlanSummary:
            return summary

    monkeypatch.setattr("pdcd.cli.daemon.Client", Planner)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr("pdcd.cli.output.find_terminal_width", lambda: 200)
    assert main(["plan", "indirect"]) == 0
    lines = capsys.readouterr().out.splitlines()
    begin = max(
        len(line) - len(line.split("  ", 1)[-1].lstrip()) for line in lines if line[0] != " "
    )
    return [[line[:begin].strip(), line[begin:]] for line in lines]


@pytest.mark.parametrize(("parts", "at_once"), [(1, " at once"), (2, "")])
def test_a_plan_says_what_is_foreseen_and_why(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    parts: int,
    at_once: str,
) -> None:
    summary = msgspec.structs.replace(
        PLAN, schedule="lag", parts=parts, prior="the scene book",
        pilot_cost=PilotCost(raw_files=32, seconds=12.5, scouts=4, stopped_codes=64,
                             stopped_raw_files=6, stopped_seconds=3.25),
        reasons=("the mask lags", "cells are large"), split=("half", "rest"),
        prediction=Prediction(error=0.0125, code=0.01, sensor=0.0075, bound=0.02,
                              confidence=0.95, iso=400, prior="a matrix"),
        shots=(ShotSummary(name="white", codes=1, refreshes=3, exposure_s=0.05, light_share=1.0),
               ShotSummary(name="part", exposures=4, codes=2, refreshes=6, exposure_s=0.125,
                           light_share=0.25)),
    )  # fmt: skip
    rows = planned(monkeypatch, capsys, summary)
    assert rows[1:8] == [
        ["codes", "8 hadamard, p = 0.5"], ["cells", "48 x 64, window whole"],
        ["passes", "2, mask black after each code"],
        ["light", "25 % of a floodlit exposure, 12 times the paper's 1/48"],
        ["total", "24 refreshes, 0.500 s"], ["parts", str(parts)],
        ["RAW files", "1, and test exposures where the aperture is metered"],
    ]  # fmt: skip
    assert rows[8:] == [
        ["pilot", "32 of the codes one by one, 12.500 s, at most"],
        ["or", "ends after 4 without sharp paths: 6 RAW files, 3.250 s, 64 codes" + at_once],
        ["codes by", "the scene book"], ["why", "the mask lags"], ["", "cells are large"],
        ["split", "half"], ["", "rest"], ["RMS error", "1.25 % of the picture's RMS"],
        ["by codes", "1 %"], ["by sensor", "0.75 % at ISO 400"], ["at most", "2 % with 95 %"],
        ["prior", "a matrix"], ["shot white", "1 codes, 3 refreshes, 0.050 s"],
        ["shot part", "4 of 2 codes, 6 refreshes, 0.125 s"],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("line", "fields"),
    [
        ("transport", {"goal": "transport"}),
        ("transport --rows 12", {"goal": "transport", "rows": (12, 12)}),
        ("transport --rows 12 20 --masked", {"goal": "transport", "rows": (12, 20),
                                             "masked": True}),
        ("capture keyed --disparity 4 7", {"goal": "keyed", "disparity": (4, 7)}),
    ],
)  # fmt: skip
def test_a_row_or_a_number_typed_once_is_both(
    monkeypatch: pytest.MonkeyPatch, line: str, fields: dict[str, Any]
) -> None:
    daemon = stub_daemon(monkeypatch)
    assert main(line.split()) == 0
    assert daemon.asked[1][0] == CaptureRequest(**fields)
    assert main(["transport", "--rows", "1", "2", "3"]) == 2


# --- ends of jobs ---------------------------------------------------------------------------------


def test_all_that_is_known_of_a_photo_is_in_its_table(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    summary: dict[str, Any] = {
        "taken": "3 of 4", "decided": "pilot", "codes": 8, "refreshes": 480, "exposure_s": 8.25,
        "missed_refreshes": 2, "rms_sigma": 0.015, "sigma_kind": "?", "rms_error_quads": 0.01234,
        "transport_sigma": 0.25, "transport_error": 0.125, "predicted_error": 0.03, "wall_s": 0.125,
        "picture": "high", "quality": Quality(verdict="good"),
    }  # fmt: skip
    files = ("preview/high.png", "linear/high.tif", "preview/transport.png", "transport.npz",
             "report.html")  # fmt: skip
    result = CaptureResult(job=JOB, state="done", folder="/r", summary=summary, files=files)
    monkeypatch.setattr("pdcd.cli.output.find_terminal_width", lambda: 200)
    assert say_result(result, as_json=False) == 0
    rows = [line.split("  ", 1) for line in capsys.readouterr().out.splitlines()]
    assert [[row[0], row[1].strip()] for row in rows] == [
        ["job", JOB], ["state", "done"], ["verdict", "good"], ["taken", "3 of 4"],
        ["decided", "pilot"], ["codes", "8"], ["refreshes", "480"], ["exposure", "8.250 s"],
        ["missed refreshes", "2"], ["RMS sigma", "1.5 % of the picture"], ["error bars", "?"],
        ["RMS error", "1.23 % of quads, against the known truth"],
        ["sigma of T", "25 % of its entries' RMS"],
        ["error of T", "12.5 % against the scene's known truth"], ["predicted", "3 %"],
        ["wall time", "0.12 s"], ["folder", "/r"], ["to look at", "/r/preview/high.png"],
        ["to measure", "/r/linear/high.tif"], ["T to look at", "/r/preview/transport.png"],
        ["T", "/r/transport.npz"], ["report", "/r/report.html"],
    ]  # fmt: skip


LONG = "shot coded: 1.2 % of the field is saturated (limit 0.2 %); " + "close the aperture " * 8
EVIL = "x\npdcd: all is well\x1b[2J"
QUALITY = Quality(verdict="doubtful", reasons=(LONG, EVIL), remarks=("bars are modelled",))


def test_verdict_reasons_remarks_and_warnings(capsys: pytest.CaptureFixture[str]) -> None:
    warnings = ("shot white: 3 pixels are saturated", EVIL)
    summary: dict[str, Any] = {"codes": 8, "quality": QUALITY}
    result = CaptureResult(job="j", state="done", folder="/j", summary=summary, warnings=warnings)
    assert say_result(result, as_json=False) == 0
    shown = capsys.readouterr().out
    lines = shown.split("\n")
    assert "verdict  doubtful" in lines
    assert all(len(line) <= WIDTH and line.isprintable() for line in lines)
    joined = " ".join(line.strip() for line in lines)
    assert f"doubtful: {LONG.strip()}" in joined
    assert "remark: bars are modelled" in lines
    assert "warning: shot white: 3 pixels are saturated" in lines
    assert not any(line.startswith("pdcd:") for line in lines)
