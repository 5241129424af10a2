"""`pdcd report`: one page with everything of a run, which opens from the disk."""

from __future__ import annotations

import argparse

from pdcd.api.progress import show_bar, watch_decoding
from pdcd.cli.exits import DONE
from pdcd.cli.output import say, say_json
from pdcd.pages.report import write_report


def report(args: argparse.Namespace) -> int:
    """Write the page and say where it is."""
    with show_bar("reading") as show:
        path = write_report(args.folder, args.out, watch_decoding(show))
    size_bytes = path.stat().st_size
    if args.json:
        say_json({"file": str(path), "size_bytes": size_bytes})
    else:
        say(f"{path}: {size_bytes / 1e6:.1f} MB, opens in a browser without a network")
    return DONE
