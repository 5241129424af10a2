"""``python -m tests.stream_bench [ring | chain | moving | cancel]``: see `tests.stream_bench`.

ring : the product alone; frames were made beforehand, with noise of their own, and come over GigE
Vision. chain : the mock makes them as they are wanted. moving : so it does of a scene that moves,
three times a second. cancel : how soon a stream ends that is cancelled at random moments.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

import msgspec

from pdcd.capture.engine import Engine
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.protocol.stream import StreamedPicture, StreamRequest
from pdcd.runs.recording import StreamListener
from tests import world
from tests.genicam_rig import own_network
from tests.stream_bench.meter import Meter, say
from tests.stream_bench.players import Mode, Player, Players, players
from tests.stream_bench.recorded import (
    SIZES,
    RecordedStream,
    make_config,
    make_request,
    record_stream,
)

_MOVING_HZ = 3.0


@contextmanager
def served_engine(
    recorded: RecordedStream, mode: Mode, size: str, margin_s: float
) -> Iterator[tuple[Engine, Players]]:
    """The product, before a camera in another process."""
    with (
        tempfile.TemporaryDirectory() as folder,
        own_network(),
        players(recorded, mode, size, Path(folder)) as beside,
    ):
        config = make_config(Path(folder), size, served=True, margin_s=margin_s)
        options = {**config.camera.options, "black_dn": recorded.black_dn}
        camera = msgspec.structs.replace(config.camera, options=options)
        engine = Engine.with_child(msgspec.structs.replace(config, camera=camera))
        Player(engine._rig, recorded, beside.send)
        engine.start()
        try:
            yield engine, beside
        finally:
            engine.stop()


def stream(
    engine: Engine,
    request: StreamRequest,
    tell: Callable[[StreamedPicture], object],
    over: Callable[[], bool],
) -> CaptureResult:
    """Stream until it is over."""
    return engine.stream(request, job=make_job_id(), listener=StreamListener(tell, over))


def measure_stream(args: argparse.Namespace, recorded: RecordedStream) -> None:
    """Stream, and print what it cost."""
    rate_hz = _MOVING_HZ if args.mode == "moving" else args.rate
    with served_engine(recorded, args.mode, args.size, args.margin) as (engine, beside):
        processes = {"simulator": beside.camera}
        if beside.mock is not None:
            processes["mock"] = beside.mock
        truth = None if args.mode == "moving" else recorded.truth
        meter = Meter(engine, args.pictures, truth, processes)
        result = stream(engine, make_request(args.codes, rate_hz), meter.tell, lambda: meter.over)
        if result.error is None or result.error["kind"] != "cancelled":
            say(f"{result.state}: {result.error}")
        meter.report()


def measure_cancels(args: argparse.Namespace, recorded: RecordedStream) -> None:
    """Cancel streams at random moments, and print how soon they had ended."""
    rng, took_s = Random(args.seed), list[float]()
    with served_engine(recorded, "ring", args.size, args.margin) as (engine, _):
        for _ in range(args.pictures):
            first, over = threading.Event(), threading.Event()
            at_s = list[float]()

            def cancel(
                first: threading.Event = first,
                over: threading.Event = over,
                at_s: list[float] = at_s,
            ) -> None:
                first.wait(120.0)
                time.sleep(rng.uniform(0.0, 1.0))
                at_s.append(time.monotonic())
                over.set()

            thread = threading.Thread(target=cancel)
            thread.start()

            def see(_: StreamedPicture, first: threading.Event = first) -> None:
                first.set()

            result = stream(engine, make_request(args.codes), see, over.is_set)
            ended_s = time.monotonic()
            thread.join()
            assert result.state == "cancelled", result
            took_s.append(ended_s - at_s[0])
    took_s.sort()
    say(
        f"{len(took_s)} cancels: the stream had ended, panels black and shutter closed, after "
        f"{1e3 * took_s[len(took_s) // 2]:.0f} ms (median), {1e3 * took_s[-1]:.0f} ms at most"
    )


def main() -> None:
    """Record a stream, play it, and print what it cost."""
    parser = argparse.ArgumentParser(prog="python -m tests.stream_bench", description=__doc__)
    parser.add_argument("mode", nargs="?", default="ring",
                        choices=("ring", "chain", "moving", "cancel"))  # fmt: skip
    parser.add_argument("--pictures", type=int, default=300, help="or cancels")
    parser.add_argument("--codes", type=int, default=32)
    parser.add_argument("--rate", type=float, default=1000.0, help="pictures a second, at most")
    parser.add_argument("--margin", type=float, default=0.02, help="of exposures, s")
    parser.add_argument("--size", choices=SIZES, default="whole")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    world.enter()
    recorded = record_stream(make_request(args.codes), args.size)
    say(
        f"{args.mode}, {args.size}, {args.codes} codes a photo; {len(recorded.photos)} photos "
        f"recorded; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; RMS error of a "
        f"capture by the same codes {100.0 * recorded.rms_error:.2f} %"
    )
    if args.mode == "cancel":
        measure_cancels(args, recorded)
    else:
        measure_stream(args, recorded)


if __name__ == "__main__":
    main()
