"""`pdcd calibrate`: the bench measures itself, over the socket or with the rig in this process."""

from __future__ import annotations

import argparse
import select
import signal
import sys
from collections.abc import Callable
from typing import get_args

from pdcd.api.progress import bar, tell
from pdcd.api.signals import held_back, signals_to
from pdcd.bench.calibration import FigureRecord
from pdcd.bench.config import load
from pdcd.cli.calibrations import ACTIONS, manage
from pdcd.cli.daemon import connect_daemon, refuse_with_local
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say, say_compared, say_notes, say_result, say_table, say_text
from pdcd.client import OnEvent
from pdcd.errors import ConfigError
from pdcd.protocol.events import Event, StepEnded
from pdcd.protocol.request import CalibrateRequest
from pdcd.protocol.result import CaptureResult, new_job_id
from pdcd.words import StepName

LOOK_S = 0.1
"""Time between two looks whether somebody who was asked has answered, or wants no more."""


def calibrate(args: argparse.Namespace) -> int:
    """Measure, and print every figure with its limit and verdict; fails when one is bad."""
    if args.step and args.step[0] in ACTIONS:
        return manage(args, args.step)
    if args.again is not None:
        return _again(args)
    unknown = [name for name in args.step if name not in get_args(StepName)]
    if unknown:
        raise ConfigError(
            f"no step is called {unknown[0]!r}", hint=f"steps are {', '.join(get_args(StepName))}"
        )
    refuse_with_local(args, "socket", "queue")
    if args.out is not None and not args.local:
        raise ConfigError(
            "--out goes with --local: the daemon keeps calibrations in its own state folder"
        )
    if args.marks != "auto" and args.step and "geometry" not in args.step:
        raise ConfigError("--marks is for the geometry, which is not among the steps")
    attended = sys.stdin.isatty() and not args.yes and not args.json
    request = CalibrateRequest(
        steps=tuple(args.step),
        attended=attended,
        subject="scene" if args.scene else "card",
        marks=args.marks,
        anew=args.anew,
    )
    ended: list[StepEnded] = []
    with bar() as show:

        def hear(event: Event) -> None:
            if isinstance(event, StepEnded):
                ended.append(event)
            show(event)

        result = _here(args, request, hear) if args.local else _there(args, request, hear)
    if args.json:
        code = say_result(result, as_json=True)
        return FAILED if code == DONE and result.summary.get("verdict") == "bad" else code
    for step in ended:
        _say_step(step)
    return _say_end(result)


def _there(args: argparse.Namespace, request: CalibrateRequest, hear: OnEvent) -> CaptureResult:
    """With the daemon's rig."""
    with signals_to(signal.default_int_handler), connect_daemon(args) as client:
        return client.calibrate(request, queue=args.queue, on_event=hear, answer=_asker(_never))


def _here(args: argparse.Namespace, request: CalibrateRequest, hear: OnEvent) -> CaptureResult:
    """With the rig in this process; panels black and shutter closed on return."""
    from pdcd.capture.engine import Engine

    engine = Engine.from_config(load(args.config))
    with held_back(delivers=False) as interrupted:
        try:
            engine.start()
            return engine.calibrate(
                request,
                job=new_job_id(),
                emit=hear,
                cancelled=interrupted,
                proceed=_asker(interrupted),
                out=args.out,
            )
        finally:
            engine.stop()


def _never() -> bool:
    return False


def _asker(given_up: Callable[[], bool]) -> Callable[[str], None]:
    """What has somebody at this terminal do something, and waits for Return."""

    def ask(text: str) -> None:
        tell(f"{text}; then press Return")
        while not given_up():
            if select.select([sys.stdin], [], [], LOOK_S)[0]:
                sys.stdin.readline()
                return

    return ask


def _say_step(step: StepEnded) -> None:
    """Print what a step found: a table of its figures, and what to do."""
    say(f"{step.step}: {step.verdict}, {step.photos} photos, {step.seconds:.1f} s of computing")
    if step.figures:
        say_table([["  figure", "value", "limit", "verdict"], *map(_row, step.figures)])
    for text in step.advice:
        say_text(f"  {text}")


def _row(figure: FigureRecord) -> list[str]:
    value = "unknown" if figure.value is None else f"{figure.value:.4g}"
    if figure.value is not None and figure.sigma:
        value += f" +- {figure.sigma:.2g}"
    return [f"  {figure.name}", f"{value} {figure.unit}".rstrip(), figure.limit, figure.verdict]


def _say_end(result: CaptureResult) -> int:
    """Print where the calibration lies and whether it is used from now on."""
    if result.state != "done":
        return say_result(result, as_json=False)
    verdict = str(result.summary.get("verdict"))
    used = "in use" if result.summary.get("used") else "not used: pdcd calibrate list says why"
    if verdict == "bad":
        used += "; what is bad is left out: mend it, and calibrate again"
    say_table(
        [
            ["verdict", f"{verdict}, {used}"],
            ["photos", str(result.summary.get("photos"))],
            ["folder", str(result.folder)],
            ["to look at", f"{result.folder}/preview"],
        ]
    )
    say_notes(result)
    return FAILED if verdict == "bad" else DONE


def _again(args: argparse.Namespace) -> int:
    """Compute a calibration again; fails when a value differs from the one kept."""
    from pdcd.capture.again import again

    if args.step or args.anew or args.local or args.socket or args.scene or args.marks != "auto":
        raise ConfigError("--again goes alone: it needs no rig and takes all steps of the folder")
    report = again(args.again)
    items = ((item.name, item.identical) for item in report.items)
    return say_compared(report, items, as_json=args.json)
