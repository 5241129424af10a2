"""Commands that start programs, or need libraries; decoding an unfinished run."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from pdcd.cli import starting
from pdcd.cli.main import main
from pdcd.extras import suggest_install
from pdcd.protocol.line_talk import UnreachableError

# --- completion -----------------------------------------------------------------------------------


def test_a_library_that_is_missing_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["completion", "bash"]) == 2
    assert f"shtab is not installed ({suggest_install('shtab')})" in capsys.readouterr().err


# --- decoding, and the configuration as it is used ------------------------------------------------


@pytest.mark.parametrize(("state", "code"), [("done", 0), ("partial", 5)])
def test_what_an_unfinished_run_has_is_made_into_pictures(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], state: str, code: int
) -> None:
    asked: list[Any] = []

    class Salvaged(dict[str, Any]):
        __getattr__ = dict.__getitem__

    found = Salvaged(state=state, taken="1 of 2", folder="/f", lost=["white", "black"])

    def salvage(folder: Path, out: Path | None, watch: Any) -> Any:
        asked.append((folder, out))
        watch.step(1.0, 2.0)
        return found

    monkeypatch.setattr("pdcd.capture.salvage.decode_partial", salvage)
    assert main(["decode", "run", "--partial", "--out", "there"]) == code
    said = capsys.readouterr()
    assert [line.split(maxsplit=1) for line in said.out.splitlines()] == [
        ["state", state], ["taken", "1 of 2"], ["folder", "/f"], ["left", "out: white"],
        ["left", "out: black"],
    ]  # fmt: skip
    assert "50 %" in said.err
    assert main(["decode", "run", "--partial", "--json"]) == code
    assert json.loads(capsys.readouterr().out) == found
    assert asked == [(Path("run"), Path("there")), (Path("run"), None)]
    assert main(["decode", "run", "--out", "there"]) == 2
    assert "--out goes with --partial" in capsys.readouterr().err


# --- a daemon that was started --------------------------------------------------------------------


class Daemon:
    """Stands in for the process of a daemon."""

    pid = 7

    def __init__(self, ended: int | None) -> None:
        self.ended = ended

    def poll(self) -> int | None:
        return self.ended


@pytest.mark.parametrize(
    ("ended", "tries"), [(None, 1), (None, 3), (1, 1)], ids=["at once", "later", "it has ended"]
)
def test_a_daemon_is_waited_for_until_it_answers_or_has_ended(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    ended: int | None,
    tries: int,
) -> None:
    daemon: Any = Daemon(ended)
    slept: list[float] = []
    count = 0

    class Client:
        """The second that answers is another daemon's."""

        def __init__(self, socket: Path) -> None:
            nonlocal count
            count += 1
            if (count < tries and count != 2) or ended is not None:
                raise UnreachableError("nobody")
            self.daemon_pid = daemon.pid if count >= tries else 8

        def close(self) -> None:
            assert self.daemon_pid == 8

    log = tmp_path / "log"
    log.write_text("it begins\nit fails")
    monkeypatch.setattr(starting, "Client", Client)
    monkeypatch.setattr(time, "sleep", slept.append)
    if ended is None:
        found = starting.connect_started(Path("s"), daemon, log, 1e9)
        assert found.daemon_pid == daemon.pid
        assert slept == [0.02] * (tries - 1) and capsys.readouterr().err == ""
    else:
        with pytest.raises(UnreachableError):
            starting.connect_started(Path("s"), daemon, log, 1e9)
        assert capsys.readouterr().err == "it begins\nit fails\n" and count == 1
