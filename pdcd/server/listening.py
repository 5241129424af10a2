"""Getting hold of the listening socket: passed by the service manager, or bound by ourselves."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

from pdcd.bench.tables import ServerConfig
from pdcd.errors import ConfigError
from pdcd.server.lock import hold_lock_file
from pdcd.server.notify import FIRST_FD, count_listen_fds

logger = logging.getLogger(__name__)

_UNIT = "use ListenStream=/run/pdcd.sock and Accept=no"


@contextlib.contextmanager
def open_listener(path: Path, config: ServerConfig) -> Iterator[socket.socket]:
    """A listening socket: the one that was passed to this process, else one bound at `path`.

    A socket file made here is finally removed; a passed socket belongs to the service manager,
    which passes it once. Raises ConfigError when the path is taken or cannot be bound.
    """
    passed = count_listen_fds()
    if passed:
        with _passed(passed) as sock:
            yield sock
        return
    # Users who are not in the group are let in by the check at accept, not by the file's mode.
    roles = (config.look, config.shoot, config.administer)
    others = config.allow_uids or any(role.uids or role.groups for role in roles)
    mode = 0o666 if others else 0o660
    if not path.name:
        raise ConfigError(f"{path} is a folder, not a socket", hint="name a file in it")
    lock = path.with_name(path.name + ".lock")
    with (
        # Between finding a stale socket and binding a new one, another daemon could do the same.
        hold_lock_file(lock, f"the socket {path}", "stop it first, or give this one --socket"),
        socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock,
    ):
        _bind(sock, path, mode)
        made = path.stat()
        try:
            yield sock
        finally:
            with contextlib.suppress(FileNotFoundError):
                now = path.stat()
                if (now.st_dev, now.st_ino) == (made.st_dev, made.st_ino):
                    path.unlink()


def _passed(count: int) -> socket.socket:
    """The one socket of socket activation. Raises ConfigError when it cannot be served."""
    if count != 1:
        raise ConfigError(f"{count} sockets were passed", hint="pdcd.socket needs one ListenStream")
    try:
        sock = socket.socket(fileno=FIRST_FD)
        listening = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
    except OSError as err:
        raise ConfigError(
            f"what was passed is no socket: {err.strerror or err}", hint=_UNIT
        ) from err
    if sock.family != socket.AF_UNIX or sock.type != socket.SOCK_STREAM or not listening:
        # Where nothing was passed, a descriptor of our own may have that number: leave it open.
        sock.detach()
        raise ConfigError("the passed socket is no listening unix stream socket", hint=_UNIT)
    sock.set_inheritable(False)
    return sock


def _bind(sock: socket.socket, path: Path, mode: int) -> None:
    """Bind and listen at `path`, in place of a stale socket file if one lies there."""
    _clear_stale(path)
    # The mode is set by the umask, not after the fact: there is no moment of wider access.
    umask = os.umask(0o777 & ~mode)
    try:
        sock.bind(str(path))
        sock.listen()
    except OSError as err:
        raise ConfigError(
            f"cannot listen on {path}: {err.strerror or err}",
            hint="choose another path by --socket or [server] socket",
        ) from err
    finally:
        os.umask(umask)


def _clear_stale(path: Path) -> None:
    """Remove a socket file on which nobody answers.

    Raises ConfigError when a daemon does, or when the file is something else.
    """
    try:
        mode = path.stat().st_mode
    except OSError:
        return  # nothing there, or not accessible: bind reports what is wrong
    if not stat.S_ISSOCK(mode):
        raise ConfigError(
            f"{path} is there and is no socket", hint="remove it, or use another path"
        )
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        # A full backlog must not block this process: it, too, means that a daemon is there.
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            logger.warning("removing a stale socket path=%s", path)
            path.unlink(missing_ok=True)
            return
        except OSError as err:
            raise ConfigError(f"{path} is in use: {err.strerror}", hint="use another path") from err
    raise ConfigError(
        f"another daemon answers on {path}", hint="stop it first, or give this one --socket"
    )
