"""Clients of other users, without being root: the kernel's word on who connected is replaced."""

from __future__ import annotations

import dataclasses
import os
import socket

import pytest

from pdcd.server import connections
from pdcd.server.access import Peer, peer_of

ANNA, BERT, CARL = 70001, 70002, 70003
"""Users that no system has."""


class Users:
    """Who the next to connect is, until `become` is called again."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self._uid: int | None = None
        self._groups: frozenset[int] = frozenset()
        patch.setattr(connections, "peer_of", self._peer_of)

    def become(self, uid: int = -1, *groups: int) -> None:
        """A user in these groups and in no other; by default who really runs the test."""
        self._uid = None if uid < 0 else uid
        self._groups = frozenset(groups)

    def _peer_of(self, sock: socket.socket) -> Peer:
        peer = peer_of(sock)
        assert peer.uid == os.getuid()
        if self._uid is None:
            return peer
        return dataclasses.replace(
            peer, uid=self._uid, gid=self._uid, user=str(self._uid), groups=self._groups
        )
