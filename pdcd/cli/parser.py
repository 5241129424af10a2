"""What can be typed: all commands and their options, without anything that is slow to import."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from pdcd import words

GOALS: tuple[words.GoalName, ...] = get_args(words.GoalName)
FAMILIES: tuple[words.FamilyName, ...] = get_args(words.FamilyName)
METHODS: tuple[words.MethodName, ...] = get_args(words.MethodName)
SCHEDULES: tuple[words.GuardsName, ...] = get_args(words.GuardsName)
WINDOWS: tuple[words.WindowName, ...] = get_args(words.WindowName)
BLACK_LEVELS: tuple[words.BlackLevel, ...] = get_args(words.BlackLevel)
NORMALISE: tuple[words.NormaliseName, ...] = get_args(words.NormaliseName)

EXIT_CODES = (
    "exit codes: 0 done, 2 usage or configuration, 3 daemon unreachable, 4 busy, 5 failed, "
    "130 cancelled"
)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser; it sets `run` to the "module:function" of the command."""
    parser = argparse.ArgumentParser(
        prog="pdcd",
        description="Photograph chosen light paths: a projector, an LCD mask and a camera.",
        epilog=EXIT_CODES,
        allow_abbrev=False,
    )
    parser.set_defaults(json=False)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, run: str, text: str) -> argparse.ArgumentParser:
        made = commands.add_parser(
            name, help=text, description=text, epilog=EXIT_CODES, allow_abbrev=False
        )
        made.set_defaults(run=run)
        return made

    serve = add("serve", "tools:serve", "run the daemon in the foreground")
    _rig_options(serve, socket="listen here")
    serve.add_argument("--state-dir", type=Path, metavar="DIR", help="keep runs below this folder")

    capture = add("capture", "capture:capture", "take a photo and wait for it")
    _request_options(capture)
    _method_option(capture)
    capture.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="make the run folder in DIR; over the socket, below the daemon's state folder",
    )
    capture.add_argument(
        "--detach", action="store_true", help="start only; the job outlives this command"
    )
    capture.add_argument("--queue", action="store_true", help="wait while another capture runs")

    compare = add("compare", "compare:compare", "take a photo by every method, side by side")
    _request_options(compare)
    compare.add_argument("--out", type=Path, metavar="DIR", help="make the run folders in DIR")
    compare.set_defaults(method="coded")

    demo = add("demo", "demo:demo", "start a daemon on the mock bench and take one photo with it")
    demo.add_argument("--out", type=Path, default=Path("demo"), metavar="DIR", help="default: demo")
    demo.add_argument("--codes", type=int, default=128, metavar="K")
    demo.add_argument("--seed", type=int, default=0, metavar="N")

    plan = add("plan", "capture:plan", "say what a capture would do, without doing it")
    _request_options(plan)
    _method_option(plan)

    _client_options(add("status", "jobs:status", "say what the daemon is doing"))
    watch = add("watch", "jobs:watch", "follow a job to its end, or all jobs until interrupted")
    watch.add_argument("job", nargs="?", metavar="JOB")
    _client_options(watch)
    cancel = add("cancel", "jobs:cancel", "end a job: the one named, else the running one")
    cancel.add_argument("job", nargs="?", metavar="JOB")
    _client_options(cancel)
    _client_options(add("list", "jobs:list_jobs", "list the jobs that the daemon remembers"))
    wait = add("wait", "capture:wait", "wait for a job and report it as capture does")
    wait.add_argument("job", metavar="JOB")
    _client_options(wait)

    _json_option(add("drivers", "tools:drivers", "list drivers and why some are unavailable"))
    _doctors(
        add("doctor", "doctor:display", "say what of the bench is fit to work, and what is not")
    )
    held = add("show", "panels:show", "show a pattern on both panels, without a camera")
    held.add_argument(
        "pattern", nargs="?", default="grid", choices=("white", "checker", "grid", "code")
    )
    held.add_argument("--index", type=int, default=0, metavar="N", help="which code")
    held.add_argument(
        "--loop", action="store_true", help="all codes over and over: see through the mask"
    )
    held.add_argument("--seconds", type=float, metavar="S", help="end by itself")
    held.add_argument("--config", type=Path, metavar="FILE", help="where the panels are named")
    timing = add("timing", "panels:timing", "measure how regularly the panels show codes")
    timing.add_argument("--frames", type=int, default=3000, metavar="N", help="refreshes to show")
    timing.add_argument("--out", type=Path, metavar="PNG", help="write histograms of the times")
    timing.add_argument("--config", type=Path, metavar="FILE", help="where the panels are named")
    _json_option(timing)
    config = add("config", "tools:config", "check, show or describe the configuration")
    config.add_argument("action", choices=("check", "show", "schema"))
    config.add_argument("--config", type=Path, metavar="FILE", help="instead of the usual file")
    decode = add("decode", "tools:decode", "decode a run folder again from its RAW files")
    decode.add_argument("folder", type=Path, metavar="FOLDER")
    _json_option(decode)
    row = add("row", "row:row", "show which paths a finished run kept for one cell")
    row.add_argument("folder", type=Path, metavar="FOLDER")
    row.add_argument(
        "--cell", type=int, nargs=2, required=True, metavar=("ROW", "COLUMN"), help="counted from 0"
    )
    row.add_argument("--photo", metavar="NAME", help="default: the one that the answer rests on")
    row.add_argument("--out", type=Path, metavar="PNG", help="default: PHOTO-ROW-COLUMN.png here")
    _json_option(row)
    virtual = add("virtual-camera", "virtual:virtual_camera", "be a Canon EOS 450D on the network")
    virtual.add_argument(
        "--port", type=int, default=15740, metavar="N", help="default: 15740; 0 takes a free one"
    )
    virtual.add_argument(
        "--scene", default="chart", metavar="KIND", help="a scene of the mock bench; default: chart"
    )
    virtual.add_argument("--small", action="store_true", help="files of 192 x 128 samples")
    _snr_options(add("snr", "snr:snr", "compare one coded photo with many photos without a mask"))
    add("version", "tools:version", "print the version")
    return parser


def _doctors(parser: argparse.ArgumentParser) -> None:
    """Add one subcommand a device."""
    devices = parser.add_subparsers(dest="device", required=True, metavar="DEVICE")

    def add(name: str, run: str, text: str) -> argparse.ArgumentParser:
        made = devices.add_parser(
            name, help=text, description=text, epilog=EXIT_CODES, allow_abbrev=False
        )
        made.set_defaults(run=run)
        made.add_argument("--config", type=Path, metavar="FILE", help="where the device is named")
        _json_option(made)
        return made

    display = add("display", "doctor:display", "look at the X server and at both panels")
    display.add_argument("--display", metavar=":N", help="X server; default: the configuration's")
    add("camera", "doctor:camera", "look at the camera on the USB; nothing is exposed")
    trigger = add("trigger", "doctor:trigger", "look at the shutter, and click it if told to")
    trigger.add_argument(
        "--click", action="store_true", help="open the shutter, and close it again"
    )
    trigger.add_argument(
        "--seconds", type=float, default=1.0, metavar="S", help="hold it open; default: 1"
    )


def share(text: str) -> float:
    """Read "1%" or "0.01"."""
    number = text.removesuffix("%")
    return float(number) / (100.0 if number != text else 1.0)


def _rig_options(parser: argparse.ArgumentParser, *, socket: str) -> None:
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="configuration; default: the mock bench"
    )
    parser.add_argument("--socket", type=Path, metavar="PATH", help=socket)


def _json_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON, one object a line")


def _client_options(parser: argparse.ArgumentParser) -> None:
    _rig_options(parser, socket="where the daemon listens")
    _json_option(parser)


def _goal_options(parser: argparse.ArgumentParser) -> None:
    """Add the parameters of goals; which goal takes which is in `pdcd.recipes.goals`."""
    goals = parser.add_argument_group(
        "parameters of goals", "arrays are .npy files or grey images with one pixel for each cell"
    )
    goals.add_argument(
        "--shift", type=int, nargs=2, metavar=("DOWN", "RIGHT"), help="cells to the partner"
    )
    goals.add_argument("--radius", type=int, metavar="CELLS", help="what counts as near")
    goals.add_argument(
        "--mix", type=float, nargs=2, metavar=("A", "B"), help="weights of the two warps"
    )
    goals.add_argument("--period", type=int, metavar="CELLS", help="of the stripes (goal split)")
    for name, text in (
        ("illumination", "light of the projector"),
        ("warp", "projector cell of each camera cell"),
        ("warp-b", "a second warp"),
        ("region-a", "camera cells of a region"),
        ("region-b", "projector cells of a region"),
        ("kernel", "weights of shifts, centre (0, 0)"),
        ("matrix", "weight of every pair of cells"),
    ):
        goals.add_argument(f"--{name}", type=Path, metavar="FILE", help=text)


def _request_options(parser: argparse.ArgumentParser) -> None:
    """Add one photo as asked for; what is left out takes the configuration's value."""
    parser.add_argument(
        "goal", choices=GOALS, metavar="GOAL", help=f"light to keep: {', '.join(GOALS)}"
    )
    _client_options(parser)
    parser.add_argument(
        "--local", action="store_true", help="drive the rig from this process, without a daemon"
    )
    parser.add_argument("--codes", type=int, metavar="K", help="number of primal/dual pairs")
    parser.add_argument(
        "--pilot",
        type=int,
        default=0,
        metavar="K0",
        help="of these, codes to photograph one by one first, to learn sharp far paths: 8, 12 or "
        "16 before mirrors, else 32, 64 or 128",
    )
    parser.add_argument(
        "--smooth",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="correct indirect light for its smooth part, by a model that the photo itself gives "
        "(default: with hadamard codes)",
    )
    parser.add_argument(
        "--parts",
        type=int,
        default=1,
        metavar="B",
        help="exposures to split the codes over; from 4 on they measure the error of the codes",
    )
    parser.add_argument(
        "--until-error",
        type=share,
        metavar="E",
        help="stop after the part that brings the mean error down to E, say 1%%",
    )
    parser.add_argument(
        "--error",
        type=float,
        metavar="E",
        help="wanted RMS error, as a share of the picture's RMS; chooses codes and exposures",
    )
    parser.add_argument(
        "--confidence", type=float, metavar="C", help="with which to keep the error; default 0.95"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        metavar="S",
        help="time of all exposures; chooses what gives the smallest error in it",
    )
    parser.add_argument(
        "--prior",
        metavar="PRIOR",
        help="what the scene is like, to guide the codes and foresee the error by: a transport "
        "matrix (.npz), scene:NAME of a preset, or decay:CELLS",
    )
    parser.add_argument(
        "--repeat", type=int, default=1, metavar="B", help="equal exposures to add up; default 1"
    )
    _goal_options(parser)
    parser.add_argument("--family", choices=FAMILIES, help="how the codes are made")
    parser.add_argument(
        "--p", type=float, metavar="P", help="share of indirect light to keep (goal fraction)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the codes; default 0")
    parser.add_argument(
        "--exposure", type=float, metavar="S", dest="exposure_s", help="coded time in seconds"
    )
    parser.add_argument("--window", choices=WINDOWS, help="part of a mask cell that opens")
    guards = parser.add_mutually_exclusive_group()
    guards.add_argument(
        "--guards",
        action="store_const",
        const=True,
        help="a black mask between codes, whatever a wanted error would choose",
    )
    guards.add_argument(
        "--no-guards",
        action="store_const",
        const=False,
        dest="guards",
        help="no black mask between codes: more light, more error",
    )
    guards.add_argument(
        "--schedule",
        choices=SCHEDULES,
        dest="guards",
        help="refreshes that keep codes apart: 1 (none), 2 (both panels black; the mask, before or "
        "after its code) or 3 (full); auto by the measured lag of the mask",
    )
    parser.add_argument(
        "--black-level",
        choices=BLACK_LEVELS,
        dest="black_level",
        help="black exposures to take and subtract",
    )
    parser.add_argument(
        "--normalise",
        choices=NORMALISE,
        help="divide photos by one number, or each cell by its own weight",
    )
    parser.add_argument(
        "--no-white", action="store_false", dest="white", help="skip the white shot beside it"
    )
    parser.add_argument("--note", default="", metavar="TEXT", help="kept with the run")


def _method_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--method", choices=METHODS, default="coded", help="default: coded")


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
        type=float,
        default=1.0,
        metavar="T",
        help="light that the open mask lets through, in 0..1; default: 1",
    )
    _json_option(parser)
