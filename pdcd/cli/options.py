"""Options that several commands share; those of a photo are in `pdcd.cli.request`."""

from __future__ import annotations

import argparse
from pathlib import Path


def share(text: str) -> float:
    """Read "1%" or "0.01"; argparse reports the ValueError of anything else."""
    number = text.removesuffix("%")
    return float(number) / (100.0 if number != text else 1.0)


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
    parser.add_argument(
        "--white-patch",
        type=float,
        nargs=2,
        metavar=("X", "Y"),
        help="make what lies at X Y of the field grey, from 0 0 at its upper left corner to 1 1; "
        "default: colours as taken",
    )
    parser.add_argument(
        "--range",
        type=float,
        nargs=2,
        metavar=("BLACK", "WHITE"),
        help="scene units that become 0 and 65535 in 16 bits; default: 0 and a power of two",
    )
    parser.add_argument("--force", action="store_true", help="replace files that are there")


def queue_option(parser: argparse.ArgumentParser) -> None:
    """Add --queue."""
    parser.add_argument("--queue", action="store_true", help="wait while the rig is taken")


def config_option(parser: argparse.ArgumentParser, text: str) -> None:
    """Add --config; `text` says what for."""
    parser.add_argument("--config", type=Path, metavar="FILE", help=text)
