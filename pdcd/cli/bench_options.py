"""What can be typed behind the commands that look at devices and at the configuration."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from pdcd.cli.commands import Add, commands_below
from pdcd.cli.options import client_options, config_option, json_option, queue_option, share
from pdcd.words import MovingName, PatternName, StepName


def add_bench_commands(add: Add) -> None:
    """Add what looks at devices and configuration."""
    add("drivers", "tools:drivers", "list drivers and why some are unavailable", json_option)
    add("doctor", "doctor:display", "say what of the bench is fit to work, and what not", _doctor)
    add("calibrate", "calibrate:calibrate", "have the bench measure itself", _calibrate)
    add("show", "panels:show", "show a pattern on both panels, without a camera", _show)
    add("timing", "panels:timing", "measure how regularly the panels show codes", _timing)
    add(
        "config",
        "tools:config",
        "try the configuration without a device, print it, or print its JSON Schema",
        _config,
    )
    add("virtual-camera", "virtual:virtual_camera", "be a Canon EOS 450D on the network", _virtual)
    add("snr", "snr:snr", "compare one coded photo with many photos without a mask", _snr)


def _doctor(parser: argparse.ArgumentParser) -> None:
    """Add one subcommand a device."""
    add = commands_below(parser, dest="device", required=True, metavar="DEVICE")
    add("display", "doctor:display", "look at the X server and at both panels", _doctor_display)
    add(
        "camera",
        "doctor:camera",
        "look at the camera on the USB; nothing is exposed",
        _doctor_camera,
    )
    add(
        "trigger",
        "doctor:trigger",
        "look at the shutter, and click it if told to",
        _doctor_trigger,
    )


def _doctor_display(parser: argparse.ArgumentParser) -> None:
    config_option(parser, "where the device is named")
    json_option(parser)
    parser.add_argument("--display", metavar=":N", help="X server; default: the configuration's")


def _doctor_camera(parser: argparse.ArgumentParser) -> None:
    config_option(parser, "where the device is named")
    json_option(parser)
    parser.add_argument(
        "--raw", type=Path, metavar="FILE", help="a photo of it: tells its frame and orientation"
    )


def _doctor_trigger(parser: argparse.ArgumentParser) -> None:
    config_option(parser, "where the device is named")
    json_option(parser)
    parser.add_argument("--click", action="store_true", help="open the shutter, and close it again")
    parser.add_argument(
        "--seconds", type=float, default=1.0, metavar="S", help="hold it open; default: 1"
    )


def _calibrate(parser: argparse.ArgumentParser) -> None:
    from pdcd.cli.request import add_field
    from pdcd.protocol.fields import fields_of
    from pdcd.protocol.request import CalibrateRequest

    parser.usage = (
        "%(prog)s [OPTIONS] [STEP ...]\n"
        "       %(prog)s list | use NAME|none|latest | forget NAME [--yes]  "
        "[--config FILE] [--json]"
    )
    parser.add_argument(
        "step",
        nargs="*",
        metavar="STEP",
        help=f"default: all that a bench needs; or of {', '.join(get_args(StepName))}. In its "
        "place list: the calibrations that are kept; use: go by one, by name, or by the latest; "
        "forget: remove one",
    )
    parser.add_argument(
        "--scene",
        action="store_true",
        help="on the scene that is in front of the camera, without a card",
    )
    add_field(parser, fields_of(CalibrateRequest)["marks"])
    parser.add_argument(
        "--anew",
        action="store_true",
        help="measure all steps, also those found by a calibration that stopped not long ago",
    )
    parser.add_argument(
        "--again", type=Path, metavar="FOLDER", help="compute a calibration again from its photos"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="make the folder in DIR; goes with --local"
    )
    parser.add_argument(
        "--yes",
        action="store_true",
        help="wait for nobody: the card is where it has to be; forget without asking",
    )
    queue_option(parser)
    parser.add_argument(
        "--local", action="store_true", help="drive the rig from this process, without a daemon"
    )
    client_options(parser)


def _show(parser: argparse.ArgumentParser) -> None:
    patterns = (*get_args(PatternName), *get_args(MovingName))
    parser.add_argument("pattern", nargs="?", default="grid", choices=patterns)
    parser.add_argument("--index", type=int, default=0, metavar="N", help="which code")
    parser.add_argument(
        "--loop", action="store_true", help="all codes over and over: see through the mask"
    )
    parser.add_argument(
        "--out", type=Path, metavar="PNG", help="on the mock: where to draw it; show-PATTERN.png"
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="end by itself")
    parser.add_argument(
        "--detach", action="store_true", help="leave it on the daemon's panels and return"
    )
    client_options(parser)


def _timing(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--frames", type=int, default=3000, metavar="N", help="refreshes to show")
    parser.add_argument("--out", type=Path, metavar="PNG", help="write histograms of the times")
    config_option(parser, "where the panels are named")
    json_option(parser)


def _config(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=("check", "show", "schema"))
    config_option(parser, "instead of the usual file")


def _virtual(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--port", type=int, default=15740, metavar="N", help="default: 15740; 0 takes a free one"
    )
    parser.add_argument(
        "--scene", default="chart", metavar="KIND", help="a scene of the mock bench; default: chart"
    )
    parser.add_argument("--small", action="store_true", help="files of 192 x 128 samples")


def _snr(parser: argparse.ArgumentParser) -> None:
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
