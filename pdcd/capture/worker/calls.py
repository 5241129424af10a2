"""What the daemon and its worker say to each other, and how a worker is started.

Imports nothing heavy, so that `pdcd serve` can have a worker import while it does so itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pdcd.child import PICKLES, Child, make_child_environment, make_module_command, start_child
from pdcd.errors import PdcdError

WORKER_COMMAND = make_module_command("pdcd.capture.worker")


@dataclass(frozen=True)
class TaskCall:
    """Do this task of the table with these arguments."""

    name: str
    args: tuple[Any, ...]
    kwargs: dict[str, Any]


@dataclass(frozen=True)
class StopCall:
    """The current task is not wanted any more; a worker without a task ignores it."""


@dataclass(frozen=True)
class LifeSign:
    """A sign of life; with a `total` above 0 also the progress, and its stage."""

    done: float = 0.0
    total: float = 0.0
    stage: str = ""


@dataclass(frozen=True)
class TaskResult:
    """The task is done."""

    value: Any


@dataclass(frozen=True)
class TaskFailure:
    """The task raised; `spent` means that the process should be replaced."""

    error: PdcdError
    spent: bool = False


def start_worker(command: Sequence[str] = WORKER_COMMAND) -> Child[Any]:
    """Start a worker, without waiting until it is warm. Raises PdcdError.

    The kernel ends it with the thread that calls this.
    """
    return start_child(
        command,
        PICKLES,
        what="the process that plans and decodes",
        environment=make_child_environment(),
    )
