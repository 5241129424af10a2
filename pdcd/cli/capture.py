"""`pdcd capture`, `pdcd plan`, `pdcd wait`: over the socket, or with the rig in this process."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Mapping
from pathlib import Path

from pdcd.api.local import local
from pdcd.api.progress import show_bar, tell_user
from pdcd.api.rows import plan_rows
from pdcd.api.signals import hold_signals, send_signals_to
from pdcd.cli.daemon import connect_daemon, find_daemon, refuse_with_local
from pdcd.cli.exits import DONE
from pdcd.cli.output import say_json, say_result, say_table
from pdcd.cli.request import collect_array_files, parse_request_options
from pdcd.protocol.line_talk import EventHandler
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.elsewhere import note_folder


def capture(args: argparse.Namespace) -> int:
    """Take a photo; the exit code says how it ended."""
    refuse_with_local(args, "socket", "detach", "queue")
    asked = parse_request_options(args)
    result = capture_photo(
        args, asked, collect_array_files(args), detach=args.detach, queue=args.queue
    )
    return say_result(result, as_json=args.json)


def capture_photo(
    args: argparse.Namespace,
    request: CaptureRequest,
    files: Mapping[str, Path],
    *,
    detach: bool = False,
    queue: bool = False,
) -> CaptureResult:
    """Take a photo in this process or over the socket, as `args` say, and show progress."""
    if args.local:
        try:
            with show_bar("planning") as on_event:
                return _capture_here(args.config, request, files, on_event)
        finally:
            if request.out is not None:
                note_folder(Path(request.out))
    # A terminated command must end its job in good order, as an interrupted one does.
    with (
        send_signals_to(signal.default_int_handler),
        show_bar() as on_event,
        connect_daemon(args, drives=True) as client,
    ):
        return client.capture(request, arrays=files, detach=detach, queue=queue, on_event=on_event)


def wait(args: argparse.Namespace) -> int:
    """Wait for the end of a job; the exit code says how it ended."""
    with show_bar() as on_event, connect_daemon(args) as client:
        result = client.wait(args.job, on_event)
    return say_result(result, as_json=args.json)


def plan(args: argparse.Namespace) -> int:
    """Print what a capture would do, without doing it."""
    summary = _plan(args, parse_request_options(args), collect_array_files(args))
    if args.json:
        say_json(summary)
        return DONE
    say_table(plan_rows(summary))
    return DONE


def _plan(
    args: argparse.Namespace, request: CaptureRequest, files: Mapping[str, Path]
) -> PlanSummary:
    """Ask the daemon, unless told to plan here; plan here too when no daemon was named or found."""
    refuse_with_local(args, "socket")
    if not args.local and args.config is None:
        # If it goes away or takes too long, do not plan here: this process may have another bench.
        client = find_daemon(args)
        if client is not None:
            with client:
                return client.plan(request, arrays=files, queue=args.queue)
    with local(args.config) as bench:
        if bench.note:
            tell_user(f"warning: {bench.note}")
        return bench.foresee(request, files)


def _capture_here(
    config: Path | None, request: CaptureRequest, files: Mapping[str, Path], on_event: EventHandler
) -> CaptureResult:
    """Run one capture with the rig in this process; panels black and shutter closed on return."""
    with hold_signals(delivers=False) as interrupted, local(config) as bench:
        return bench.take_until(interrupted, request, files, on_event, report=True)
