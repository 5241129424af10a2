"""`pdcd demo`: does the main job once, as a user would: a daemon, a request, a run folder."""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pdcd.api.progress import show_bar, tell_user
from pdcd.cli.output import say, say_result
from pdcd.cli.starting import SERVE, connect_started
from pdcd.client import Client
from pdcd.pages.report import write_report
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.folder import REPORT_FILE

_CONFIG = """\
# The default bench with a camera of 640 x 480 Bayer quads: enough to read the book.
[camera]
quads_per_cell = 10
"""
_CODES = 128
"""Number of codes, unless another is given."""
_START_S = 60.0
"""Longest time the daemon may take to get ready on a slow machine."""


def run_demo(args: argparse.Namespace) -> int:
    """Start a daemon on the mock bench, photograph its scene's indirect light, show the run."""
    folder: Path = args.out.absolute()
    with tempfile.TemporaryDirectory(prefix="pdcd-demo-") as scratch:
        socket, config = Path(scratch) / "pdcd.sock", Path(scratch) / "demo.toml"
        config.write_text(_CONFIG)
        tell_user(f"pdcd serve --config {config} --socket {socket}")
        with _daemon(socket, folder, config, Path(scratch) / "daemon.log") as client:
            request = CaptureRequest(goal="indirect", codes=args.codes or _CODES, seed=args.seed)
            tell_user(f"capture.start: indirect light, {request.codes} codes")
            with show_bar() as on_event:
                result = client.capture(request, on_event=on_event)
    code = say_result(result, as_json=False)
    if result.state == "done" and result.folder is not None:
        for name in result.files:
            say(f"  {name}")
        say("look at preview/white.png, preview/direct.png, preview/indirect.png")
        report = Path(result.folder) / REPORT_FILE
        if REPORT_FILE not in result.files:
            report = write_report(report.parent)
        say(f"all of it on one page: {report}")
    return code


@contextmanager
def _daemon(socket: Path, state: Path, config: Path, log: Path) -> Iterator[Client]:
    """A client of a daemon started for it, which is stopped at the end."""
    command = [*SERVE, "--config", str(config), "--socket", str(socket), "--state-dir", str(state)]
    with log.open("wb") as out, subprocess.Popen(command, stderr=out) as process:
        try:
            with connect_started(socket, process, log, _START_S) as client:
                yield client
        finally:
            process.terminate()
