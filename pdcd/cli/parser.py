"""What can be typed: all commands, without anything that is slow to import."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import get_args

from pdcd.cli.options import (
    client_options,
    export_options,
    json_option,
    method_option,
    request_options,
    rig_options,
    share,
)
from pdcd.cli.runs_parser import runs_options
from pdcd.version import __version__
from pdcd.words import MarksName, MovingName, PatternName, StepName

EXIT_CODES = (
    "exit codes: 0 done, 2 usage or configuration, 3 daemon unreachable, 4 busy, 5 failed, "
    "6 denied, 130 cancelled"
)

Add = Callable[[str, str, str], argparse.ArgumentParser]
"""Adds a command: its name, "module:function" and what it does; returns its parser."""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser; it sets `run` to the "module:function" of the command."""
    parser = argparse.ArgumentParser(
        prog="pdcd",
        description="Photograph chosen light paths: a projector, an LCD mask and a camera.",
        epilog=EXIT_CODES,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"pdcd {__version__}")
    parser.set_defaults(json=False)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    add = partial(_made, commands)
    _photo_commands(add)
    _job_commands(add)
    _web_command(add)
    _bench_commands(add)
    _run_commands(add)
    return parser


def _photo_commands(add: Add) -> None:
    """Add the daemon, and what takes or plans a photo."""
    serve = add("serve", "serve:serve", "run the daemon in the foreground")
    rig_options(serve, socket="listen here")
    serve.add_argument("--state-dir", type=Path, metavar="DIR", help="keep runs below this folder")
    serve.add_argument(
        "-v",
        "--verbose",
        action="store_true",
        help="log everything at a terminal, too, not warnings alone",
    )

    capture = add("capture", "capture:capture", "take a photo and wait for it")
    # All options in the first line of a mistake would hide the mistake: --help has them.
    capture.usage = "%(prog)s [OPTIONS] GOAL"
    request_options(capture)
    method_option(capture)
    _run_options(capture)

    transport = add("transport", "capture:capture", "photograph entries of the transport matrix")
    transport.usage = "%(prog)s [OPTIONS] [--rows R [R2]]"
    request_options(transport, goal=False)
    _run_options(transport)
    transport.set_defaults(goal="transport", method="coded")

    compare = add("compare", "compare:compare", "take a photo by every method, side by side")
    compare.usage = capture.usage
    request_options(compare)
    compare.add_argument("--out", type=Path, metavar="DIR", help="make the run folders in DIR")
    compare.set_defaults(method="coded")

    demo = add("demo", "demo:demo", "start a daemon on the mock bench and take one photo with it")
    demo.add_argument("--out", type=Path, default=Path("demo"), metavar="DIR", help="default: demo")
    demo.add_argument("--codes", type=int, default=128, metavar="K")
    demo.add_argument("--seed", type=int, default=0, metavar="N")

    plan = add("plan", "capture:plan", "say what a capture would do, without doing it")
    plan.usage = capture.usage
    request_options(plan)
    method_option(plan)
    plan.add_argument("--queue", action="store_true", help="wait while the rig is taken")


def _run_options(parser: argparse.ArgumentParser) -> None:
    """Add where the run folder goes, and whether to wait."""
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="make the run folder in DIR; over the socket, below the daemon's state folder",
    )
    parser.add_argument(
        "--detach", action="store_true", help="start only; the job outlives this command"
    )
    parser.add_argument("--queue", action="store_true", help="wait while another capture runs")


def _job_commands(add: Add) -> None:
    """Add what asks a daemon of its jobs."""
    client_options(add("status", "jobs:status", "say what the daemon is doing"))
    watch = add("watch", "jobs:watch", "follow a job to its end, or all jobs until interrupted")
    watch.add_argument("job", nargs="?", metavar="JOB")
    client_options(watch)
    cancel = add("cancel", "jobs:cancel", "end a job: the one named, else the running one")
    cancel.add_argument("job", nargs="?", metavar="JOB")
    client_options(cancel)
    _with_commands(add("runs", "runs:list_runs", "list runs on disk, and do things with them"))
    listed = add("list", "jobs:list_jobs", "list jobs, and the runs that the daemon has on disk")
    listed.add_argument(
        "--newest",
        type=int,
        default=50,
        metavar="N",
        help="runs on disk to list, unfinished ones too; 0 to 1000, default: 50",
    )
    client_options(listed)
    wait = add("wait", "capture:wait", "wait for a job and report it as capture does")
    wait.add_argument("job", metavar="JOB")
    client_options(wait)


def _web_command(add: Add) -> None:
    """Add the page, a client of the daemon like the commands."""
    page = add("web", "web:web", "serve a page for the person at the bench, to this machine alone")
    rig_options(page, socket="where the daemon listens")
    page.add_argument(
        "--state-dir", type=Path, metavar="DIR", help="where the daemon keeps its runs"
    )
    page.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="of the loopback interface; default: 127.0.0.1",
    )
    page.add_argument(
        "--port", type=int, default=8137, metavar="N", help="default: 8137; 0 takes a free one"
    )


def _bench_commands(add: Add) -> None:
    """Add what looks at devices and configuration."""
    json_option(add("drivers", "tools:drivers", "list drivers and why some are unavailable"))
    _doctors(
        add("doctor", "doctor:display", "say what of the bench is fit to work, and what is not")
    )
    measured = add("calibrate", "calibrate:calibrate", "have the bench measure itself")
    measured.usage = "%(prog)s [OPTIONS] [STEP ...]"
    measured.add_argument(
        "step",
        nargs="*",
        metavar="STEP",
        help=f"default: all that a bench needs; or of {', '.join(get_args(StepName))}",
    )
    measured.add_argument(
        "--scene",
        action="store_true",
        help="on the scene that is before the camera, without a card",
    )
    measured.add_argument(
        "--marks",
        choices=get_args(MarksName),
        default="auto",
        help="what geometry shows: dots on a card, or stripes (docs/calibration.md)",
    )
    measured.add_argument(
        "--again", type=Path, metavar="FOLDER", help="compute a calibration again from its photos"
    )
    measured.add_argument(
        "--out", type=Path, metavar="DIR", help="make the folder in DIR; goes with --local"
    )
    measured.add_argument(
        "--yes", action="store_true", help="wait for nobody: the card is where it has to be"
    )
    measured.add_argument("--queue", action="store_true", help="wait while the rig is taken")
    measured.add_argument(
        "--local", action="store_true", help="drive the rig from this process, without a daemon"
    )
    client_options(measured)
    held = add("show", "panels:show", "show a pattern on both panels, without a camera")
    held.add_argument(
        "pattern",
        nargs="?",
        default="grid",
        choices=(*get_args(PatternName), *get_args(MovingName)),
    )
    held.add_argument("--index", type=int, default=0, metavar="N", help="which code")
    held.add_argument(
        "--loop", action="store_true", help="all codes over and over: see through the mask"
    )
    held.add_argument(
        "--out", type=Path, metavar="PNG", help="on the mock: where to draw it; show-PATTERN.png"
    )
    held.add_argument("--seconds", type=float, metavar="S", help="end by itself")
    held.add_argument(
        "--detach", action="store_true", help="leave it on the daemon's panels and return"
    )
    client_options(held)
    timing = add("timing", "panels:timing", "measure how regularly the panels show codes")
    timing.add_argument("--frames", type=int, default=3000, metavar="N", help="refreshes to show")
    timing.add_argument("--out", type=Path, metavar="PNG", help="write histograms of the times")
    timing.add_argument("--config", type=Path, metavar="FILE", help="where the panels are named")
    json_option(timing)
    config = add(
        "config",
        "tools:config",
        "try the configuration without a device, print it, or print its JSON Schema",
    )
    config.add_argument("action", choices=("check", "show", "schema"))
    config.add_argument("--config", type=Path, metavar="FILE", help="instead of the usual file")


def _run_commands(add: Add) -> None:
    """Add what looks at finished runs, and the rest."""
    decode = add("decode", "tools:decode", "decode a run folder again from its RAW files")
    decode.add_argument("folder", type=Path, metavar="FOLDER")
    decode.add_argument(
        "--partial", action="store_true", help="of a run that was interrupted: a new folder"
    )
    decode.add_argument(
        "--out", type=Path, metavar="DIR", help="where that is made; default: beside the old one"
    )
    json_option(decode)
    verify = add("verify", "verify:verify_runs", "say whether runs are whole and unchanged")
    verify.add_argument("folder", type=Path, nargs="+", metavar="FOLDER")
    verify.add_argument(
        "--manifest-sha256",
        metavar="HEX",
        help="what capture told of the run: shows a change that was made on purpose, too",
    )
    json_option(verify)
    export = add("export", "export:export", "write pictures of a finished run for other programs")
    export.add_argument("folder", type=Path, metavar="FOLDER")
    export_options(export)
    json_option(export)
    report = add("report", "report:report", "make a page of a finished run, with its pictures")
    report.add_argument("folder", type=Path, metavar="FOLDER")
    report.add_argument(
        "--out", type=Path, metavar="FILE", help="default: report.html in the run's folder"
    )
    json_option(report)
    row = add("row", "row:row", "show which paths a finished run kept for one cell")
    row.add_argument("folder", type=Path, metavar="FOLDER")
    row.add_argument(
        "--cell", type=int, nargs=2, required=True, metavar=("ROW", "COLUMN"), help="counted from 0"
    )
    row.add_argument("--photo", metavar="NAME", help="default: the one that the answer rests on")
    row.add_argument(
        "--out", type=Path, metavar="PNG", help="default: row-PHOTO-ROW-COLUMN.png in FOLDER"
    )
    json_option(row)
    virtual = add("virtual-camera", "virtual:virtual_camera", "be a Canon EOS 450D on the network")
    virtual.add_argument(
        "--port", type=int, default=15740, metavar="N", help="default: 15740; 0 takes a free one"
    )
    virtual.add_argument(
        "--scene", default="chart", metavar="KIND", help="a scene of the mock bench; default: chart"
    )
    virtual.add_argument("--small", action="store_true", help="files of 192 x 128 samples")
    _figures_options(
        add("figures", "figures:figures", "take the paper's experiments again, as one page")
    )
    _snr_options(add("snr", "snr:snr", "compare one coded photo with many photos without a mask"))
    add("version", "tools:version", "print the version")
    shell = add("completion", "completion:completion", "print a script that completes commands")
    shell.add_argument("shell", choices=("bash", "zsh", "fish"))
    shell.description = (
        "Print a script by which a shell completes commands, options and files. For bash into "
        "~/.local/share/bash-completion/completions/pdcd, for zsh into _pdcd in a folder of "
        "$fpath, for fish into ~/.config/fish/completions/pdcd.fish."
    )
    add("man", "manual:man", "print the manual page")


def _figures_options(parser: argparse.ArgumentParser) -> None:
    """Add which figures, how finely, and where to."""
    parser.add_argument(
        "number", nargs="*", metavar="N", help="such as 1, 12, table-1, appendix; default: all"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the page")
    quality = parser.add_mutually_exclusive_group()
    quality.add_argument(
        "--quick",
        action="store_true",
        help="a coarser camera and fewer codes, some two minutes on two cores (the default)",
    )
    quality.add_argument(
        "--full", action="store_true", help="the camera's own resolution, the paper's codes; hours"
    )
    parser.add_argument(
        "--no-plots", action="store_false", dest="plots", help="leave out what needs matplotlib"
    )
    parser.add_argument("--workers", type=int, metavar="N", help="processes; default: 2")
    json_option(parser)


def _with_commands(runs: argparse.ArgumentParser) -> None:
    """Add what can be done with runs."""
    commands = runs.add_subparsers(dest="runs_command", metavar="COMMAND")
    runs_options(runs, partial(_made, commands))


def _made(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, run: str, text: str
) -> argparse.ArgumentParser:
    """Add a command; returns its parser."""
    made = commands.add_parser(
        name, help=text, description=text, epilog=EXIT_CODES, allow_abbrev=False
    )
    made.set_defaults(run=run)
    return made


def _doctors(parser: argparse.ArgumentParser) -> None:
    """Add one subcommand a device."""
    devices = parser.add_subparsers(dest="device", required=True, metavar="DEVICE")

    def add(name: str, run: str, text: str) -> argparse.ArgumentParser:
        made = _made(devices, name, run, text)
        made.add_argument("--config", type=Path, metavar="FILE", help="where the device is named")
        json_option(made)
        return made

    display = add("display", "doctor:display", "look at the X server and at both panels")
    display.add_argument("--display", metavar=":N", help="X server; default: the configuration's")
    camera = add("camera", "doctor:camera", "look at the camera on the USB; nothing is exposed")
    camera.add_argument(
        "--raw", type=Path, metavar="FILE", help="a photo of it: tells its frame and orientation"
    )
    trigger = add("trigger", "doctor:trigger", "look at the shutter, and click it if told to")
    trigger.add_argument(
        "--click", action="store_true", help="open the shutter, and close it again"
    )
    trigger.add_argument(
        "--seconds", type=float, default=1.0, metavar="S", help="hold it open; default: 1"
    )


def _snr_options(parser: argparse.ArgumentParser) -> None:
    """Add the paper's appendix as it applies to another sensor; defaults are the appendix'."""
    parser.add_argument(
        "--profile",
        default="modern",
        metavar="NAME",
        help="sensor: a name or the path of a .toml file; default: modern",
    )
    parser.add_argument(
        "--iso", type=int, metavar="N", help="of the coded photo; default: the profile's lowest"
    )
    parser.add_argument(
        "--codes",
        type=int,
        default=512,
        metavar="N",
        help="codes as the paper counts them, four to a code pair, each a mask-less photo; "
        "default: 512",
    )
    parser.add_argument(
        "--exposure",
        type=float,
        default=30.0,
        metavar="S",
        dest="exposure_s",
        help="of the coded photo, and of all others together, in seconds; default: 30",
    )
    parser.add_argument(
        "--signal",
        type=float,
        metavar="E",
        dest="signal_e",
        help="electrons of the coded photo through an ideal mask; default: 13 %% of the highest",
    )
    parser.add_argument(
        "--transmission",
        type=share,
        default=1.0,
        metavar="T",
        help="light that the open mask lets through, as a share of 1 or in %%; default: 1",
    )
    json_option(parser)
