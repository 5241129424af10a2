"""`pdcd batch`: takes the photos of a table, skips those that are done, retries those that fail.

`pdcd.cli.batch_table` reads the table; `pdcd.api.sweep` takes the photos and knows which are done.
"""

from __future__ import annotations

import argparse
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pdcd.api.connected import DaemonBench
from pdcd.api.progress import tell_user
from pdcd.api.signals import send_signals_to
from pdcd.api.sweep import sweep
from pdcd.api.table import Table
from pdcd.api.task import TaskRecord
from pdcd.bench.config import load_config
from pdcd.cli.batch_table import read_batch_table
from pdcd.cli.daemon import connect_daemon, refuse_with_local
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import draw_table, say, say_json
from pdcd.errors import ConfigError, disk_errors
from pdcd.files.put import replace_file
from pdcd.protocol.line_talk import UnreachableError

_TABLE, _SUMMARY = "table.csv", "summary.txt"
"""Files that are written below `--out`: all figures of each photo, and the printed summary."""
_FOR_GOOD = ("request", "config", "denied", "driver_unavailable")
"""Kinds of errors that a retry does not mend."""

_Photos = Sequence[Mapping[str, Any]]
_Taken = Callable[[Callable[[TaskRecord], None]], Table]


def take_batch(args: argparse.Namespace) -> int:
    """Take all photos; fails when any of them is not done in the end."""
    refuse_with_local(args, "socket")
    if args.workers is not None and not args.local:
        raise ConfigError("--workers goes with --local", hint="a daemon takes one at a time")
    if args.retries < 0 or not 0.0 <= args.pause <= 86400.0:
        raise ConfigError(
            f"--retries {args.retries} --pause {args.pause:g} is out of range",
            hint="--retries takes 0 or more, --pause seconds from 0 to 86400",
        )
    photos = read_batch_table(args.table)
    out: Path = args.out or Path(args.table.stem)
    try:
        table = _retried(args, photos, out)
    except KeyboardInterrupt:
        tell_user("what is done stays: the same command goes on from there")
        raise
    lines = _summarise(table, photos, out)
    with disk_errors(str(out)):
        out.mkdir(parents=True, exist_ok=True)
        table.to_csv(out / _TABLE)
        replace_file(out / _SUMMARY, "\n".join([*lines, ""]).encode())
    if args.json:
        for row in table:
            say_json(row)
        told = {"photos": len(table), "failed": len(table.failed), "folder": str(out.absolute())}
        say_json({"state": "failed" if len(table.failed) else "done", **told})
    else:
        for line in lines:
            say(line)
    return FAILED if len(table.failed) else DONE


def _retried(args: argparse.Namespace, photos: _Photos, out: Path) -> Table:
    """Take missing photos until all are done, or the retries are used up."""
    take: _Taken = (_take_here if args.local else _take_there)(args, photos, out)
    for left in range(args.retries, -1, -1):
        try:
            table = take(_make_teller(photos))
        except UnreachableError as err:
            if not left:
                raise
            tell_user(f"{err}; again in {args.pause:g} s")
        else:
            again = [row for row in table.failed if row["error_kind"] not in _FOR_GOOD]
            if not again or not left:
                return table
            tell_user(f"{len(again)} photos failed; they are tried again in {args.pause:g} s")
        time.sleep(args.pause)
    raise AssertionError  # the last try returns or raises


def _take_here(args: argparse.Namespace, photos: _Photos, out: Path) -> _Taken:
    """On benches in this process, or in worker processes."""
    config = load_config(args.config)

    def take(tell: Callable[[TaskRecord], None]) -> Table:
        return sweep(config, photos, workers=args.workers or 0, folder=out, progress=tell)

    return take


def _take_there(args: argparse.Namespace, photos: _Photos, out: Path) -> _Taken:
    """On the daemon's bench, waiting for other users of it."""

    def take(tell: Callable[[TaskRecord], None]) -> Table:
        with (
            send_signals_to(signal.default_int_handler),
            DaemonBench(connect_daemon(args, drives=True), queue=True) as bench,
        ):
            return sweep(bench, photos, folder=out, progress=tell)

    return take


def _make_teller(photos: _Photos) -> Callable[[TaskRecord], None]:
    """A function that prints a line for each photo as it ends."""

    def tell(row: TaskRecord) -> None:
        tell_user(f"photo {_call(row, photos)}: {row['state']}, {row['verdict'] or row['error']}")

    return tell


def _call(row: TaskRecord, photos: _Photos) -> str:
    """A label for a photo: its number in the table, from 1, its goal and its name."""
    number = int(row["number"] or 0)
    name = photos[number].get("name")
    return f"{number + 1} of {len(photos)} {row['goal']}" + f" {name}" * bool(name)


def _summarise(table: Table, photos: _Photos, out: Path) -> list[str]:
    """A table of all photos with a few columns, why some failed, and how many are done."""
    rows = [["photo", "goal", "name", "state", "verdict", "codes", "rms sigma", "folder"]]
    faults = []
    for row in table:
        number, sigma = int(row["number"] or 0), row["rms_sigma"]
        shown = f"{100.0 * sigma:.3g} %" if isinstance(sigma, float) else None
        told = (number + 1, row["goal"], photos[number].get("name"), row["state"], row["verdict"])
        cells = (*told, row["codes"], shown, row["folder"])
        rows.append(["-" if cell is None else str(cell) for cell in cells])
        if row["state"] != "done":
            faults.append(f"photo {number + 1}: {row['error']}")
    done = f"{len(table) - len(faults)} of {len(table)} photos are done"
    return [*draw_table(rows), *faults, f"{done}; all figures: {out / _TABLE}"]
