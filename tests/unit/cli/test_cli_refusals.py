"""What is typed and cannot be done: refused in words, with code 2, before anything starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.cli.main import main
from tests.unit.cli.cli_stubs import last_object, stub_daemon, stub_engine

A = "a" * 64

REFUSED = {
    # Fields of a request, in the words of its bounds.
    "capture indirect --p 1": "--p takes a number over 0 and below 1, not 1.0",
    "capture indirect --p nan": "--p takes a number over 0 and below 1, not NaN",
    "capture indirect --white-patch 0.5 1.01":
        "--white-patch takes 2 numbers from 0 to 1, not [0.5, 1.01]",
    "capture indirect --exposure 0": "--exposure takes a number over 0 and up to 3600, not 0.0",
    "capture indirect --disparity 1 2 3":
        "--disparity takes 1 or 2 whole numbers from -65536 to 65536",
    "transport --rows 1 2 3": "--rows",
    # Options that do not go together.
    "capture indirect --local --queue --socket x": "--local goes without --socket and --queue",
    "plan indirect --local --socket x": "--local goes without --socket",
    "calibrate timing lead": "no step is called 'lead' (steps are",
    "calibrate timing --marks xor": "",
    "calibrate --local --queue": "without --queue",
    "calibrate --local --socket x": "without --socket",
    "calibrate --again f timing": "--again takes no steps",
    "calibrate --again f --local": "--again takes no steps",
    "calibrate --again f --socket x": "--again takes no steps",
    **{f"calibrate {words}": "" for words in (
        "list --scene", "list x", "use", "use a b", "forget", "list --socket s",
        "use none --anew", "use none --marks xor", "forget gone --yes", "use ../x", "use gone",
    )},
    f"verify a --manifest-sha256 {A[1:]}": "64 hexadecimal digits",
    f"verify a --manifest-sha256 {A.replace('a', 'g')}": "64 hexadecimal digits",
    f"verify a a --manifest-sha256 {A}": "64 hexadecimal digits",
    # Numbers out of range.
    "show white --seconds nan": "--seconds nan is not between 0 and",
    "doctor trigger --click --seconds nan": "--seconds",
    "virtual-camera --small --port -1": "--port -1 is not between 0 and 65535",
    "snr --profile nikon": "unknown sensor profile",
    "snr --codes 0": "codes = 0",
    "snr --exposure 0": "exposure = 0",
    "snr --signal 1e9": "saturates 'modern'",
    "snr --transmission 2": "mask transmission = 2.0",
    "timing": "display: panels are looked at with the driver x11",
}  # fmt: skip
"""By what was typed: words of the message, which come after "pdcd: " in one line."""


@pytest.fixture(autouse=True)
def _here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("line", REFUSED)
def test_what_cannot_be_done_is_refused_before_anything_starts(
    line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon, engine = stub_daemon(monkeypatch), stub_engine(monkeypatch)
    for_scripts = not line.startswith(("web", "virtual-camera"))
    assert main([*line.split(), *["--json"] * for_scripts]) == 2
    assert not [asked for asked in daemon.asked if isinstance(asked, tuple)]
    assert "start" not in engine.calls
    printed = capsys.readouterr()
    assert printed.err.startswith("pdcd: ") and REFUSED[line] in printed.err
    if for_scripts:
        error = last_object(printed.out)["error"]
        assert error["kind"] in ("config", "request") and error["message"] in printed.err
