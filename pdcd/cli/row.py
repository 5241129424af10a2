"""`pdcd row`: one row of the realised probing matrix of a finished run, as picture and figures."""

from __future__ import annotations

import argparse

from pdcd.arrays import Floats
from pdcd.cli.exits import DONE
from pdcd.cli.output import say_json, say_table, say_text
from pdcd.pictures.row import read_matrix_row
from pdcd.pictures.written.picture_files import write_png
from pdcd.runs.folder import name_row_file


def draw_matrix_row(args: argparse.Namespace) -> int:
    """Write the picture; print least, mean and largest weight, both wanted and realised."""
    down, right = args.cell
    found = read_matrix_row(args.folder, (down, right), args.photo)
    path = args.out or args.folder / name_row_file(found.photo, (down, right))
    write_png(path, found.picture((down, right)))
    figures = {"wanted": _figures(found.wanted), "realised": _figures(found.realised)}
    if args.json:
        say_json({"photo": found.photo, "cell": [down, right], "file": str(path), **figures})
        return DONE
    say_text(f"photo {found.photo}, cell {down} {right}; wanted and realised side by side: {path}")
    say_table(
        [
            ["", *figures["wanted"]],
            *([name, *(f"{v:.6g}" for v in f.values())] for name, f in figures.items()),
        ]
    )
    return DONE


def _figures(weights: Floats) -> dict[str, float]:
    return {
        "min": float(weights.min()),
        "mean": float(weights.mean()),
        "max": float(weights.max()),
    }
