"""`pdcd show` and `pdcd timing`: the panels alone, without camera and daemon."""

from __future__ import annotations

import argparse
import time

import msgspec

from pdcd.bench.config import load
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say, say_json, say_table, tell

LOOP_S = 60.0
"""Length of one pass of `pdcd show --loop`; a few black refreshes lie between two."""


def show(args: argparse.Namespace) -> int:
    """Hold a pattern, or run all codes over and over, until Ctrl-C or for some time."""
    from pdcd.capture.rig import Rig
    from pdcd.capture.show import loop_frames, pattern_frames
    from pdcd.errors import Cancelled

    config = load(args.config)
    # A lost refresh is no reason to stop showing.
    config = msgspec.structs.replace(
        config, rig=msgspec.structs.replace(config.rig, on_miss="flag")
    )
    rig = Rig(config)
    grid = rig.grid
    end_s = time.monotonic() + (args.seconds if args.seconds is not None else float("inf"))
    display = rig.display
    try:
        display.connect()
        tell("Ctrl-C ends" if args.seconds is None else f"for {args.seconds:g} s")
        if not args.loop:
            display.show(pattern_frames(args.pattern, args.index, grid, config))
            while time.monotonic() < end_s:
                rig.clock.sleep_until_ns(rig.clock.now_ns() + 50_000_000)
            return DONE
        display.load(loop_frames(grid, config, LOOP_S))
        while time.monotonic() < end_s:
            try:
                display.play(lambda *_: None, lambda: time.monotonic() >= end_s)
            except Cancelled:
                break
        return DONE
    finally:
        display.disconnect()


def timing(args: argparse.Namespace) -> int:
    """Show random codes and tell how regular they were; fails when refreshes were missed."""
    from pdcd.presenter.timing import histogram, measure

    found = measure(load(args.config), args.frames)
    missed = int(found.missed.sum())
    if args.out is not None:
        histogram(found, args.out)
    if args.json:
        times = {name: {"p50_ms": a, "p99_ms": b, "max_ms": c} for name, a, b, c in found.table()}
        ready = found.ready
        say_json(
            {
                "refreshes": args.frames,
                "missed": missed,
                "refresh_hz": ready.refresh_hz,
                "source": ready.source,
                "times": times,
                "identity": ready.identity,
            }
        )
        return FAILED if missed else DONE
    say_table(
        [
            ["ms", "median", "99 %", "longest"],
            *([name, *(f"{t:.3f}" for t in times)] for name, *times in found.table()),
        ]
    )
    for name, value in found.ready.identity.items():
        say(f"{name}: {value}")
    say(f"{args.frames} refreshes at {found.ready.refresh_hz:.4f} Hz, {missed} missed")
    return FAILED if missed else DONE
