"""`pdcd preview`: what the camera sees, live, with figures for focus and exposure."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Callable
from pathlib import Path

from pdcd.api.progress import tell_user
from pdcd.api.signals import hold_signals, send_signals_to
from pdcd.bench.config import load_config
from pdcd.cli.daemon import find_daemon
from pdcd.cli.exits import DONE
from pdcd.cli.live_figures import LiveFigures
from pdcd.cli.output import say, say_result
from pdcd.errors import ConfigError
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.protocol.views import LiveFrame

_MOST_S = 1e9
"""Longest time of a live view; without `--seconds` it goes on for ever."""


def show_live_view(args: argparse.Namespace) -> int:
    """Show the live view until Ctrl-C or for some time. If a daemon answers, it takes the pictures,
    as it holds the rig; else this process does. With `--web` the view is on a page."""
    if args.seconds is not None and not 0.0 <= args.seconds <= _MOST_S:
        raise ConfigError(f"--seconds {args.seconds:g} is not between 0 and {_MOST_S:g}")
    if args.web:
        return _serve(args)
    shown = LiveFigures(args.seconds, as_json=args.json)
    last: list[LiveFrame] = []

    def take(frame: LiveFrame) -> bool:
        last[:] = [frame]
        return shown.show(
            lambda: {name: getattr(frame, name) for name in _FIGURES}, lambda: _describe(frame)
        )

    client = find_daemon(args)
    if client is None:
        result = _look_here(args, take)
    else:
        with client, send_signals_to(signal.default_int_handler):
            result = client.live(take, args.pattern, args.index, picture=args.out is not None)
    shown.end()
    if args.out is not None and last:
        _keep(last[0], args.out)
        if not args.json:
            say(str(args.out))
    return _say_end(result, as_json=args.json)


def _say_end(result: CaptureResult, *, as_json: bool) -> int:
    """Print how the view ended; ending on request is no failure."""
    if result.state == "failed":
        return say_result(result, as_json=as_json)
    for text in result.warnings:
        tell_user(f"warning: {text}")
    if result.state == "done":
        tell_user("ended by another command")
    return DONE


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
