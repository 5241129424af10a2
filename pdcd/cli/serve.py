"""`pdcd serve`: the daemon."""

from __future__ import annotations

import argparse
import gc
from functools import partial
from typing import Any

from pdcd.capture.worker.calls import start_worker
from pdcd.child import Child


def serve(args: argparse.Namespace) -> int:
    """Run the daemon until SIGTERM or SIGINT, or start one that runs on."""
    if args.background:
        from pdcd.cli.starting import serve_in_background

        return serve_in_background(args)
    # Started first, as it imports for a second what it needs, while we do the same; and from the
    # main thread, which lives as long as the daemon.
    child = start_worker()
    try:
        return _serve(args, child)
    finally:
        child.kill()


def _serve(args: argparse.Namespace, child: Child[Any]) -> int:
    gc.disable()  # imports make no garbage; looking for it takes a tenth longer

    import msgspec

    from pdcd.bench.config import load_config
    from pdcd.capture.engine import Engine
    from pdcd.server.daemon import run_daemon

    gc.enable()

    settings = load_config(args.config)
    if args.state_dir is not None:
        server = msgspec.structs.replace(settings.server, state_dir=str(args.state_dir.absolute()))
        settings = msgspec.structs.replace(settings, server=server)
    engine = partial(Engine.with_child, child=child)
    return run_daemon(settings, socket=args.socket, engine_factory=engine, verbose=args.verbose)
