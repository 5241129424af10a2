"""`pdcd web`: a page for the person at the bench."""

from __future__ import annotations

import argparse
import asyncio
from contextlib import suppress
from pathlib import Path

from pdcd.api.progress import tell_user
from pdcd.bench.config import load_config
from pdcd.bench.folders import find_state_dir
from pdcd.cli.daemon import connect_daemon, find_daemon_socket
from pdcd.cli.exits import DONE
from pdcd.cli.output import say
from pdcd.errors import ConfigError
from pdcd.extras import suggest_install
from pdcd.protocol.line_talk import UnreachableError
from pdcd.server import log


def serve_web(args: argparse.Namespace, first: str = "") -> int:
    """Serve the page until interrupted; the address to open is printed once. first : the view that
    the page begins with: "live" for a live view."""
    log.send_to_stderr()
    try:
        from pdcd.web.serve import bind_loopback, run_page_server
    except ImportError as err:
        raise ConfigError("pdcd web needs aiohttp", hint=suggest_install("aiohttp")) from err
    given: Path | None = args.state_dir
    state = find_state_dir(load_config(args.config)) if given is None else given
    socket = find_daemon_socket(args)
    if args.config is not None:  # requests of the form are done by the daemon itself
        with suppress(UnreachableError):
            connect_daemon(args, drives=True, coming_s=0.0).close()

    def opened(address: str) -> None:
        say(f"{address}.{first}" if first else address)
        tell_user("open that address in a browser here; it is good until Ctrl-C ends the page")

    asyncio.run(
        run_page_server(bind_loopback(args.host, args.port), socket, state.absolute(), opened)
    )
    return DONE
