"""What can be asked of the desk, by name, and the words in which it goes wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from pdcd.capture.worker.desk import Desk
from pdcd.errors import DecodeError, PdcdError, PlanError

Task = Callable[..., Any]
"""A method of `Desk`."""

WORK: Mapping[str, Task] = MappingProxyType(
    {
        "plan": Desk.plan,
        "begin": Desk.begin,
        "meter_pairs": Desk.meter_pairs,
        "metered": Desk.metered,
        "look": Desk.look,
        "learn": Desk.learn,
        "stray": Desk.stray,
        "see": Desk.see,
        "develop": Desk.develop,
        "report": Desk.report,
        "calibrate": Desk.calibrate,
        "step": Desk.step,
        "photo": Desk.photo,
        "answered": Desk.answered,
        "measured": Desk.measured,
        "flip": Desk.flip,
    }
)
"""All that a child process can be asked."""

FIRST = frozenset({"plan", "calibrate"})
"""What begins a job: it needs nothing of what was done before."""


SPENT = 12
"""Status with which the work process ends when it has no memory left even to say so."""


def broken(name: str, what: str, hint: str) -> PdcdError:
    """The failure of a job whose work could not go on: PlanError while it was planned, else
    DecodeError. `what` follows on "the planning process" or "the decoding process"."""
    if name in FIRST:
        return PlanError(f"the planning process {what}", hint=hint)
    return DecodeError(f"the decoding process {what}", hint=f"the RAW files are kept; {hint}")


def out_of_memory(name: str) -> PdcdError:
    """The failure of a job that wanted more memory than there is for it."""
    return broken(
        name,
        "ran out of memory",
        "ask for fewer codes or cells, or raise limits.work_bytes",
    )
