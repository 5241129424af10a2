"""An honest client that asks for the state of the rig ten times a second.

``python -m tests.soak.watch SOCKET`` until its input ends; then it prints how long each answer
took, in seconds, as JSON. A daemon that is being restarted is waited for.
"""

from __future__ import annotations

import json
import select
import sys
import time
from contextlib import suppress

from pdcd.client import Client
from pdcd.errors import PdcdError
from pdcd.protocol.line_talk import UnreachableError

EVERY_S = 0.1


def main(socket: str) -> None:
    """Ask until told to stop."""
    took: list[float] = []
    stopped = False
    while not stopped:
        with suppress(UnreachableError, PdcdError, OSError), Client(socket) as client:
            while not stopped:
                asked_s = time.monotonic()
                client.status()
                took.append(time.monotonic() - asked_s)
                stopped = bool(select.select([sys.stdin], [], [], EVERY_S)[0])
        stopped = stopped or bool(select.select([sys.stdin], [], [], EVERY_S)[0])
    sys.stdout.write(json.dumps(took))


if __name__ == "__main__":
    main(sys.argv[1])
