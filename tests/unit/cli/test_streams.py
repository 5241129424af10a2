"""Commands whose standard streams are closed, full, or read by nobody: no traceback, and the exit
code is that of what was done."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FULL, GONE = "/dev/full", "gone"
"""A disk without room, and a pipe whose reader has left; None is a stream that is closed."""
ASKS = {
    "works": ["config", "show"],
    "fails": ["runs", "--json", "--state-dir", "/nowhere/at/all"],
    "is wrong": ["bogus"],
}


def run(words: list[str], folder: Path, *streams: str | None) -> tuple[int, list[str]]:
    """Exit code and what came of stdin, stdout and stderr, each of which is a file where named."""
    held: list[int] = []
    closed = []
    for number, name in enumerate(streams):
        if name is None:
            closed.append(number)
            held.append(os.open(os.devnull, os.O_RDWR))
        elif name == GONE:
            reader, writer = os.pipe()
            os.close(reader)
            held.append(writer)
        else:
            held.append(os.open(folder / name, os.O_RDWR | os.O_CREAT))
    # Closed by the child itself, before the program begins.
    close = f"import os, sys; [os.close(number) for number in {closed}]; "
    code = close + "os.execv(sys.argv[1], sys.argv[1:])"
    command = [sys.executable, "-c", code, sys.executable, "-m", "pdcd", *words]
    done = subprocess.run(
        command, stdin=held[0], stdout=held[1], stderr=held[2], timeout=60.0, check=False
    )
    for number in held:
        os.close(number)
    files = [folder / name for name in ("out", "err")]
    return done.returncode, [each.read_text() if each.exists() else "" for each in files]


@pytest.mark.parametrize(
    ("asked", "streams"),
    [
        ("works", (None, None, None)), ("works", ("in", "out", FULL)),
        ("works", ("in", FULL, "err")), ("works", ("in", GONE, "err")),
        ("fails", (None, None, None)), ("fails", ("in", "out", None)),
        ("fails", ("in", "out", GONE)), ("fails", ("in", FULL, "err")),
        ("fails", ("in", GONE, "err")), ("fails", ("in", FULL, FULL)),
        ("is wrong", (None, None, None)), ("is wrong", ("in", GONE, GONE)),
    ],
)  # fmt: skip
def test_no_stream_ends_a_command_in_a_traceback(
    asked: str, streams: tuple[str | None, ...], tmp_path: Path
) -> None:
    code, (out, err) = run(ASKS[asked], tmp_path, *streams)
    unwritten = asked == "works" and streams[1] in (FULL, GONE)
    assert code == (5 if unwritten else 0 if asked == "works" else 2)
    assert "Traceback" not in err and "Exception ignored" not in err
    if streams[1] == "out":
        assert ("[rig]" in out) == (asked == "works")
        assert ('"kind"' in out) == (asked == "fails")
    if streams[2] == "err" and (asked != "works" or streams[1] == FULL):
        assert err.splitlines()[-1].startswith("pdcd: ") and err.count("pdcd: ") == 1
    elif streams[2] == "err":
        assert err == ""


def test_what_is_opened_never_takes_the_number_of_a_stream(tmp_path: Path) -> None:
    """A photo on the mock bench, with nothing open at all: nothing is written into its files."""
    words = ["capture", "white", "--local", "--out", str(tmp_path / "runs")]
    code, _ = run(words, tmp_path, None, None, None)
    assert code == 0
    assert (
        run(["verify", *map(str, (tmp_path / "runs").iterdir())], tmp_path, "in", "out", "err")[0]
        == 0
    )


def test_what_stdout_has_no_letters_for_is_escaped(tmp_path: Path) -> None:
    code = (
        "from pdcd.cli.streams import *; open_missing_streams(); write_stdout('caf\\xe9 \\u03a0')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONIOENCODING": "latin-1", "PYTHONUTF8": "0"},
        capture_output=True,
        check=False,
    )
    assert done.stdout == b"caf\xe9 \\u03a0", done.stderr
