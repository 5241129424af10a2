"""`pdcd preview`: what the camera sees, live, with figures for focus and exposure."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

from pdcd.api.progress import tell_user
from pdcd.api.signals import hold_signals, send_signals_to
from pdcd.bench.config import load_config
from pdcd.cli.daemon import find_daemon
from pdcd.cli.exits import DONE
from pdcd.cli.output import say, say_json, say_result
from pdcd.cli.streams import write_stdout
from pdcd.errors import ConfigError
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.protocol.views import LiveFrame

_MOST_S = 1e9
"""Longest time of a live view; without `--seconds` it goes on for ever."""
_LINE_S = 1.0
"""Time between two lines of figures."""


def show_live_view(args: argparse.Namespace) -> int:
    """Show the live view until Ctrl-C or for some time. If a daemon answers, it takes the pictures,
    as it holds the rig; else this process does. With `--web` the view is on a page."""
    if args.seconds is not None and not 0.0 <= args.seconds <= _MOST_S:
        raise ConfigError(f"--seconds {args.seconds:g} is not between 0 and {_MOST_S:g}")
    if args.web:
        return _serve(args)
    shown = _Shown(args)
    client = find_daemon(args)
    if client is None:
        result = _look_here(args, shown.take)
    else:
        with client, send_signals_to(signal.default_int_handler):
            result = client.live(shown.take, args.pattern, args.index, picture=args.out is not None)
    return shown.end(result)


def _serve(args: argparse.Namespace) -> int:
    from pdcd.cli.web import serve_web

    given = [name for name in ("out", "seconds", "json") if getattr(args, name)]
    if given or (args.pattern, args.index) != ("white", 0):
        what = f"--{given[0]}" if given else "a pattern"
        raise ConfigError(f"--web goes without {what}", hint="choose it on the page")
    args.state_dir, args.host = None, "127.0.0.1"
    return serve_web(args, first="live")


def _look_here(args: argparse.Namespace, take: Callable[[LiveFrame], bool]) -> CaptureResult:
    """The same with the devices of this process."""
    from pdcd.capture.engine import Engine

    engine, enough = Engine.from_config(load_config(args.config)), False

    def tell(frame: LiveFrame) -> None:
        nonlocal enough
        enough = take(frame)

    with hold_signals(delivers=False) as interrupted:
        try:
            engine.start()
            return engine.live(
                args.pattern,
                args.index,
                job=make_job_id(),
                tell=tell,
                cancelled=lambda: enough or interrupted(),
            )
        finally:
            engine.stop()


class _Shown:
    """Prints figures as they come: a line a second, rewritten in place on a terminal, or JSON."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._json: bool = args.json
        self._out: Path | None = args.out
        self._seconds: float | None = args.seconds
        self._begun_s: float | None = None
        self._next_s = 0.0
        self._last: LiveFrame | None = None
        self._rewrites = not args.json and sys.stdout.isatty()
        if not args.json:
            tell_user("Ctrl-C ends" if args.seconds is None else f"for {args.seconds:g} s")

    def take(self, frame: LiveFrame) -> bool:
        """Show the figures of a picture; returns whether it is the last one wanted."""
        now_s = time.monotonic()
        if self._begun_s is None:  # the time it took to begin does not count
            self._begun_s = now_s
        self._last = frame
        if self._json:
            say_json({name: getattr(frame, name) for name in _FIGURES})
        elif now_s >= self._next_s:
            self._next_s = now_s + _LINE_S
            line = _describe(frame)
            write_stdout(f"\r{line}\x1b[K" if self._rewrites else f"{line}\n")
        return self._seconds is not None and now_s - self._begun_s >= self._seconds

    def end(self, result: CaptureResult) -> int:
        """Keep the last picture, and print how the view ended; ending on request is no failure."""
        if self._rewrites and self._last is not None:
            write_stdout("\n")
        if self._out is not None and self._last is not None:
            _keep(self._last, self._out)
            if not self._json:
                say(str(self._out))
        if result.state == "failed":
            return say_result(result, as_json=self._json)
        for text in result.warnings:
            tell_user(f"warning: {text}")
        if result.state == "done":
            tell_user("ended by another command")
        return DONE


_FIGURES = (
    "number", "t_mono_ns", "rate_hz", "focus", "best", "mean", "saturated", "outline",
)  # fmt: skip
"""Figures of a picture in JSON."""


def _describe(frame: LiveFrame) -> str:
    return (
        f"focus {frame.focus:.3f} (best {frame.best:.3f}), mean light {frame.mean:.1%}, "
        f"saturated {frame.saturated:.2%}, {frame.rate_hz:.1f} pictures/s"
    )


def _keep(frame: LiveFrame, path: Path) -> None:
    """Write a picture with the field's outline as PNG."""
    import cv2
    import numpy as np

    from pdcd.files.images import decode_jpeg
    from pdcd.pictures.written.picture_files import write_png

    picture = decode_jpeg(frame.jpeg)
    if picture is None:
        raise ConfigError("the last picture cannot be read", hint="look again")
    if frame.outline:
        corners = np.rint(np.array(frame.outline) * frame.size_px - 0.5).astype(np.int32)
        cv2.polylines(picture, [corners], isClosed=True, color=_AMBER)
    write_png(path, picture)


_AMBER = (224, 163, 60)
