"""Waits until both panels have shown a table, and finds out when they began it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.driver import Cancelled, Clock, SyncError

from .device import DmdPanel

_POLL_S = 0.02
"""Time between two checks whether a sequence has ended."""
_REPORT_S = 0.1
_TRIGGER_S = 5.0
"""Longest wait for an edge; the shutter is open by then."""
_LATE_S = 0.5
"""How much later than planned a sequence may end, and how much later on one panel than the other.
"""
_EARLY_S, _EARLY_SHARE = 0.01, 1e-3
"""How much too early a panel may end: no more than its clock may be off."""
_HINTS = {
    "trigger": "check the wires from the camera to TRIG_IN_1 of both, and display.options.edge",
    "chain": "check the wire from the projector's TRIG_OUT_1 to the mask's TRIG_IN_1",
    "software": "switch both devices off and on",
}


@dataclass(frozen=True)
class BlockWatch:
    """One table, which both panels have just begun to show, or will show when their trigger comes.

    begins_us : for each panel, when rows begin, and black after them.
    starts_ns : when the first row began on each; None: at an edge whose time is not known.
    start : how it starts, as in the options.
    """

    panels: Sequence[DmdPanel]
    clock: Clock
    begins_us: tuple[NDArray[np.int64], NDArray[np.int64]]
    starts_ns: tuple[int, int] | None
    start: str

    def wait(self, tell: Callable[[int], None], cancelled: Callable[[], bool]) -> tuple[int, int]:
        """Wait until all was shown; returns when the first row began on projector and mask.

        `tell` gets the number of rows ten times a second. Raises SyncError if a panel shows the
        table for too long, not long enough, or not at all; Cancelled.
        """
        clock, told_ns, until_ns = self.clock, 0, self._find_end_ns()
        ended_ns: dict[str, int] = {}
        while len(ended_ns) < len(self.panels):
            now_ns = clock.now_ns()
            if now_ns - told_ns >= _REPORT_S * 1e9:
                told_ns = now_ns
                tell(self._count_rows(now_ns))
            if cancelled():
                raise Cancelled("cancelled while codes were shown", device="display")
            for panel in self.panels:
                if panel.role not in ended_ns and not panel.is_running():
                    panel.check_sequence()
                    ended_ns[panel.role] = clock.now_ns()
            if len(ended_ns) < len(self.panels):
                until_ns = min([until_ns, *(at + round(_LATE_S * 1e9) for at in ended_ns.values())])
                if clock.now_ns() > until_ns:
                    raise self._describe_overdue(list(ended_ns))
                clock.sleep_until_ns(clock.now_ns() + round(_POLL_S * 1e9))
        return self._find_starts(ended_ns)

    @property
    def _lasts_ns(self) -> list[int]:
        return [1000 * int(begins[-1]) for begins in self.begins_us]

    def _find_end_ns(self) -> int:
        """The time by which everything must be over."""
        if self.starts_ns is None:
            return self.clock.now_ns() + max(self._lasts_ns) + round(_TRIGGER_S * 1e9)
        return max(self.starts_ns) + max(self._lasts_ns) + round(_LATE_S * 1e9)

    def _find_starts(self, ended_ns: dict[str, int]) -> tuple[int, int]:
        lasts_ns = self._lasts_ns
        if self.starts_ns is None:  # seen when it was over: at least its length and order are known
            begun_ns = min(ended_ns.values()) - max(lasts_ns)
            return begun_ns, begun_ns
        for panel, start_ns, lasted_ns in zip(self.panels, self.starts_ns, lasts_ns, strict=True):
            early_ns = start_ns + lasted_ns - ended_ns[panel.role]
            if early_ns > _EARLY_S * 1e9 + _EARLY_SHARE * lasted_ns:
                raise SyncError(
                    f"ended its sequence {1e-6 * early_ns:.3g} ms too early",
                    device=panel.role,
                    hint="update its firmware, and keep its trigger lines still",
                )
        self.clock.sleep_until_ns(max(self.starts_ns) + max(lasts_ns))
        return self.starts_ns

    def _describe_overdue(self, ended: list[str]) -> SyncError:
        late = [panel.role for panel in self.panels if panel.role not in ended]
        what = f"the {' and the '.join(late)} did not end a sequence"
        if self.start != "software":
            what = f"no trigger came to the {' and the '.join(late)}, or none that it takes"
        return SyncError(what, device=late[0], hint=_HINTS[self.start])

    def _count_rows(self, now_ns: int) -> int:
        if self.starts_ns is None:
            return 0
        since_us = (now_ns - self.starts_ns[0]) // 1000
        return int(np.searchsorted(self.begins_us[0][1:], since_us, side="right"))
