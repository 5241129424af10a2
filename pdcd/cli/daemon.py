"""The daemon that a command talks to: where it listens, whether it is there, what it runs."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from pdcd.bench.config import load_config
from pdcd.bench.folders import find_socket_path
from pdcd.bench.tables import Config
from pdcd.client import Client
from pdcd.errors import ConfigError
from pdcd.files.system import HAS_FOLDER_DESCRIPTORS
from pdcd.files.text import encode_json
from pdcd.protocol.line_talk import UnreachableError

COMING_S = 3.0
"""How long a command waits for a daemon that has only just been started."""
_LOOK_S = 0.05


def find_daemon_socket(args: argparse.Namespace) -> Path:
    """Path of the daemon's socket: the one given, else that of the configuration."""
    given: Path | None = args.socket
    return given if given is not None else find_socket_path(load_config(args.config))


def connect_daemon(
    args: argparse.Namespace, *, drives: bool = False, coming_s: float | None = None
) -> Client:
    """A connection to the daemon, which may have been started just now.

    drives : whether the command uses the rig; a configuration given on the command line must then
    be the daemon's. coming_s : how long to wait for a daemon.

    Raises Unreachable, and ConfigError where the daemon has another configuration.
    """
    named = args.config if drives else None
    config = load_config(args.config) if args.socket is None or named is not None else None
    path = args.socket if config is None or args.socket is not None else find_socket_path(config)
    client = _connect(path, COMING_S if coming_s is None else coming_s)
    if named is not None and config is not None:
        try:
            _refuse_other(client, config, args)
        except BaseException:
            client.close()
            raise
    return client


def find_daemon(
    args: argparse.Namespace, *, needed: bool = False, drives: bool = False
) -> Client | None:
    """A connection to the daemon, None where none answers. Raises Unreachable instead if its socket
    was named or it is `needed`, and ConfigError as `connect_daemon`."""
    needed = needed or args.socket is not None
    if not (needed or HAS_FOLDER_DESCRIPTORS):
        return None
    try:
        return connect_daemon(args, drives=drives, coming_s=None if needed else 0.0)
    except UnreachableError:
        if needed:
            raise
    return None


def refuse_with_local(args: argparse.Namespace, *names: str) -> None:
    """Raise ConfigError if --local was given with one of these options, which are for a daemon."""
    given = [name for name in names if getattr(args, name)]
    if args.local and given:
        raise ConfigError(
            f"--local goes without --{' and --'.join(given)}", hint="there is no daemon to ask"
        )


def _connect(path: Path, coming_s: float) -> Client:
    """Connect; wait while the socket is missing, or nothing listens on it yet."""
    give_up_s = time.monotonic() + coming_s
    while True:
        try:
            return Client(path)
        except UnreachableError as err:
            coming = isinstance(err.__cause__, FileNotFoundError | ConnectionRefusedError)
            if not coming or time.monotonic() >= give_up_s:
                raise
        time.sleep(_LOOK_S)


def _refuse_other(client: Client, config: Config, args: argparse.Namespace) -> None:
    """Raise ConfigError if the daemon's configuration differs from the one on the command line,
    except in where it listens and keeps runs."""
    other = _find_difference(client.call("config.get"), msgspec.json.decode(encode_json(config)))
    if other is None:
        return
    here = ", or drive the rig from here with --local" if hasattr(args, "local") else ""
    raise ConfigError(
        f"the daemon does not run --config {args.config}: {other} differs",
        hint=f"leave --config out to use the daemon's own, restart it with pdcd serve "
        f"--config {args.config}{here}",
    )


def _find_difference(there: Any, here: Any, key: str = "") -> str | None:
    """The first key in which two configurations of the rig differ; None if there is none."""
    if isinstance(there, Mapping) and isinstance(here, Mapping):
        for name in dict.fromkeys((*here, *there)):
            if key or name != "server":
                below = f"{key}.{name}" if key else str(name)
                found = _find_difference(there.get(name), here.get(name), below)
                if found is not None:
                    return found
        return None
    if isinstance(there, str) and isinstance(here, str) and "/" in there and "/" in here:
        there, here = os.path.realpath(there), os.path.realpath(here)
    return None if there == here else key
