"""The real daemon with the real engine, in real time: signals and lost clients mid-exposure."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from pdcd.bench.tables import RigConfig
from pdcd.protocol.entry import RunQuery
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import Quality
from pdcd.runs.folder import read_manifest
from tests.processes import LONG_S, soon
from tests.real_daemon import connect, daemon, last_event, wait_for_codes

pytestmark = pytest.mark.whole


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_signal_mid_exposure_ends_black_and_closed(tmp_path: Path, number: signal.Signals) -> None:
    with daemon(tmp_path, rig=RigConfig(clock="real")) as (process, socket):
        with connect(socket) as client:
            job = wait_for_codes(client)
            process.send_signal(number)
            assert process.wait(timeout=LONG_S) == 0
        event = last_event(tmp_path, job)
        assert event["event"] == "cancelled" and event["safe"] is True
        assert not list(tmp_path.rglob("capture.json"))
        assert not socket.exists()


def test_client_gone_mid_exposure_cancels_its_job(tmp_path: Path) -> None:
    with daemon(tmp_path, rig=RigConfig(clock="real")) as (_, socket):
        with connect(socket) as client:
            job = wait_for_codes(client)
        event = last_event(tmp_path, job)
        assert event["event"] == "cancelled" and event["safe"] is True
        with connect(socket) as client:
            assert soon(lambda: client.status().state == "idle")  # the log is written just before


def test_a_capture_over_the_socket_and_the_folder_it_names(tmp_path: Path) -> None:
    with daemon(tmp_path) as (process, socket):
        events: list[str] = []
        with connect(socket) as client:
            result = client.capture(
                CaptureRequest(goal="indirect", codes=64, name="a book", tags=("v",), note="n"),
                on_event=lambda e: events.append(e.type),
            )
            (found,) = client.find(RunQuery(tags=("v",))).runs
        assert result.state == "done" and result.folder is not None
        assert read_manifest(Path(result.folder)).job == result.job
        assert (found.job, found.folder, found.state) == (result.job, result.folder, "done")
        assert (found.name, found.tags, found.note) == ("a book", ("v",), "n")
        for figure in ("codes", "exposure_s", "rms_error_quads", "rms_sigma", "method"):
            assert getattr(found, figure) == result.summary[figure] is not None
        quality = result.summary["quality"]
        assert isinstance(quality, Quality) and found.verdict == quality.verdict
        wanted = [
            "queued",
            "armed",
            "shutter_open",
            "progress",
            "shutter_closed",
            "decoding",
            "done",
        ]
        assert [e for e in dict.fromkeys(events) if e in wanted] == wanted
        process.terminate()
        assert process.wait(timeout=LONG_S) == 0
