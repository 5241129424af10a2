"""`pdcd calibrate`: the bench measures itself, over the socket or with the rig in this process; and
`pdcd calibrate list | use | forget`: manages the kept calibrations and which one is used."""

from __future__ import annotations

import argparse
import select
import signal
import sys
from collections.abc import Callable, Sequence
from typing import get_args

from pdcd.api.progress import show_bar, tell_user
from pdcd.api.signals import hold_signals, send_signals_to
from pdcd.bench.calibration import Calibration, FigureRecord
from pdcd.bench.choosing import (
    CALIBRATIONS_FOLDER,
    Candidate,
    find_calibration,
    forget_calibration,
    list_candidates,
    pin_calibration,
    read_candidate,
)
from pdcd.bench.config import load_config
from pdcd.bench.folders import find_state_dir
from pdcd.bench.measured import CalibrationChoice, choose_calibration
from pdcd.bench.tables import Config
from pdcd.cli.daemon import connect_daemon, refuse_with_local
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import (
    ask_consent,
    say,
    say_comparison,
    say_json,
    say_notes,
    say_result,
    say_table,
    say_text,
)
from pdcd.errors import ConfigError
from pdcd.protocol.events import Event, StepEnded
from pdcd.protocol.line_talk import EventHandler
from pdcd.protocol.request import CalibrateRequest
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.words import StepName

ACTIONS = ("list", "use", "forget")
"""Words that may stand in place of the first step."""
_NOT_WITH = ("scene", "again", "out", "anew", "queue", "socket")
"""Options that only go with steps."""
_LOOK_S = 0.1
"""Time between two checks whether the user has answered, or has given up."""


def calibrate(args: argparse.Namespace) -> int:
    """Measure, and print every figure with its limit and verdict; fails when any is bad."""
    if args.step and args.step[0] in ACTIONS:
        return _manage(args, args.step)
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
    with show_bar() as show:

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


def _there(
    args: argparse.Namespace, request: CalibrateRequest, hear: EventHandler
) -> CaptureResult:
    """With the daemon's rig."""
    with (
        send_signals_to(signal.default_int_handler),
        connect_daemon(args, drives=True) as client,
    ):
        return client.calibrate(request, queue=args.queue, on_event=hear, answer=_asker(_never))


def _here(args: argparse.Namespace, request: CalibrateRequest, hear: EventHandler) -> CaptureResult:
    """With the rig in this process; panels black and shutter closed on return."""
    from pdcd.capture.engine import Engine

    engine = Engine.from_config(load_config(args.config))
    with hold_signals(delivers=False) as interrupted:
        try:
            engine.start()
            return engine.calibrate(
                request,
                job=make_job_id(),
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
    """A function that asks the user at this terminal to do something, and waits for Return."""

    def ask(text: str) -> None:
        tell_user(f"{text}; then press Return")
        while not given_up():
            if select.select([sys.stdin], [], [], _LOOK_S)[0]:
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
        used += "; bad steps are left out: mend them, and calibrate again"
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
    from pdcd.capture.again import recompute_calibration

    if args.step or args.anew or args.local or args.socket or args.scene or args.marks != "auto":
        raise ConfigError(
            "--again takes no steps and no options of a rig: it repeats all steps of the folder"
        )
    report = recompute_calibration(args.again)
    items = ((item.name, item.identical) for item in report.items)
    return say_comparison(report, items, as_json=args.json)


def _manage(args: argparse.Namespace, words: Sequence[str]) -> int:
    """Do what the first of the words says with the calibrations of a configuration's bench."""
    given = [name for name in _NOT_WITH if getattr(args, name)]
    if given or args.marks != "auto":
        raise ConfigError(f"pdcd calibrate {words[0]} takes no --{(*given, 'marks')[0]}")
    config = load_config(args.config)
    action, *names = words
    if action == "list":
        if names:
            raise ConfigError("pdcd calibrate list takes no name")
        return _list(config, as_json=args.json)
    if len(names) != 1:
        wanted = "NAME, none or latest" if action == "use" else "NAME"
        raise ConfigError(f"pdcd calibrate {action} takes one word: {wanted}")
    if action == "use":
        return _use(config, names[0], as_json=args.json)
    return _forget(config, names[0], yes=args.yes, as_json=args.json)


def _list(config: Config, *, as_json: bool) -> int:
    """Print all calibrations, the newest first."""
    used, trouble = _choice(config)
    found = list(list_candidates(config))
    rows = [["", "name", "ended", "steps", "fits this bench"]]
    for one in found:
        in_use = used is not None and used.folder == one.folder
        if as_json:
            say_json(_told(one, in_use=in_use))
            continue
        record = one.record
        ended = "" if record is None else record.finished_utc[:16].replace("T", " ")
        steps = "" if record is None else _steps(record)
        rows.append(["in use" if in_use else "", one.name, ended, steps, one.why or "yes"])
    if as_json:
        return DONE
    if not found:
        say(f"no calibration is kept in {find_state_dir(config) / CALIBRATIONS_FOLDER}")
    else:
        say_table(rows)
    if trouble:
        say_text(trouble)
    elif used is not None and used.folder is None and found:
        say("none is in use")
    return DONE


def _use(config: Config, name: str, *, as_json: bool) -> int:
    """Record which calibration is used from now on."""
    typed = config.calibration.use
    if name in ("none", "latest"):
        pin_calibration(config, None if name == "latest" else name)
    else:
        at = find_calibration(config, name)
        found = read_candidate(at, config, named=True)
        why = "it holds no whole calibration" if found is None else found.why
        if found is None or why:
            raise ConfigError(
                f"calibration {name} cannot be used by this bench: {why}",
                hint="pdcd calibrate list says which ones fit",
            )
        name = found.name
        pin_calibration(config, name)
    if as_json:
        say_json({"use": name, "rig": config.rig.name, "typed": typed})
        return DONE
    if typed != "latest":
        say_text(f"noted; but the configuration says [calibration] use = {typed!r}, ")
        say_text("which takes precedence: remove that line")
        return DONE
    used, trouble = _choice(config)
    if used is None:
        say_text(trouble)
        return DONE
    folder = "no calibration" if used.folder is None else str(used.folder)
    say_text(f"in use: {folder}; a running daemon uses it from its next start on")
    return DONE


def _forget(config: Config, name: str, *, yes: bool, as_json: bool) -> int:
    """Remove a calibration for good, or the link to it."""
    at = find_calibration(config, name)
    what = "the link to" if at.is_symlink() else "for good"
    if not yes and not ask_consent(f"remove {what} calibration {name}?", silent=as_json):
        return DONE
    forget_calibration(config, at)
    if as_json:
        say_json({"forgotten": name})
    else:
        say(f"removed {at}")
    return DONE


def _choice(config: Config) -> tuple[CalibrationChoice | None, str]:
    """The calibration in use, or the reason why none can be used."""
    try:
        return choose_calibration(config), ""
    except ConfigError as err:
        return None, str(err)


def _steps(record: Calibration) -> str:
    """Each step with its verdict, and the reason if it is not used."""
    words = [f"{name} (taken over)" for name in record.taken_over]
    for step in record.steps:
        if step.name != "meter":
            why = record.left_out.get(step.name)
            words.append(
                f"{step.name} {step.verdict}" + (f" ({why})" if why not in (None, "bad") else "")
            )
    if record.stopped is not None:
        words.append(f"stopped at {record.stopped.step}")
    elif record.state == "running":
        words.append("cut short")
    return ", ".join(words)


def _told(one: Candidate, *, in_use: bool) -> dict[str, object]:
    record = one.record
    return {
        "name": one.name,
        "folder": str(one.folder),
        "in_use": in_use,
        "fits": not one.why,
        "why_not": one.why or None,
        "ended_utc": None if record is None else record.finished_utc,
        "state": None if record is None else record.state or "done",
        "verdict": None if record is None else record.verdict,
        "steps": {} if record is None else {s.name: s.verdict for s in record.steps[1:]},
        "left_out": {} if record is None else record.left_out,
        "stopped": None if record is None else record.stopped,
    }
