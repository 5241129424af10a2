"""The daemon that a command asks: where it listens, and whether it is there."""

from __future__ import annotations

import argparse
from pathlib import Path

from pdcd.bench.config import load_config
from pdcd.bench.folders import find_socket_path
from pdcd.client import Client, UnreachableError
from pdcd.errors import ConfigError


def find_daemon_socket(args: argparse.Namespace) -> Path:
    """Path of the daemon's socket: as given, else as the configuration says."""
    given: Path | None = args.socket
    return given if given is not None else find_socket_path(load_config(args.config))


def connect_daemon(args: argparse.Namespace) -> Client:
    """A connection to the daemon. Raises Unreachable."""
    return Client(find_daemon_socket(args))


def find_daemon(args: argparse.Namespace, *, needed: bool = False) -> Client | None:
    """A connection to the daemon, None where none answers. Raises Unreachable where its socket was
    named, or nothing else will do."""
    try:
        return connect_daemon(args)
    except UnreachableError:
        if needed or args.socket is not None:
            raise
    return None


def refuse_with_local(args: argparse.Namespace, *names: str) -> None:
    """Raise ConfigError where --local was typed with one of these options, which ask a daemon."""
    given = [name for name in names if getattr(args, name)]
    if args.local and given:
        raise ConfigError(
            f"--local goes without --{' and --'.join(given)}", hint="there is no daemon to ask"
        )
