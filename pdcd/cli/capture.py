"""`pdcd capture`, `pdcd plan`, `pdcd wait`: over the socket, or with the rig in this process."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Mapping
from pathlib import Path

from pdcd.api.local import local
from pdcd.api.progress import bar, tell
from pdcd.api.rows import plan_rows
from pdcd.api.signals import held_back, signals_to
from pdcd.cli.daemon import connect_daemon, daemon_if_any, refuse_with_local
from pdcd.cli.exits import DONE
from pdcd.cli.output import say_json, say_result, say_table
from pdcd.cli.request import arrays_of, request_of
from pdcd.client import OnEvent
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult


def capture(args: argparse.Namespace) -> int:
    """Take a photo; the exit code tells how it ended."""
    refuse_with_local(args, "socket", "detach", "queue")
    asked = request_of(args)
    result = take(args, asked, arrays_of(args), detach=args.detach, queue=args.queue)
    return say_result(result, as_json=args.json)


def take(
    args: argparse.Namespace,
    request: CaptureRequest,
    files: Mapping[str, Path],
    *,
    detach: bool = False,
    queue: bool = False,
) -> CaptureResult:
    """Take a photo in this process or over the socket, as `args` say, with progress shown."""
    if args.local:
        with bar("planning") as on_event:
            return _capture_here(args.config, request, files, on_event)
    # A terminated command must end its job in good order, as an interrupted one does.
    with (
        signals_to(signal.default_int_handler),
        bar() as on_event,
        connect_daemon(args) as client,
    ):
        return client.capture(request, arrays=files, detach=detach, queue=queue, on_event=on_event)


def wait(args: argparse.Namespace) -> int:
    """Wait for the end of a job; the exit code tells how it ended."""
    with bar() as on_event, connect_daemon(args) as client:
        result = client.wait(args.job, on_event)
    return say_result(result, as_json=args.json)


def plan(args: argparse.Namespace) -> int:
    """Print what a capture would do, without doing it."""
    summary = _plan(args, request_of(args), arrays_of(args))
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
        # One that goes away, or takes too long, has another bench than this process would plan for.
        client = daemon_if_any(args)
        if client is not None:
            with client:
                return client.plan(request, arrays=files, queue=args.queue)
    with local(args.config) as bench:
        if bench.note:
            tell(f"warning: {bench.note}")
        return bench.foresee(request, files)


def _capture_here(
    config: Path | None, request: CaptureRequest, files: Mapping[str, Path], on_event: OnEvent
) -> CaptureResult:
    """Run one capture with the rig in this process; panels black and shutter closed on return."""
    with held_back(delivers=False) as interrupted, local(config) as bench:
        return bench.take_until(interrupted, request, files, on_event, report=True)
