"""`pdcd show` and `pdcd timing`: the panels alone, without a camera."""

from __future__ import annotations

import argparse
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import msgspec

from pdcd.api.progress import tell_user
from pdcd.api.signals import send_signals_to
from pdcd.bench.config import load_config
from pdcd.cli.daemon import find_daemon
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say, say_json, say_table
from pdcd.client import Client
from pdcd.errors import BusyError, Cancelled, ConfigError
from pdcd.protocol.line_talk import UnreachableError
from pdcd.words import MovingName

if TYPE_CHECKING:
    from pdcd.bench.devices import Display
    from pdcd.bench.tables import Config
    from pdcd.panels.frames import Frames

_MOCK = "mock"
_NOTHING_TO_SEE = "these are the mock bench's panels, which exist as numbers only: nothing to see"
"""What to say if the driver is `_MOCK`, so that the user does not look for a window."""

_SIDES = "left: projector", "right: mask"
_MOST_S = 1e9
"""Longest time to show a pattern for; without `--seconds` it is shown for ever."""
_LOOP_S = 60.0
"""Length of one pass of `pdcd show --loop`; a few black refreshes lie between passes."""


def show_pattern(args: argparse.Namespace) -> int:
    """Show a pattern until Ctrl-C or for some time. If a daemon answers, it does so, as it holds
    the panels; else this process does."""
    if args.seconds is not None and not 0.0 <= args.seconds <= _MOST_S:
        raise ConfigError(f"--seconds {args.seconds:g} is not between 0 and {_MOST_S:g}")
    client = find_daemon(args, needed=args.detach, drives=True)
    if client is None:
        return _show_here(args)
    with client:
        return _show_there(args, client)


def _show_there(args: argparse.Namespace, client: Client) -> int:
    """Ask the daemon; the picture stays while this command runs, or for good if detached."""
    if args.loop or args.pattern in get_args(MovingName):
        raise BusyError(
            "the daemon has the panels, and shows single patterns only",
            hint="show one that stays, or end the daemon for as long as you look",
        )
    shown = client.show(args.pattern, args.index, detach=args.detach)
    if args.json:
        say_json(shown)
    else:
        say(f"{_picture(shown.pattern, shown.index)}: job {shown.job}")
    if client.hello.drivers.get("display") == _MOCK:
        tell_user(_NOTHING_TO_SEE + "; pdcd show without a daemon draws them")
    if args.pattern == "black":
        return DONE
    if args.detach:
        tell_user(f"it stays: pdcd cancel {shown.job}, or pdcd show black, ends it")
        return DONE
    with send_signals_to(signal.default_int_handler):
        try:
            tell_user("Ctrl-C ends" if args.seconds is None else f"for {args.seconds:g} s")
            if args.seconds is None:
                client.wait(shown.job)
            else:
                client.call("capture.wait", {"job": shown.job}, timeout_s=args.seconds)
        except KeyboardInterrupt:
            client.cancel(shown.job)
        except UnreachableError:
            if args.seconds is None:
                raise
            client.cancel(shown.job)  # its time is over; this fails if the daemon is gone
        else:
            tell_user("ended by another command")
    return DONE


def _show_here(args: argparse.Namespace) -> int:
    """Drive the panels from this process."""
    from pdcd.capture.rig import Rig
    from pdcd.capture.show import make_loop_frames, make_pattern_frames, make_pixel_frames

    config = load_config(args.config)
    # A missed refresh is no reason to stop showing.
    config = msgspec.structs.replace(
        config, rig=msgspec.structs.replace(config.rig, on_miss="flag")
    )
    rig = Rig(config)
    grid = rig.grid
    moving = args.loop or args.pattern in get_args(MovingName)
    if args.loop:
        frames = make_loop_frames(grid, config, _LOOP_S)
    elif moving:
        frames = make_pixel_frames(args.pattern, config, _LOOP_S)
    elif args.pattern != "black":
        frames = make_pattern_frames(args.pattern, args.index, grid, config)
    else:
        frames = None
    if args.json:
        say_json({"pattern": "loop" if args.loop else args.pattern, "index": args.index})
    if config.display.driver == _MOCK:
        _draw(args, config, frames)
        return DONE
    end_s = time.monotonic() + (args.seconds if args.seconds is not None else float("inf"))
    try:
        rig.display.connect()
        if frames is None:
            return DONE
        tell_user("Ctrl-C ends" if args.seconds is None else f"for {args.seconds:g} s")
        if moving:
            _play(rig.display, frames, end_s)
        else:
            rig.display.show(frames)
            while time.monotonic() < end_s:
                rig.clock.sleep_until_ns(rig.clock.now_ns() + 50_000_000)
        return DONE
    finally:
        rig.display.disconnect()


def _play(display: Display, frames: Frames, end_s: float) -> None:
    """Show frames over and over until a monotonic time."""
    display.load(frames)
    while time.monotonic() < end_s:
        try:
            display.play(lambda *_: None, lambda: time.monotonic() >= end_s)
        except Cancelled:
            break


def _draw(args: argparse.Namespace, config: Config, frames: Frames | None) -> None:
    """Draw what would be shown on the mock's panels, into a picture file."""
    import numpy as np

    from pdcd.bench.placed import panels_of
    from pdcd.capture.show import draw_sheet
    from pdcd.pictures.written.picture_files import draw_caption, write_png

    what = "all codes" if args.loop else _picture(args.pattern, args.index)
    sizes = [f"{p.size_px[0]} x {p.size_px[1]} px" for p in (config.projector, config.mask)]
    tell_user("{}: would be on a projector of {} and a mask of {}".format(what, *sizes))
    if frames is None:
        tell_user(_NOTHING_TO_SEE)
        return
    name = "loop" if args.loop else args.pattern
    path = args.out if args.out is not None else Path(f"show-{name}.png")
    drawn = draw_sheet(frames, panels_of(config))
    notes = [f"{side} of {size}" for side, size in zip(_SIDES, sizes, strict=True)]
    write_png(path, np.concatenate([drawn, draw_caption(drawn.shape[1], what, notes, ())]))
    say(str(path))


def _picture(pattern: str, index: int) -> str:
    """What both panels show, in words; the mask's pattern follows `pdcd.capture.show`."""
    name = f"code {index}" if pattern == "code" else pattern
    if pattern in ("projector", "mask"):
        return f"the {pattern} alone, white"
    if pattern not in ("checker", "code"):
        return f"{name} on projector and mask"
    return f"{name} on the projector, its complement on the mask"


def measure_timing(args: argparse.Namespace) -> int:
    """Show random codes and print how regular they were; fails when refreshes were missed."""
    from pdcd.presenter.timing import draw_histogram, measure_refreshes

    found = measure_refreshes(load_config(args.config), args.frames)
    missed = int(found.missed.sum())
    if args.out is not None:
        draw_histogram(found, args.out)
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
