"""`pdcd stream`: picture after picture by one plan, with their rate, latency and error."""

from __future__ import annotations

import argparse
import signal
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from pdcd.api.local import local
from pdcd.api.progress import tell_user
from pdcd.api.signals import send_signals_to
from pdcd.api.stream import ConnectedStream, PictureStream
from pdcd.cli.daemon import find_daemon, refuse_with_local
from pdcd.cli.exits import DONE
from pdcd.cli.live_figures import LiveFigures
from pdcd.cli.output import say
from pdcd.cli.request import collect_array_files, parse_request_options
from pdcd.errors import ConfigError, DiskError, disk_errors
from pdcd.protocol.fields import FieldError, convert_fields
from pdcd.protocol.stream import StreamedPicture, StreamFrame, StreamRequest, to_stream_request

if TYPE_CHECKING:
    from cv2 import VideoWriter

_VIDEO = ".mp4"
_USUAL_HZ, _WAITING = 10.0, 16
"""Pictures a second of a video whose rate is still unknown after this many pictures."""
_HELD_BACK = frozenset({"jpeg", "size_px", "arrays"})
"""Fields of a picture that JSON leaves out."""


def show_stream(args: argparse.Namespace) -> int:
    """Show figures of pictures until Ctrl-C, an error, or for some time. If a daemon answers, it
    takes the pictures, as it holds the rig; else this process does. When nobody reads the figures
    any more, the stream ends, and a message says so."""
    try:
        return _show_stream(args)
    except BrokenPipeError:
        tell_user("nobody reads the figures any more: the stream has ended")
        raise


def _show_stream(args: argparse.Namespace) -> int:
    """The same. Raises BrokenPipeError when nobody reads."""
    refuse_with_local(args, "socket", "queue")
    request = _parse(args)
    shown = LiveFigures(args.lasts_s, as_json=args.json, rewrite_s=0.0)
    with ExitStack() as held:
        keeper = None if args.kept_in is None else held.enter_context(_Keeper(args.kept_in))
        held.enter_context(send_signals_to(signal.default_int_handler))
        with suppress(KeyboardInterrupt):
            stream = held.enter_context(_begin(args, request, held, keeper))
            with suppress(KeyboardInterrupt):
                while (streamed := stream.take()) is not None:
                    if _show(shown, args.goal, streamed.frame):
                        break
                    if keeper is not None:
                        keeper.keep(streamed)
            shown.end()
            if args.record:
                say(str(stream.record().folder))
    return DONE


def _parse(args: argparse.Namespace) -> StreamRequest:
    """The typed options as a request. Raises ConfigError."""
    typed = {"over": args.over, "rate_hz": args.rate, "for_s": args.lasts_s}
    try:
        own = convert_fields(StreamRequest, typed)
    except FieldError as err:
        raise ConfigError(str(err)) from err
    own.pop("for_s", None)  # it counts here, so that a run can be made at the end
    return to_stream_request(parse_request_options(args), **own)


def _begin(
    args: argparse.Namespace, request: StreamRequest, held: ExitStack, keeper: _Keeper | None
) -> PictureStream:
    """The stream; leaving `held` ends what it needs. Raises RequestError, Unreachable."""
    files = collect_array_files(args)
    drawn, counted = keeper is not None and keeper.video, keeper is not None and not keeper.video
    client = None if args.local else find_daemon(args, drives=True)
    if client is None:
        bench = held.enter_context(local(args.config))
        return bench.stream_drawn(request, files, draw=drawn)
    held.enter_context(client)
    job = client.start_stream(request, arrays=files, queue=args.queue)
    return ConnectedStream(client, job, "jpeg" if drawn else "arrays" if counted else "none")


def _show(shown: LiveFigures, goal: str, frame: StreamFrame) -> bool:
    """Show the figures of a picture; returns whether enough were seen."""

    def list_figures() -> dict[str, object]:
        told = msgspec.structs.asdict(frame)
        return {name: told[name] for name in told if name not in _HELD_BACK}

    return shown.show(
        list_figures,
        lambda: f"{goal}: {describe_stream_frame(frame)}",
        at_once=bool(frame.spoilt),
    )


def describe_stream_frame(frame: StreamFrame) -> str:
    """A picture's figures in a line."""
    if frame.spoilt:
        return f"a photo was spoilt: {frame.spoilt}"
    sigma = "unknown"
    if frame.rms_sigma is not None:
        sigma = f"{100.0 * frame.rms_sigma:.2g} %"
        sigma += "" if frame.sigma_kind != "sensor" else " of the sensor alone"
    lost = f", {frame.lost} photos spoilt" if frame.lost else ""
    return (
        f"{frame.rate_hz:.1f} pictures/s, latency {1000.0 * frame.latency_s:.0f} ms, "
        f"sigma {sigma}{lost}"
    )


class _Keeper:
    """Keeps the pictures: drawn into a video, or each as a float TIFF in a folder."""

    def __init__(self, out: Path) -> None:
        """Raises DiskError for a folder that cannot be made."""
        self._out, self.video = out, out.suffix.lower() == _VIDEO
        self._waiting: list[np.ndarray] = []
        self._writer: VideoWriter | None = None
        with disk_errors(str(out)):
            (out.parent if self.video else out).mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> _Keeper:
        return self

    def __exit__(self, *unused: object) -> None:
        if self._waiting:
            self._write(_USUAL_HZ)
        if self._writer is not None:
            self._writer.release()
            say(str(self._out))
        elif not self.video:
            say(str(self._out))

    def keep(self, streamed: StreamedPicture) -> None:
        """Keep a picture; a spoilt photo has none. Raises NoSpaceError and DiskError."""
        if not self.video:
            if streamed.arrays:
                from pdcd.pictures.written.picture_files import write_tiff

                write_tiff(self._out / f"{streamed.number:06d}.tif", streamed.arrays["picture"])
            return
        if not streamed.frame.jpeg:
            return
        from pdcd.files.images import decode_jpeg

        picture = decode_jpeg(streamed.frame.jpeg)
        if picture is None:
            return
        self._waiting.append(np.ascontiguousarray(np.atleast_3d(picture)[..., ::-1]))
        rate_hz = streamed.frame.rate_hz
        if self._writer is not None or rate_hz or len(self._waiting) >= _WAITING:
            self._write(rate_hz or _USUAL_HZ)

    def _write(self, rate_hz: float) -> None:
        """Write the waiting pictures; the rate is that of the first ones. Raises DiskError."""
        import cv2

        height, width = self._waiting[0].shape[:2]
        if self._writer is None:
            code = cv2.VideoWriter.fourcc(*"mp4v")
            made = cv2.VideoWriter(str(self._out), code, rate_hz, (width, height))
            if not made.isOpened():
                raise DiskError(
                    f"cannot write the video {self._out}", hint="check the folder and its rights"
                )
            self._writer = made
        for picture in self._waiting:
            self._writer.write(picture)
        self._waiting.clear()
