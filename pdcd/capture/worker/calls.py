"""What the daemon and its worker say to each other, and how a worker is started.

Imports nothing heavy, so that `pdcd serve` can have a worker import while it does so itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pdcd.child import PICKLES, Child, module_command, single_threaded, start
from pdcd.errors import PdcdError

COMMAND = module_command("pdcd.capture.worker")


@dataclass(frozen=True)
class Call:
    """Do that task of the table with these arguments."""

    name: str
    args: tuple[Any, ...]
    kwargs: dict[str, Any]


@dataclass(frozen=True)
class Stop:
    """What is being done is not wanted any more; says nothing to one who does nothing."""


@dataclass(frozen=True)
class Sign:
    """A sign of life; with a `total` above 0 also how much is done, and at what stage."""

    done: float = 0.0
    total: float = 0.0
    stage: str = ""


@dataclass(frozen=True)
class Done:
    """The task is done."""

    value: Any


@dataclass(frozen=True)
class Failed:
    """The task raised; `spent` says that the process has seen better days: replace it."""

    error: PdcdError
    spent: bool = False


def start_worker(command: Sequence[str] = COMMAND) -> Child[Any]:
    """Start a worker, without waiting until it is warm. Raises PdcdError.

    The kernel ends it with the thread that calls this.
    """
    return start(
        command,
        PICKLES,
        what="the process that plans and decodes",
        environment=single_threaded(),
    )
