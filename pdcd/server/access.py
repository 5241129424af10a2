"""Who is at the other end of the socket, and what they may do."""

from __future__ import annotations

import asyncio
import grp
import logging
import os
import pwd
import socket
import stat
import struct
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from pdcd.bench.tables import ServerConfig
from pdcd.errors import ConfigError
from pdcd.protocol.views import ClientRole
from pdcd.server.aside import call_in_thread

logger = logging.getLogger(__name__)

LOOKUP_S = 1.0
"""How long a client may wait for its user's name, in seconds; after that the number is used."""

NAME_KEPT_S = 60.0
"""How long a looked-up name stays valid, in seconds."""

_SO_PEERGROUPS = 59
"""Constant of Linux, from 4.13 on, for which `socket` has no name. See socket(7)."""

_MOST_BYTES = 1024
"""Longest answer that `getsockopt` of Python takes: 256 groups."""


@dataclass(frozen=True)
class Peer:
    """A process as the kernel vouches for it at the time it connected.

    `groups` are the process's supplementary groups; `user` is for people, and may be the number.
    """

    pid: int
    uid: int
    gid: int
    user: str
    groups: frozenset[int] = frozenset()


def peer_of(sock: socket.socket) -> Peer:
    """Credentials of the process that connected (SO_PEERCRED, unix(7)); asks the kernel only."""
    layout = struct.Struct("3i")
    pid, uid, gid = layout.unpack(
        sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, layout.size)
    )
    return Peer(pid, uid, gid, str(uid), _groups_of(sock))


def _groups_of(sock: socket.socket) -> frozenset[int]:
    """Groups of the process that connected. No user database is asked, because it might not
    answer."""
    try:
        packed = sock.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _MOST_BYTES)
    except OSError as err:
        logger.warning("groups of a client are not known: %s", err)
        return frozenset()
    return frozenset(struct.unpack(f"{len(packed) // 4}I", packed))


@dataclass(frozen=True)
class Access:
    """The role of each user and group that is served; users without a role are not served.

    `own` are the daemon's own user and root, for whom places are kept.
    """

    uids: Mapping[int, ClientRole]
    gids: Mapping[int, ClientRole]
    own: frozenset[int] = frozenset()

    @classmethod
    def to(cls, sock: socket.socket, config: ServerConfig) -> Access:
        """The rule for a bound socket: the group of its file may shoot, the configuration gives all
        else.

        Looks groups up by name, which may take long. Raises ConfigError for an unknown group.
        """
        uids: dict[int, ClientRole] = {}
        gids: dict[int, ClientRole] = {}
        for role, table in (
            (ClientRole.LOOK, config.look),
            (ClientRole.SHOOT, config.shoot),
            (ClientRole.ADMINISTER, config.administer),
        ):
            _raise_to(role, uids, table.uids)
            _raise_to(role, gids, map(_gid, table.groups))
        _raise_to(ClientRole.SHOOT, uids, config.allow_uids)
        address = sock.getsockname()
        if isinstance(address, str) and address:  # else abstract or unnamed: no file, no group
            found = Path(address).stat()
            if found.st_mode & stat.S_IWGRP:
                _raise_to(ClientRole.SHOOT, gids, [found.st_gid])
        own = frozenset({os.geteuid(), 0})
        _raise_to(ClientRole.ADMINISTER, uids, own)
        return cls(uids, gids, own)

    def role(self, peer: Peer) -> ClientRole | None:
        """The highest role of the user and the groups; None: not served."""
        found = [self.gids[gid] for gid in {peer.gid, *peer.groups} if gid in self.gids]
        if peer.uid in self.uids:
            found.append(self.uids[peer.uid])
        return max(found, default=None)


def _raise_to(role: ClientRole, table: dict[int, ClientRole], numbers: Iterable[int]) -> None:
    for number in numbers:
        table[number] = max(role, table.get(number, role))


def _gid(group: str | int) -> int:
    if isinstance(group, int):
        return group
    try:
        return grp.getgrnam(group).gr_gid
    except KeyError as err:
        raise ConfigError(
            f"there is no group {group!r}", hint="mend groups in the tables of [server]"
        ) from err


class Names:
    """Names of users. The user database may be a server that hangs, so it is asked in another
    thread."""

    def __init__(self, look_up: Callable[[int], str] | None = None) -> None:
        self._look_up = look_up or _user_name
        self._known: dict[int, tuple[str, float]] = {}
        self._asked: dict[int, asyncio.Task[str]] = {}

    async def of(self, uid: int) -> str:
        """The user's name, or the number where there is none within `LOOKUP_S`."""
        name, until_s = self._known.get(uid, (str(uid), 0.0))
        if time.monotonic() < until_s:
            return name
        task = self._asked.get(uid)
        if task is None:
            task = self._asked[uid] = asyncio.create_task(self._ask(uid))
        try:
            async with asyncio.timeout(LOOKUP_S):
                return await asyncio.shield(task)
        except TimeoutError:
            logger.warning("the name of a user cannot be looked up uid=%d", uid)
            # Nobody waits again for a lookup that hangs. Once it is answered, the name replaces the
            # number.
            self._keep(uid, str(uid))
            return str(uid)

    async def close(self) -> None:
        """Stop waiting for names."""
        left = list(self._asked.values())
        for task in left:
            task.cancel()
        await asyncio.gather(*left, return_exceptions=True)

    async def _ask(self, uid: int) -> str:
        try:
            name = await call_in_thread(self._look_up, uid)
            self._keep(uid, name)
            return name
        finally:
            del self._asked[uid]

    def _keep(self, uid: int, name: str) -> None:
        self._known[uid] = (name, time.monotonic() + NAME_KEPT_S)


def _user_name(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except (KeyError, OSError):
        return str(uid)
