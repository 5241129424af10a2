"""`pdcd export`: pictures of a finished run as files for other programs."""

from __future__ import annotations

import argparse
import hashlib
from typing import TYPE_CHECKING

from pdcd.cli.exits import DONE
from pdcd.cli.output import say, say_json, say_verdict
from pdcd.errors import RequestError

if TYPE_CHECKING:
    from pdcd.pictures.written.export import ExportedFile


def export(args: argparse.Namespace) -> int:
    """Write the files, either all of them or none, and say what did not fit into them."""
    from pdcd.files.put import check_name_free, write_atomic
    from pdcd.pictures.written.export import ExportRequest, export_run_pictures
    from pdcd.runs.place import HeldFolder

    if args.white_patch is not None and not all(0.0 <= at <= 1.0 for at in args.white_patch):
        raise RequestError("a white patch lies at 0 to 1 across and 0 to 1 down")
    asked = ExportRequest(
        format=args.format,
        pictures=tuple(args.picture or ()),
        upright=args.upright,
        white_patch=None if args.white_patch is None else tuple(args.white_patch),
        span=None if args.range is None else tuple(args.range),
    )
    files = export_run_pictures(args.folder, asked, lambda: None)
    with HeldFolder.at(args.out) as place:
        where = str(place.real)
        if not args.force:
            for file in files:
                check_name_free(place.fd, file.name, where)
        for file in files:
            write_atomic(place.fd, file.name, file.data, replace=args.force, shown=where)
    for file in files:
        if args.json:
            say_json(_told(file, where))
        else:
            _say(file, where)
    if not args.json:
        say_verdict(files[0].quality, ())
    return DONE


def _told(file: ExportedFile, where: str) -> dict[str, object]:
    """A line on one written file."""
    black, white = file.span or (None, None)
    return {
        "file": f"{where}/{file.name}",
        "picture": file.picture,
        "sha256": hashlib.sha256(file.data).hexdigest(),
        "size_px": file.size_px,
        "black": black,
        "white": white,
        "below": file.below,
        "above": file.above,
        "unknown": file.unknown,
        "verdict": file.quality.verdict,
    }


def _say(file: ExportedFile, where: str) -> None:
    width, height = file.size_px
    say(f"{where}/{file.name}: {width} x {height}")
    if file.span is not None:
        black, white = file.span
        say(f"  black is {black:g}, white is {white:g} scene units")
        for count, words in ((file.below, "below black"), (file.above, "above white")):
            if count:
                say(f"  clipped: {count} values {words}, {100.0 * count / file.values:.2g} %")
    if file.unknown:
        say(f"  not known: {file.unknown} values")
