"""The units as they are, under a systemd that runs: started, used, stopped."""

from __future__ import annotations

from pdcd.protocol.request import CaptureRequest
from pdcd.runs.folder import read_manifest
from tests.running_systemd.service import CAPTURE_TOML, STATE, Line, Service


def test_a_connection_starts_the_service_and_a_capture_works_in_the_sandbox(
    service: Service,
) -> None:
    assert service.machine.shows("ActiveState") == "inactive"
    with service.connect() as client:
        result = client.capture(CaptureRequest(goal="indirect", codes=32))
    assert result.state == "done", result.error
    assert service.machine.shows("ActiveState") == "active"
    assert service.machine.shows("StatusText")
    (folder,) = service.captures()
    assert str(result.folder) == f"{STATE}/captures/{folder.name}"
    assert read_manifest(folder).job == result.job
    kept = service.machine.run("stat", "--format=%U %G %a", str(result.folder)).stdout.split()
    assert kept == ["pdcd", "pdcd", "750"]


def test_a_stop_in_an_exposure_leaves_it_dark_and_closed(service: Service, line: Line) -> None:
    service.configure(CAPTURE_TOML + line.toml)
    with service.connect() as client:
        job = service.in_exposure(client)
        line.hears("01")  # closed by the start, opened by the exposure
        service.machine.systemctl("stop", "pdcd.service")
        line.hears("0")
    assert service.machine.shows("Result") == "success"
    assert service.machine.shows("ActiveState") == "inactive"
    last = service.last_event(job)
    assert (last["event"], last["safe"]) == ("cancelled", True)
    assert not service.guardians()
