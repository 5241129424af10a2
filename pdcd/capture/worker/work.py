"""The tasks of the worker, by name, and the errors of tasks that cannot be completed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from pdcd.capture.worker.worker import Worker
from pdcd.errors import DecodeError, PdcdError, PlanError

_Task = Callable[..., Any]
"""A method of `Worker`."""

WORK: Mapping[str, _Task] = MappingProxyType(
    {
        "plan": Worker.plan,
        "begin": Worker.begin,
        "next_exposure": Worker.next_exposure,
        "look": Worker.look,
        "develop": Worker.develop,
        "report": Worker.report,
        "roll": Worker.roll,
        "see": Worker.see,
        "keep": Worker.keep,
        "forget": Worker.forget,
        "calibrate": Worker.calibrate,
        "step": Worker.step,
        "photo": Worker.photo,
        "answered": Worker.answered,
        "measured": Worker.measured,
        "head": Worker.head,
    }
)
"""All tasks of a child process."""

FRESH_JOBS = frozenset({"plan", "calibrate"})
"""Tasks that begin a job: they need nothing of what was done before."""


SPENT = 12
"""Exit status of a worker that has not even the memory left to report it."""


def make_work_error(name: str, what: str, hint: str) -> PdcdError:
    """The failure of a job whose work could not go on: PlanError while it was planned, else
    DecodeError. `what` follows on "the planning process" or "the decoding process"."""
    if name in FRESH_JOBS:
        return PlanError(f"the planning process {what}", hint=hint)
    return DecodeError(f"the decoding process {what}", hint=f"the RAW files are kept; {hint}")


def make_memory_error(name: str) -> PdcdError:
    """The failure of a job that needed more memory than it may use."""
    return make_work_error(
        name,
        "ran out of memory",
        "ask for fewer codes or cells, or raise limits.work_bytes",
    )
