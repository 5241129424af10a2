"""`python -m pdcd.api.worker FD`: a process that takes photos on mock benches for a sweep."""

from __future__ import annotations

import socket
import sys


def serve(talk: socket.socket) -> None:
    """Take what photos are asked for, until the other end is gone."""
    from pdcd.api.task import taken
    from pdcd.capture.worker.pipe import PIECE_BYTES, Inbox, packed

    inbox = Inbox()
    while data := talk.recv(PIECE_BYTES):
        for task in inbox.take(data):
            talk.sendall(packed(taken(task)))


if __name__ == "__main__":
    # Before the imports that follow, which take long.
    from pdcd.capture.worker.limits import confine

    confine()
    with socket.socket(fileno=int(sys.argv[1])) as ours:
        try:
            serve(ours)
        except (BrokenPipeError, ConnectionResetError):
            sys.exit(0)
