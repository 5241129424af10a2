"""Shows a list of rows, one vblank after the other, and logs when each was shown.

Nothing here allocates more than a few small numbers, logs text or touches a disk: all rows, their
draw commands and the log exist before the first row is shown.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import NDArray

from pdcd.presenter.clocks import TimeSource, wait_until_ns
from pdcd.presenter.messages import Column, Head

_MARGIN = 0.5
"""Part of a refresh after which it is too late to hand a code over for the coming vblank."""


# Plain numbers, which index an array in half the time.
_NS, _MSC, _PUT_NS, _SWAP_NS, _CPU_NS, _FLIPPED = (int(column) for column in Column)
_SHOWN, _MISSED, _SPOILT = int(Head.SHOWN), int(Head.MISSED), int(Head.SPOILT)


class Loop:
    """One pass over some rows.

    Parameters
    ----------
    source : hands frames over and reports when they were shown.
    draw : draws a refresh, by its number, on both panels.
    opens : whether the mask is anything but black, by number of the refresh.
    period_ns : length of a refresh.
    stop : asked after every refresh; true ends the pass.
    """

    def __init__(
        self,
        source: TimeSource,
        draw: Callable[[int], None],
        opens: Sequence[bool],
        period_ns: float,
        stop: Callable[[], bool],
        stalls_ns: dict[int, int],
    ) -> None:
        self._source = source
        self._draw = draw
        self._opens = opens
        self._period_ns = period_ns
        self._stop = stop
        self._stalls_ns = stalls_ns

    def run(self, log_array: NDArray[Any], head_array: NDArray[Any], first: int) -> None:
        """Show all refreshes, or as many as there are before the pass is stopped.

        Row n of the log is that of refresh n; stalls are counted from number `first`.
        """
        # Single numbers go into plain memory much faster than into an array.
        log, head = log_array.data, head_array.data
        source, draw, opens = self._source, self._draw, self._opens
        margin_ns = _MARGIN * self._period_ns
        count, put, missed, open_now = len(opens), 0, 0, False
        source.sync()
        last_msc = 0
        for n in range(count):
            if put == n:
                opening = opens[n]
                if opening and not open_now and source.queues:
                    # Too late to be sure of the coming vblank: the mask stays black for one more
                    # refresh, which costs nothing; a late code would stretch the next guard.
                    now_ns = time.monotonic_ns()
                    if now_ns - source.ns > margin_ns:
                        gone = int((now_ns - source.ns) / self._period_ns) + 1
                        wait_until_ns(source.ns + int((gone + 0.05) * self._period_ns))
                log[n, _PUT_NS] = time.monotonic_ns()
                draw(n)
                source.put()
                log[n, _SWAP_NS] = time.monotonic_ns()
                put += 1
                if opening and source.queues and put < count and not opens[put]:
                    # Hand over the black that ends a code together with it: the display system,
                    # not this process, then makes the code last one refresh.
                    log[put, _PUT_NS] = time.monotonic_ns()
                    draw(put)
                    source.put()
                    log[put, _SWAP_NS] = time.monotonic_ns()
                    put += 1
                    opening = False
                open_now = opening
            source.shown()
            log[n, _NS] = source.ns
            log[n, _MSC] = source.msc
            log[n, _CPU_NS] = time.thread_time_ns()
            log[n, _FLIPPED] = source.flipped
            if n:
                missed += source.msc - last_msc - 1
                if source.msc - last_msc > 1 and opens[n - 1]:
                    head[_SPOILT] += 1
            last_msc = source.msc
            head[_MISSED] = missed
            head[_SHOWN] = n + 1
            if self._stop():
                return
            stall_ns = self._stalls_ns.get(n - first)
            if stall_ns is not None:
                time.sleep(stall_ns * 1e-9)
