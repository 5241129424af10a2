"""`pdcd web` as it is typed: what it prints, serves and refuses."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from pdcd.cli.main import main
from pdcd.extras import suggest_install

PATIENCE_S = 60.0


def test_without_the_extra_it_says_what_to_install(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pdcd.web.serve", None)
    assert main(["web"]) == 2
    assert f"pdcd web needs aiohttp ({suggest_install('aiohttp')})" in capsys.readouterr().err


@pytest.mark.whole
@pytest.mark.timeout(90)
def test_the_address_is_good_until_the_page_ends(tmp_path: Path) -> None:
    command = [
        sys.executable, "-m", "pdcd", "web", "--port", "0", "--socket", str(tmp_path / "none"),
        "--state-dir", str(tmp_path),
    ]  # fmt: skip
    # As where nobody asked Python to hand on at once what is printed into a pipe.
    environ = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, env=environ) as process:
        try:
            assert process.stdout is not None and process.stderr is not None
            address = process.stdout.readline().decode().strip()
            place, _, token = address.partition("#")
            for path, shown, status in (("", "", 200), ("runs", "x", 401), ("runs", token, 200)):
                wanted = urllib.request.Request(f"{place}{path}")
                wanted.add_header("Authorization", f"Bearer {shown}")
                try:
                    with urllib.request.urlopen(wanted, timeout=PATIENCE_S) as answer:
                        assert answer.status == status
                except urllib.error.HTTPError as no:
                    assert no.code == status
                    no.close()
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE_S) == 0
            said = process.stderr.read().decode()
            assert "until Ctrl-C" in said and "Traceback" not in said
        finally:
            process.kill()
