"""`pdcd web`: a page for the person at the bench."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path

from pdcd.api.progress import tell
from pdcd.bench.config import load
from pdcd.bench.folders import state_dir
from pdcd.cli.daemon import daemon_socket
from pdcd.cli.exits import DONE
from pdcd.cli.output import say
from pdcd.errors import ConfigError
from pdcd.extras import install_hint
from pdcd.server import log


def web(args: argparse.Namespace) -> int:
    """Serve the page until interrupted; the address to be opened is printed once."""
    log.to_stderr()
    try:
        from pdcd.web.serve import bound, run
    except ImportError as err:
        raise ConfigError("pdcd web needs aiohttp", hint=install_hint("aiohttp")) from err
    given: Path | None = args.state_dir
    state = state_dir(load(args.config)) if given is None else given
    socket = daemon_socket(args)

    def opened(address: str) -> None:
        say(address)
        tell("open that address in a browser here; it is good until Ctrl-C ends the page")

    asyncio.run(run(bound(args.host, args.port), socket, state.absolute(), opened))
    return DONE
