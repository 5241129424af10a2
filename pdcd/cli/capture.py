"""`pdcd capture`, `pdcd plan`, `pdcd wait`: over the socket, or with the rig in this process."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Mapping
from pathlib import Path

import msgspec

from pdcd.api.local import local
from pdcd.api.progress import bar
from pdcd.api.signals import held_back, signals_to
from pdcd.bench.config import load
from pdcd.bench.folders import socket_path
from pdcd.cli.exits import DONE
from pdcd.cli.output import percent, say_json, say_result, say_table
from pdcd.client import Client, OnEvent, Unreachable
from pdcd.errors import ConfigError
from pdcd.protocol.labels import LABELS
from pdcd.protocol.request import ARRAYS, CaptureRequest, CaptureResult, PlanSummary, in_words

PAPER_SHARE = 1.0 / 48.0
"""Share of the light that the paper's codes keep: half of all cells lit, half of the others open,
through quarter windows, in one of three refreshes."""

GUARDS = {
    "none": "without guards",
    "both": "both panels black between codes",
    "lag": "mask black after each code",
    "lead": "mask black before each code",
    "tail": "mask black after each code, then both",
    "full": "with guards",
}
"""Schedules of a code, for people."""


def capture(args: argparse.Namespace) -> int:
    """Take a photo; the exit code tells how it ended."""
    refuse_with_local(args, "socket", "detach", "queue")
    asked = request_of(args, out=args.out)
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
    path = daemon_socket(args)
    # A terminated command must end its job in good order, as an interrupted one does.
    with (
        signals_to(signal.default_int_handler),
        bar() as on_event,
        Client(path) as client,
    ):
        return client.capture(request, arrays=files, detach=detach, queue=queue, on_event=on_event)


def wait(args: argparse.Namespace) -> int:
    """Wait for the end of a job; the exit code tells how it ended."""
    with bar() as on_event, Client(daemon_socket(args)) as client:
        result = client.wait(args.job, on_event)
    return say_result(result, as_json=args.json)


def plan(args: argparse.Namespace) -> int:
    """Print what a capture would do, without doing it."""
    summary = _plan(args, request_of(args, out=None), arrays_of(args))
    if args.json:
        say_json(summary)
        return DONE
    head = [
        ["goal", summary.goal],
        ["codes", f"{summary.codes} {summary.family}, p = {summary.p:g}"],
        ["cells", f"{summary.grid[0]} x {summary.grid[1]}, window {summary.window}"],
        ["passes", f"{summary.passes}, {GUARDS.get(summary.schedule, summary.schedule)}"],
        [
            "light",
            f"{100.0 * summary.light_share:.3g} % of a floodlit exposure, "
            f"{summary.light_share / PAPER_SHARE:.3g} times the paper's 1/48",
        ],
        ["total", f"{summary.refreshes} refreshes, {summary.seconds:.3f} s"],
        ["parts", str(summary.parts)],
        ["RAW files", f"{summary.raw_files}, and test exposures where the aperture is metered"],
        ["memory", f"{summary.memory_bytes / 2**20:.0f} MiB at most"],
    ]
    cost = summary.pilot_cost
    if cost is not None:
        head += [
            ["pilot", f"{cost.raw_files} of the codes one by one, {cost.seconds:.3f} s, at most"],
            [
                "or",
                f"ends after {cost.scouts} without sharp paths: {cost.stopped_raw_files} RAW "
                f"files, {cost.stopped_seconds:.3f} s, {cost.stopped_codes} codes"
                + " at once"
                * (summary.parts == 1),
            ],
        ]
    if summary.prior is not None:
        head.append(["codes by", summary.prior])
    head += [["why" if not number else "", text] for number, text in enumerate(summary.reasons)]
    head += [["split" if not number else "", text] for number, text in enumerate(summary.split)]
    foreseen = summary.prediction
    if foreseen is not None:
        head += [
            ["RMS error", f"{percent(foreseen.error)} of the picture's RMS"],
            ["by codes", percent(foreseen.code)],
            ["by sensor", f"{percent(foreseen.sensor)} at ISO {foreseen.iso}"],
            ["at most", f"{percent(foreseen.bound)} with {100.0 * foreseen.confidence:g} %"],
            ["prior", foreseen.prior],
        ]
    shots = [
        [
            f"shot {s.name}",
            f"{s.exposures} of " * (s.exposures > 1)
            + f"{s.codes} codes, {s.refreshes} refreshes, {s.exposure_s:.3f} s",
        ]
        for s in summary.shots
    ]
    say_table(head + shots)
    return DONE


def refuse_with_local(args: argparse.Namespace, *names: str) -> None:
    """Raise ConfigError where --local was typed with one of these options, which ask a daemon."""
    given = [name for name in names if getattr(args, name)]
    if args.local and given:
        raise ConfigError(
            f"--local goes without --{' and --'.join(given)}", hint="there is no daemon to ask"
        )


def daemon_socket(args: argparse.Namespace) -> Path:
    """Path of the daemon's socket: as given, else as the configuration says."""
    given: Path | None = args.socket
    return given if given is not None else socket_path(load(args.config))


def daemon_if_any(args: argparse.Namespace, *, needed: bool = False) -> Client | None:
    """A connection to the daemon, None where none answers. Raises Unreachable where its socket was
    named, or nothing else will do."""
    try:
        return Client(daemon_socket(args))
    except Unreachable:
        if needed or args.socket is not None:
            raise
    return None


def request_of(args: argparse.Namespace, *, out: Path | None) -> CaptureRequest:
    """Check what was typed against the types of a request. Raises ConfigError.

    Its files are left out: see `arrays_of`.
    """
    fields = {
        "goal": args.goal,
        "prior": args.prior if in_words(args.prior) else None,
        "pilot": args.pilot,
        "smooth": args.smooth,
        "grey_masks": args.grey_masks,
        "parts": args.parts,
        "until_error": args.until_error,
        "repeat": args.repeat,
        "error": args.error,
        "confidence": args.confidence,
        "seconds": args.seconds,
        "method": args.method,
        "shift": args.shift,
        "radius": args.radius,
        "mix": args.mix,
        "period": args.period,
        "disparity": _range(args.disparity),
        "plane": args.plane,
        "keep": args.keep,
        "rows": _both_rows(args.rows),
        "masked": args.masked or None,
        "codes": args.codes,
        "family": args.family,
        "p": args.p,
        "equal_brightness": args.equal_brightness,
        "seed": args.seed,
        "exposure_s": args.exposure_s,
        "window": args.window,
        "guards": args.guards,
        "black_level": args.black_level,
        "normalise": args.normalise,
        "white": args.white,
        "white_patch": args.white_patch,
        "out": None if out is None else str(out.absolute()),
        "name": args.name,
        "tags": args.tags or (),
        "note": args.note,
    }
    try:
        return msgspec.convert(fields, CaptureRequest)
    except msgspec.ValidationError as err:
        what, _, place = str(err).replace("`", "").partition(" - at $.")
        field = place.partition("[")[0]
        if field in LABELS:  # the pattern of a text tells nobody what it may be
            raise ConfigError(f"{field}: it takes {LABELS[field]}") from err
        raise ConfigError(f"{place}: {what[0].lower()}{what[1:]}") from err


def _range(disparity: list[int] | None) -> list[int] | None:
    """Lowest and highest of what was typed; one number is both."""
    return disparity * 2 if disparity is not None and len(disparity) == 1 else disparity


def arrays_of(args: argparse.Namespace) -> dict[str, Path]:
    """The files that were named, by the request's field; this command opens them itself."""
    given: dict[str, Path | None] = {name: getattr(args, name) for name in ARRAYS}
    if args.prior is not None and not in_words(args.prior):
        given["prior"] = Path(args.prior)
    return {name: path for name, path in given.items() if path is not None}


def _both_rows(rows: list[int] | None) -> tuple[int, int] | None:
    """Row of projector cells, and of camera cells: the same one where no other was typed."""
    if rows is None:
        return None
    if len(rows) > 2:
        raise ConfigError("--rows takes one row of cells, or two", hint="such as --rows 12 20")
    return rows[0], rows[-1]


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
        return bench.foresee(request, files)


def _capture_here(
    config: Path | None, request: CaptureRequest, files: Mapping[str, Path], on_event: OnEvent
) -> CaptureResult:
    """Run one capture with the rig in this process; panels black and shutter closed on return."""
    with held_back(delivers=False) as interrupted, local(config) as bench:
        return bench.take_until(interrupted, request, files, on_event, report=True)
