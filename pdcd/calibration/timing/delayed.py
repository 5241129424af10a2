"""Photos in which the mask is sent its pictures some refreshes earlier or later than planned.

The display compensates a whole delay once it is configured; a calibration has to take photos before
that. So the photo's own rows are shifted against each other, and the log is read as if the display
had done it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.shown import PanelSequence
from pdcd.calibration.timing.timing_model import PhotoLog
from pdcd.panels.frames import BLACK

_Rows = NDArray[np.int32]


def shift_mask(shown: PanelSequence, rows: int, trail: int = 0) -> PanelSequence:
    """The photo with the mask `rows` refreshes later (negative: earlier) than planned, and `trail`
    black refreshes at its end."""
    first, second = _leads(rows)
    longest = shown.refreshes + abs(rows) + trail

    def moved(index: _Rows, lead: int) -> _Rows:
        out = np.full(longest, BLACK, dtype=np.int32)
        out[lead : lead + index.size] = index
        return out

    return replace(
        shown,
        projector_index=moved(shown.projector_index, first),
        mask_index=moved(shown.mask_index, second),
    )


def undo_mask_shift(ran: PhotoLog, rows: int, refreshes: int) -> PhotoLog:
    """The log of such a photo, in terms of the photo as planned, which has `refreshes` rows."""
    first, second = _leads(rows)
    log = ran.log

    def planned(shown: _Rows, lead: int) -> _Rows:
        row = shown - lead
        return np.where((row >= 0) & (row < refreshes), row, BLACK).astype(np.int32)

    log = replace(
        log,
        primal_shown=planned(log.primal_shown, first),
        dual_shown=planned(log.dual_shown, second),
        primal_asked=None,
        dual_asked=None,
    )
    return PhotoLog(log, ran.open_ns, ran.close_ns)


def _leads(rows: int) -> tuple[int, int]:
    """Black refreshes before the rows of projector and mask."""
    return max(-rows, 0), max(rows, 0)
