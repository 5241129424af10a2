"""Log lines: priorities under the journal, and nobody who is quoted in one can forge another."""

from __future__ import annotations

import io
import logging
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pdcd.server import log

FORGED = "x\n<3>pdcd.server: all is lost\r\x1b[2J\x9b1m\u2028\u202e\udc80\x7f"

SAY = f"""
import logging
from pdcd.server import log
log.send_to_stderr()
speaker = logging.getLogger('x')
speaker.warning('two\\nlines')
speaker.info('more %s', {FORGED!r})
speaker.info('quoted %r', {FORGED!r})
try:
    raise RuntimeError({FORGED!r})
except RuntimeError:
    speaker.exception('it broke')
speaker.info('stack', stack_info=True)
"""


@pytest.mark.parametrize("journal", [True, False])
def test_every_record_is_a_line_of_its_own(tmp_path: Path, journal: bool) -> None:
    target = tmp_path / "log"
    target.touch()
    found = target.stat()
    environ = {**os.environ, "JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino + (not journal)}"}
    with target.open("w") as stderr:
        subprocess.run([sys.executable, "-c", SAY], env=environ, stderr=stderr, check=True)
    text = target.read_text(encoding="utf-8")
    lines = text.split("\n")
    assert lines.pop() == "" and "".join(lines).isprintable()
    own = [
        line for line in lines if not line.removeprefix("<3>").removeprefix("<6>").startswith("  ")
    ]
    assert len(own) == 5 and len(lines) > 9  # the others are of the traceback and the stack
    if journal:
        assert own[0] == r"<4>x: two\nlines"
        assert own[1].startswith(r"<6>x: more x\n<3>pdcd.server: all is lost\r\u001b[2J\u009b1m")
        assert own[3] == "<3>x: it broke"
        assert {line[:3] for line in lines} == {"<4>", "<6>", "<3>"}
        assert (
            r"<3>  <3>pdcd.server: all is lost\r\u001b[2J\u009b1m\u2028\u202e\udc80\u007f" in lines
        )
    else:
        assert not any(line.startswith("<") for line in lines)
        assert all(line[:4].isdecimal() for line in own)


@pytest.mark.parametrize(("verbose", "says"), [(False, "pr"), (True, "ipr")])
def test_a_terminal_gets_warnings_and_readiness_unless_told_otherwise(
    verbose: bool, says: str
) -> None:
    """The terminal may be that of `pdcd capture`, whose bar a line of each capture would break."""
    script = (
        f"import logging; from pdcd.server import log; log.send_to_stderr(verbose={verbose});"
        "x = logging.getLogger('x'); x.info('INFORMED'); x.warning('PROBLEM');"
        "x.info('READY', extra=log.FOR_PEOPLE)"
    )
    ours, theirs = pty.openpty()
    try:
        subprocess.run([sys.executable, "-c", script], stderr=theirs, check=True)
        shown = os.read(ours, 65536).decode()
    finally:
        os.close(ours)
        os.close(theirs)
    words = {"i": "INFORMED", "p": "PROBLEM", "r": "READY"}
    assert {key for key, word in words.items() if word in shown} == set(says)


def test_a_standard_error_that_is_no_file_is_not_the_journal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As under a test or in a notebook: lines have their time, and no priority."""
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    monkeypatch.setattr(logging, "root", logging.RootLogger(logging.WARNING))
    log.send_to_stderr()
    (handler,) = logging.root.handlers
    logging.root.handle(logging.LogRecord("x", logging.ERROR, "", 0, "lost", (), None))
    assert isinstance(handler, logging.StreamHandler)
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \S+ ERROR x: lost\n", handler.stream.getvalue())
