"""Who is at the other end of the socket, and whether they may be."""

from __future__ import annotations

import os
import pwd
import socket
import stat
import struct
from dataclasses import dataclass
from pathlib import Path

from pdcd.bench.tables import ServerConfig


@dataclass(frozen=True)
class Peer:
    """A process as the kernel vouches for it at the time it connected."""

    pid: int
    uid: int
    gid: int
    user: str


def peer_of(sock: socket.socket) -> Peer:
    """Credentials of the process that connected (SO_PEERCRED, unix(7))."""
    layout = struct.Struct("3i")
    pid, uid, gid = layout.unpack(
        sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, layout.size)
    )
    return Peer(pid, uid, gid, _user_name(uid))


@dataclass(frozen=True)
class Access:
    """Whom the daemon serves: its own user, root, `uids`, and the members of `group`.

    `group` is a gid, or None when the socket is not open to its group.
    """

    uids: frozenset[int]
    group: int | None

    @classmethod
    def to(cls, sock: socket.socket, config: ServerConfig) -> Access:
        """The rule for a bound socket: its file names the group, the configuration the users."""
        uids = frozenset({os.geteuid(), 0, *config.allow_uids})
        address = sock.getsockname()
        if not isinstance(address, str) or not address:
            return cls(uids, None)  # abstract or unnamed: no file, no group
        found = Path(address).stat()
        return cls(uids, found.st_gid if found.st_mode & stat.S_IWGRP else None)

    def permits(self, peer: Peer) -> bool:
        """Whether the peer is one of them."""
        if peer.uid in self.uids or (self.group is not None and peer.gid == self.group):
            return True
        # The kernel gives one group only; the others are looked up by name.
        return self.group is not None and self.group in groups_of(peer)


def groups_of(peer: Peer) -> list[int]:
    """All groups of a peer, by the system's tables; none for a user that they do not name."""
    try:
        return os.getgrouplist(pwd.getpwuid(peer.uid).pw_name, peer.gid)
    except KeyError:
        return []


def _user_name(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)
