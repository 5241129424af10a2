"""Starts a daemon as a process of its own, and waits until it listens."""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

import msgspec

from pdcd.api.progress import tell_user
from pdcd.bench.config import load_config
from pdcd.bench.folders import find_socket_path, find_state_dir
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say
from pdcd.client import Client
from pdcd.errors import ConfigError
from pdcd.protocol.line_talk import UnreachableError

SERVE = (sys.executable, "-P", "-m", "pdcd", "serve")
"""The command; options follow."""
_LOG = "daemon.log"
"""Name of the log of a daemon in the background, in the state folder."""
_START_S = 120.0
"""Longest time that a daemon in the background may take to open its devices."""
_LOOK_S = 0.02
_TOLD_LINES = 5
"""Number of last lines of a log that are printed."""


def connect_started(
    socket: Path, process: subprocess.Popen[bytes], log: Path, start_s: float, begun: int = 0
) -> Client:
    """Wait until a daemon that was started answers. If it ends first or takes longer than
    `start_s`, print the end of its log, which had `begun` bytes before, and raise Unreachable."""
    give_up_s = time.monotonic() + start_s
    while True:
        try:
            client = Client(socket)
            if client.daemon_pid == process.pid:
                return client
            client.close()  # another daemon's; ours will log that, and end
            raise UnreachableError("another daemon answers")
        except UnreachableError:
            if process.poll() is not None or time.monotonic() > give_up_s:
                with log.open("rb") as stream:
                    stream.seek(begun)
                    lines = stream.read().decode(errors="replace").splitlines()
                for line in lines[-_TOLD_LINES:]:
                    tell_user(line)
                raise
        time.sleep(_LOOK_S)


def serve_in_background(args: argparse.Namespace) -> int:
    """Start the daemon and return when it listens: 0, or the exit code that it ended with."""
    config = load_config(args.config)
    if args.state_dir is not None:
        server = msgspec.structs.replace(config.server, state_dir=str(args.state_dir.absolute()))
        config = msgspec.structs.replace(config, server=server)
    socket, state = args.socket or find_socket_path(config), find_state_dir(config)
    _refuse_second(socket)
    words = [*SERVE, *["--verbose"] * args.verbose]
    for option in ("config", "socket", "state_dir"):
        if (value := getattr(args, option)) is not None:
            words += [f"--{option.replace('_', '-')}", str(value)]
    log = state / _LOG
    try:
        state.mkdir(parents=True, exist_ok=True)
        out = log.open("ab")
    except OSError as err:
        raise ConfigError(
            f"cannot write {log}: {err.strerror or err}",
            hint="choose another folder by --state-dir or [server] state_dir",
        ) from err
    with out:
        begun = out.tell()
        process = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=out, stderr=out, start_new_session=True
        )
    try:
        connect_started(socket, process, log, _START_S, begun).close()
    except UnreachableError:
        if process.poll() is None:
            process.terminate()
        return process.wait() or FAILED
    except BaseException:  # interrupted before anything was printed about it
        process.terminate()
        raise
    say(f"listening on {socket}, process {process.pid}, log {log}")
    return DONE


def _refuse_second(socket: Path) -> None:
    """Raise ConfigError if a daemon already answers: both would write into one log."""
    try:
        with Client(socket) as client:
            pid = client.daemon_pid
    except UnreachableError:
        return
    raise ConfigError(
        f"a daemon answers on {socket} already: process {pid}",
        hint="stop it first, or give this one --socket and --state-dir",
    )
