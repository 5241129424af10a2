"""Options that several commands share: where the daemon is, and one photo as asked for."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from pdcd import words

GOALS: tuple[words.GoalName, ...] = get_args(words.GoalName)
FAMILIES: tuple[words.FamilyName, ...] = get_args(words.FamilyName)
METHODS: tuple[words.MethodName, ...] = get_args(words.MethodName)
SCHEDULES: tuple[words.GuardsName, ...] = get_args(words.GuardsName)
KEEP: tuple[words.KeepName, ...] = get_args(words.KeepName)
WINDOWS: tuple[words.WindowName, ...] = get_args(words.WindowName)
BLACK_LEVELS: tuple[words.BlackLevelName, ...] = get_args(words.BlackLevelName)
NORMALISE: tuple[words.NormaliseName, ...] = get_args(words.NormaliseName)


def share(text: str) -> float:
    """Read "1%" or "0.01"; argparse reports the ValueError of anything else."""
    number = text.removesuffix("%")
    return float(number) / (100.0 if number != text else 1.0)


def _number_or_auto(text: str) -> int | str:
    """Read a number or "auto"; argparse reports the ValueError of anything else."""
    return text if text == "auto" else int(text)


def rig_options(parser: argparse.ArgumentParser, *, socket: str) -> None:
    """Add the configuration and the socket; `socket` says what it is for."""
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="configuration; default: the mock bench"
    )
    parser.add_argument("--socket", type=Path, metavar="PATH", help=socket)


def json_option(parser: argparse.ArgumentParser) -> None:
    """Add --json."""
    parser.add_argument("--json", action="store_true", help="print JSON, one object a line")


def client_options(parser: argparse.ArgumentParser) -> None:
    """Add what every command takes that asks the daemon."""
    rig_options(parser, socket="where the daemon listens")
    json_option(parser)


def _goal_options(parser: argparse.ArgumentParser, *, one_row: bool) -> None:
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
    goals.add_argument(
        "--disparity",
        type=int,
        nargs="+",
        metavar=("LOW", "HIGH"),
        help="cells to the right from a camera cell to its projector cell, one number or a range "
        "(goals keyed, stereo)",
    )
    goals.add_argument(
        "--plane",
        type=float,
        nargs=9,
        metavar="H",
        help="homography from the camera's field to the projector's of disparity 0",
    )
    goals.add_argument(
        "--keep", choices=KEEP, help="paths in the epipolar plane, or out of it (goal epipolar)"
    )
    _rows_options(goals, one=one_row)
    for name, text in (
        ("illumination", "light of the projector"),
        ("warp", "projector cell of each camera cell"),
        ("warp-b", "a second warp"),
        ("region-a", "camera cells of a region"),
        ("region-b", "projector cells of a region"),
        ("disparities", "disparity of each camera cell"),
        ("kernel", "weights of shifts, centre (0, 0)"),
        ("matrix", "weight of every pair of cells"),
    ):
        goals.add_argument(f"--{name}", type=Path, metavar="FILE", help=text)


def _rows_options(group: argparse._ArgumentGroup, *, one: bool) -> None:
    """Add which entries of T are photographed (goal transport), by two rows or `one`."""
    group.add_argument(
        "--rows",
        type=int,
        nargs="+" if one else 2,
        metavar="R" if one else ("R", "R2"),
        help="row of projector cells and row of camera cells (goal transport); none: all of T",
    )
    group.add_argument(
        "--masked",
        action="store_true",
        help="close the mask but for the row of camera cells (goal transport)",
    )


def request_options(parser: argparse.ArgumentParser, *, goal: bool = True) -> None:
    """Add one photo as asked for, with its goal if said; what is left out takes the configuration's
    value."""
    if goal:
        parser.add_argument(
            "goal", choices=GOALS, metavar="GOAL", help=f"light to keep: {', '.join(GOALS)}"
        )
    client_options(parser)
    parser.add_argument(
        "--local", action="store_true", help="drive the rig from this process, without a daemon"
    )
    _code_options(parser)
    _wanted_options(parser)
    _goal_options(parser, one_row=not goal)
    parser.add_argument("--family", choices=FAMILIES, help="how the codes are made")
    parser.add_argument(
        "--p",
        type=share,
        metavar="P",
        help="share of other light to keep, 0.25 or 25%% (goals fraction and off-diagonal)",
    )
    parser.add_argument(
        "--equal-brightness",
        action="store_true",
        help="as many times more codes as p is smaller than 1/2",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the codes; default 0")
    parser.add_argument(
        "--exposure", type=float, metavar="S", dest="exposure_s", help="coded time in seconds"
    )
    _panel_options(parser)
    parser.add_argument(
        "--black-level",
        choices=BLACK_LEVELS,
        dest="black_level",
        help="black exposures to take and subtract; auto: those that a dark photo calls for",
    )
    parser.add_argument(
        "--normalise",
        choices=NORMALISE,
        help="divide photos by one number, or each cell by its own weight",
    )
    parser.add_argument(
        "--no-white", action="store_false", dest="white", help="skip the white shot beside it"
    )
    white_patch_option(parser, "balance the previews by something white at X Y of the field")
    _label_options(parser)


def _label_options(parser: argparse.ArgumentParser) -> None:
    """Add what people find the run by."""
    labels = parser.add_argument_group("labels", "kept with the run, and shown by pdcd runs")
    labels.add_argument("--name", metavar="TEXT", help="what to call the run; no /")
    labels.add_argument(
        "--tag",
        action="append",
        dest="tags",
        metavar="WORD",
        help="a word to find it by; again for more",
    )
    labels.add_argument("--note", default="", metavar="TEXT", help="whatever is to be remembered")


def white_patch_option(parser: argparse.ArgumentParser, text: str) -> None:
    """Add where something white lies on the field."""
    parser.add_argument(
        "--white-patch",
        type=float,
        nargs=2,
        metavar=("X", "Y"),
        help=f"{text}: from 0 0 at its upper left corner to 1 1",
    )


def _code_options(parser: argparse.ArgumentParser) -> None:
    """Add how many codes, and how they are spent."""
    parser.add_argument("--codes", type=int, metavar="K", help="number of primal/dual pairs")
    parser.add_argument(
        "--pilot",
        type=_number_or_auto,
        metavar="K0",
        help="of these, codes to photograph one by one first, to learn sharp far paths: 8, 12 or "
        "16 before mirrors, else 32, 64 or 128; auto where its first four are worth their files "
        "(the default where nothing else says how codes are spent)",
    )
    parser.add_argument(
        "--smooth",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="correct indirect light for its smooth part, by a model that the photo itself gives "
        "(default: with hadamard codes)",
    )
    parser.add_argument(
        "--grey-masks",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="let masks of long- and short-range light have grey levels, which count it more "
        "evenly, for less light (default: where the mask can show them and its levels are known)",
    )
    parser.add_argument(
        "--parts",
        type=_number_or_auto,
        metavar="B",
        help="exposures to split the codes over, or auto; from 4 on they measure the error of the "
        "codes (default: auto where nothing else says how codes are spent)",
    )
    parser.add_argument(
        "--until-error",
        type=share,
        metavar="E",
        help="stop after the part that brings the mean error down to E, say 1%%",
    )


def _wanted_options(parser: argparse.ArgumentParser) -> None:
    """Add what the planner goes by where it chooses codes and exposures itself."""
    parser.add_argument(
        "--error",
        type=share,
        metavar="E",
        help="wanted RMS error as a share of the picture's RMS, say 1%%; chooses codes and "
        "exposures",
    )
    parser.add_argument(
        "--confidence",
        type=share,
        metavar="C",
        help="how sure that error shall be kept; default 95%%",
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


def _panel_options(parser: argparse.ArgumentParser) -> None:
    """Add what part of a cell opens, and which refreshes keep codes apart."""
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
        "after its code) or 3 (tail, for slow masks; full); auto by the measured lag of the mask",
    )


def method_option(parser: argparse.ArgumentParser) -> None:
    """Add the way to take the photo."""
    parser.add_argument("--method", choices=METHODS, default="coded", help="default: coded")


def export_options(parser: argparse.ArgumentParser) -> None:
    """Add which pictures, in which form, and where to."""
    parser.add_argument(
        "--format",
        required=True,
        choices=("exr", "tiff16", "png16", "npz"),
        help="32-bit floats (exr, npz), or 16 bits a colour, linear",
    )
    parser.add_argument(
        "--picture", action="append", metavar="NAME", help="which one; again for more; default: all"
    )
    parser.add_argument(
        "--out", type=Path, default=Path(), metavar="DIR", help="default: here; no run folder"
    )
    parser.add_argument(
        "--upright",
        action="store_true",
        help="as the projector sees the scene, cropped to the field; default: as the camera does",
    )
    white_patch_option(parser, "make what lies at X Y of the field grey; default: colours as taken")
    parser.add_argument(
        "--range",
        type=float,
        nargs=2,
        metavar=("BLACK", "WHITE"),
        help="scene units that become 0 and 65535 in 16 bits; default: 0 and a power of two",
    )
    parser.add_argument("--force", action="store_true", help="replace files that are there")
