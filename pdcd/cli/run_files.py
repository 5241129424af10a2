"""`pdcd decode`, `verify`, `export`, `report`, `row`: what is made of the files of a run."""

from __future__ import annotations

import argparse
import hashlib
import re
from typing import TYPE_CHECKING

from pdcd.api.progress import bar
from pdcd.bench.calibration import RECORD
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say, say_compared, say_json, say_table, say_text
from pdcd.errors import ConfigError, RequestError
from pdcd.protocol.events import Decoded
from pdcd.runs.later import row_name
from pdcd.runs.verify import Verified, verify
from pdcd.runs.verify_calibration import verify_calibration
from pdcd.watch import Watch

if TYPE_CHECKING:
    from pdcd.pictures.row import Floats
    from pdcd.pictures.written.export import Exported

TOLD = ("picture", "size_px", "below", "above", "unknown")
"""What JSON tells of a file as `pdcd.pictures.written.export.Exported` has it."""


def decode(args: argparse.Namespace) -> int:
    """Decode a run again; fails when a picture differs from the one kept."""
    from pdcd.pictures.decode import decode_folder

    if args.out is not None and not args.partial:
        raise ConfigError("--out goes with --partial: a finished run is only compared")
    with bar("reading") as show:
        watch = Watch(step=lambda done, total: show(Decoded(done=done, total=total)))
        if args.partial:
            return _salvage(args, watch)
        report = decode_folder(args.folder, watch)
    files = ((file.name, file.identical) for file in report.files)
    return say_compared(report, files, as_json=args.json)


def _salvage(args: argparse.Namespace, watch: Watch) -> int:
    """Make pictures of an unfinished run; fails when any of its shots is missing."""
    from pdcd.capture.salvage import decode_partial

    found = decode_partial(args.folder, args.out, watch)
    if args.json:
        say_json(found)
    else:
        say_table([["state", found.state], ["taken", found.taken], ["folder", found.folder]])
        for text in found.lost:
            say(f"left out: {text}")
    return DONE if found.state == "done" else FAILED


def verify_runs(args: argparse.Namespace) -> int:
    """Look at every folder; fails when one of them is not whole and unchanged."""
    sha256: str | None = args.manifest_sha256
    if sha256 is not None and (len(args.folder) > 1 or not re.fullmatch("[0-9a-fA-F]{64}", sha256)):
        raise ConfigError(
            "--manifest-sha256 takes 64 hexadecimal digits, and goes with one folder",
            hint="capture --json and capture.wait tell it as manifest_sha256",
        )
    found = [
        (verify_calibration if (folder / RECORD).exists() else verify)(
            folder, manifest_sha256=sha256
        )
        for folder in args.folder
    ]
    for run in found:
        if args.json:
            say_json(run)
        else:
            _say_verified(run)
    return DONE if all(run.whole for run in found) else FAILED


def _say_verified(run: Verified) -> None:
    damaged = any(finding.what != "partial" for finding in run.findings)
    state = "whole  " if run.whole else "DAMAGED" if damaged else "PARTIAL"
    say(f"{state}  {run.folder}: {run.files} files, {run.size_bytes} bytes as they were")
    for finding in run.findings:
        say(f"  {finding.what:10}  {finding.path}: {finding.detail}")
    for name in run.later:
        say(f"  made later  {name}: to look at; nothing vouches for it")


def export(args: argparse.Namespace) -> int:
    """Write the files, all or none of which are new, and say what did not fit into them."""
    from pdcd.files.put import put, refuse_taken
    from pdcd.pictures.written.export import Asked, exported
    from pdcd.runs.place import Place

    if args.white_patch is not None and not all(0.0 <= at <= 1.0 for at in args.white_patch):
        raise RequestError("a white patch lies at 0 to 1 across and 0 to 1 down")
    asked = Asked(
        format=args.format,
        pictures=tuple(args.picture or ()),
        upright=args.upright,
        white_patch=None if args.white_patch is None else tuple(args.white_patch),
        span=None if args.range is None else tuple(args.range),
    )
    files = exported(args.folder, asked, lambda: None)
    with Place.at(args.out) as place:
        where = str(place.real)
        if not args.force:
            for file in files:
                refuse_taken(place.fd, file.name, where)
        for file in files:
            put(place.fd, file.name, file.data, replace=args.force, shown=where)
    for file in files:
        if args.json:
            black, white = file.span or (None, None)
            told = {name: getattr(file, name) for name in TOLD}
            sha256 = hashlib.sha256(file.data).hexdigest()
            told |= {"file": f"{where}/{file.name}", "sha256": sha256}
            say_json({**told, "black": black, "white": white})
        else:
            _say_exported(file, f"{where}/{file.name}")
    return DONE


def _say_exported(file: Exported, path: str) -> None:
    width, height = file.size_px
    say(f"{path}: {width} x {height}")
    if file.span is not None:
        say("  black is {:g}, white is {:g} scene units".format(*file.span))
        total = 3 * width * height
        for count, words in ((file.below, "below black"), (file.above, "above white")):
            if count:
                say(f"  clipped: {count} values {words}, {100.0 * count / total:.2g} %")
    if file.unknown:
        say(f"  not known: {file.unknown} values")


def report(args: argparse.Namespace) -> int:
    """Write the page and say where it is."""
    from pdcd.pages.report import write

    with bar("reading") as show:
        watch = Watch(step=lambda done, total: show(Decoded(done=done, total=total)))
        path = write(args.folder, args.out, watch)
    size_bytes = path.stat().st_size
    if args.json:
        say_json({"file": str(path), "size_bytes": size_bytes})
    else:
        say(f"{path}: {size_bytes / 1e6:.1f} MB, opens in a browser without a network")
    return DONE


def row(args: argparse.Namespace) -> int:
    """Write the picture; print least, mean and largest weight, as wanted and as realised."""
    from pdcd.pictures.row import matrix_row
    from pdcd.pictures.written.picture_files import write_png

    down, right = args.cell
    found = matrix_row(args.folder, (down, right), args.photo)
    path = args.out or args.folder / row_name(found.photo, (down, right))
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
