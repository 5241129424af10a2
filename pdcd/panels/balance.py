"""Compensating for missed refreshes within an open exposure, and whether they did harm.

A photo is a sum over refreshes. If a late refresh left a code on for twice its time, every other
code is shown once more: all weights are then equal, twice what was planned. If the open mask met
the light of another code nothing can be done.

Only refreshes with the mask open by plan count. A black one may last as long as it likes: it costs
time and lets leaking light through, both of which the realised probing matrix contains.

Weights are whole refreshes of the mask. They are exact where guards hold the projector's code on
both sides of the open mask ("full", and "lag", "tail" or "lead" for the lags that they are for).
Where lag and light overlap in part ("none", "both" with a lag s), a code that was lit for two
refreshes on end had 2 - s of light, and others that were shown twice have 2 (1 - s). The difference
s remains, and is in the realised matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import SyncError
from pdcd.panels.frames import BLACK, FrameLog, Frames

_Rows = NDArray[np.int32]
_Seconds = NDArray[np.float64]
_Int = TypeVar("_Int", np.int32, np.int64)


@dataclass(frozen=True)
class LitWeights:
    """Refreshes for which each pair of patterns was lit, and should have been, (G,) int64 each.

    `slots` (G,) holds the rows of `Frames`, guards included, that show each pair once.
    """

    realised: NDArray[np.int64]
    planned: NDArray[np.int64]
    slots: tuple[_Rows, ...]

    @property
    def level(self) -> float | None:
        """Realised over planned if it is the same for all pairs, else None; 1 without pairs."""
        if not self.planned.size:
            return 1.0
        equal = self.realised * self.planned[0] == self.planned * self.realised[0]
        return float(self.realised[0] / self.planned[0]) if equal.all() else None


def catch_up(frames: Frames, log: FrameLog, row_hz: float) -> _Rows | None:
    """Rows of `frames` to play next so that all codes have equal weights.

    Parameters
    ----------
    frames : what was to be shown.
    log : all that was shown so far in this exposure, several passes joined by `join_logs`.
    row_hz : rows a second: refresh rate of the panels, times their planes per refresh.

    Returns
    -------
    (F',) int32, in order, each code with all its guards; None when the weights are equal, also if
    only black refreshes were missed. Play the rows, join the logs, and ask again: refreshes may be
    missed in the further pass, too.

    Raises
    ------
    SyncError
        The open mask met the light of another code: no further pass can undo that.
    """
    weights = count_lit_weights(frames, log, row_hz)
    if weights.level is not None:
        return None if weights.level > 0.0 else np.arange(len(frames), dtype=np.int32)
    # The lowest whole multiple of the plan that no code has passed yet.
    times = int(np.max(-(-weights.realised // weights.planned)))
    short = times * weights.planned - weights.realised
    missing = list(zip(weights.slots, short.tolist(), strict=True))
    return np.concatenate([slot for n in range(max(short)) for slot, left in missing if left > n])


def count_lit_weights(frames: Frames, log: FrameLog, row_hz: float) -> LitWeights:
    """Weights of all pairs of patterns, as `catch_up` compares them.

    Raises SyncError.
    """
    primal, dual = _contents(frames)
    lit = np.flatnonzero(frames.dual_index != BLACK)
    pairs, first, planned = np.unique(
        np.stack([primal[lit], dual[lit]], axis=1), axis=0, return_index=True, return_counts=True
    )
    shown, together = _shown(primal, dual, log, row_hz)
    open_rows = shown[:, 1] != BLACK
    dark = (shown[:, 0] == BLACK) & ~(pairs[:, 0] == BLACK).any()
    asked, unknown = _find(pairs, shown)
    wrong = open_rows & ~dark & (unknown | ~together)
    if wrong.any():
        raise SyncError(
            f"the mask was open under another code's light for {int(wrong.sum())} refreshes",
            device="display",
            hint="use guards, or the policy that takes the exposure again",
        )
    good = open_rows & ~dark
    realised = np.bincount(asked[good], minlength=len(pairs)).astype(np.int64)
    order = np.argsort(first)  # as the plan shows them
    return LitWeights(
        realised=realised[order],
        planned=planned[order].astype(np.int64),
        slots=tuple(_slots(frames, lit[first[order]])),
    )


def measure_still_level(frames: Frames, log: FrameLog, row_hz: float) -> float | None:
    """How many times as long as planned a photo's light fell, if it shows one picture that stands
    still; 1 if it shows nothing, or nothing of it was late. For calibrations.

    None if pictures change or pulse: then no factor corrects for late refreshes.
    """
    primal, dual = _contents(frames)
    planned, shown = np.stack([primal, dual], axis=1)[:-1], _shown(primal, dual, log, row_hz)[0]
    every = (planned != BLACK).all(axis=1).any()  # light passes both panels, or else leaks by one
    lit, seen = ((rows != BLACK).all(axis=1) if every else (rows != BLACK).any(axis=1)
                 for rows in (planned, shown))  # fmt: skip
    if not lit.any():
        return 1.0
    for rows, on in ((planned, lit), (shown, seen)):
        at = np.flatnonzero(on)
        if at.size == 0 or at[-1] - at[0] >= at.size or (rows[at] != planned[lit][0]).any():
            return None
    return float(seen.sum() / lit.sum())


def play_all(
    play: Callable[[_Rows], FrameLog], frames: Frames, *, on_miss: str, rounds: int, row_hz: float
) -> FrameLog:
    """Play all frames and, under the policy "balance", what else makes their weights equal.

    For display drivers, whose `play(rows)` shows those rows of `frames` once, ends black, and logs
    them; `streams` gives what each panel is to carry, `join_logs` joins the passes.

    All that is shown again lasts no longer than `rounds` more passes over all frames: a stall of
    seconds must not cost hours. Raises SyncError when that is not enough.
    """
    log = play(np.arange(len(frames), dtype=np.int32))
    left = rounds * len(frames)
    while on_miss == "balance" and (more := catch_up(frames, log, row_hz)) is not None:
        if more.size > left:
            raise SyncError(
                f"codes are unequal, and {rounds} further passes do not mend that",
                device="display",
                hint="see why refreshes are missed; rig.retries allows more passes",
            )
        left -= more.size
        log = join_logs([log, play(more)])
    return log


def streams(rows: _Rows, mask_delay: int) -> tuple[_Rows, _Rows]:
    """What projector and mask are sent, row by row: `rows`, one of them later by |mask_delay|.

    (R,) int32 each, R = len(rows) + |mask_delay|; `BLACK` where a panel waits for the other.
    """
    wait = np.full(abs(mask_delay), BLACK, dtype=np.int32)
    early, late = np.concatenate([rows, wait]), np.concatenate([wait, rows])
    return (early, late) if mask_delay >= 0 else (late, early)


def join_logs(logs: Sequence[FrameLog]) -> FrameLog:
    """The log of several passes, in order, with a black row for the time between two of them."""
    whole = logs[0]
    for log in logs[1:]:
        whole = replace(
            log,
            primal_shown=_with_gap(whole.primal_shown, log.primal_shown, BLACK),
            dual_shown=_with_gap(whole.dual_shown, log.dual_shown, BLACK),
            primal_ns=_with_gap(whole.primal_ns, log.primal_ns, int(whole.end_ns[0])),
            dual_ns=_with_gap(whole.dual_ns, log.dual_ns, int(whole.end_ns[1])),
            missed=_with_gap(whole.missed, log.missed, 0),
            verified=whole.verified and log.verified,
            primal_asked=_with_gap(whole.asked[0], log.asked[0], BLACK),
            dual_asked=_with_gap(whole.asked[1], log.asked[1], BLACK),
            dark_s=_times_with_gap(whole, log, whole.dark_s, log.dark_s),
            delay_s=_times_with_gap(whole, log, whole.delay_s, log.delay_s),
        )
    return whole


def _times_with_gap(
    before: FrameLog, after: FrameLog, first: _Seconds | None, second: _Seconds | None
) -> _Seconds | None:
    """Times of the rows of two passes, 0 for the row between them; None if neither has any."""
    if first is None and second is None:
        return None
    times = np.zeros(len(before) + 1 + len(after))
    for seconds, rows in ((first, slice(len(before))), (second, slice(len(before) + 1, None))):
        if seconds is not None:
            times[rows] = seconds
    return times


def _with_gap(before: NDArray[_Int], after: NDArray[_Int], gap: int) -> NDArray[_Int]:
    return np.concatenate([before, np.array([gap], dtype=before.dtype), after])


def _contents(frames: Frames) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """What each row puts on projector and mask, as one number a panel; uniform panels have no
    sub-shift. One more at the end stands for a black panel, so that row -1 is black."""
    found = []
    for index in (frames.primal_index, frames.dual_index):
        key = np.where(index >= 0, index * 256 + frames.shift.astype(np.int64), index)
        found.append(np.append(key, BLACK).astype(np.int64))
    return found[0], found[1]


def _shown(
    primal: NDArray[np.int64], dual: NDArray[np.int64], log: FrameLog, row_hz: float
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """What the light was at every refresh that passed: contents (U, 2), and whether both panels
    held them equally long, where that matters.

    A row's refreshes are those until the mask's next row. A delay of the mask's stream makes up for
    a mask that answers that much sooner, or later: light that belongs together is sent apart.
    """
    lasts = _refreshes(log, row_hz, mask=True)
    own = _refreshes(log, row_hz, mask=False)
    light = np.repeat(primal[log.primal_shown], lasts)
    mask = np.repeat(dual[log.dual_shown], lasts)
    # A projector that holds a code over its guards may hold it longer without harm.
    alone = primal[log.primal_shown]
    held = (alone == np.append(alone[1:], BLACK)) | (alone == np.append(BLACK, alone[:-1]))
    together = np.repeat((own == lasts) | held, lasts)
    delay = log.mask_delay
    black = np.full(abs(delay), BLACK, dtype=np.int64)
    if delay > 0:
        mask = np.concatenate([mask[delay:], black])
    elif delay < 0:
        mask = np.concatenate([black, mask[:delay]])
    return np.stack([light, mask], axis=1), together


def _refreshes(log: FrameLog, row_hz: float, *, mask: bool) -> NDArray[np.int64]:
    """Whole refreshes that each row lasted on a panel, without its dark time."""
    start_ns = log.dual_ns if mask else log.primal_ns
    lasted = np.diff(np.append(start_ns, log.end_ns[int(mask)])) * (row_hz * 1e-9)
    if log.dark_s is not None:
        lasted[:-1] -= log.dark_s[:-1] * row_hz
    return np.maximum(np.rint(lasted), 0.0).astype(np.int64)


def _find(
    pairs: NDArray[np.int64], shown: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Which pair each refresh showed, and where it showed none of them; `pairs` is sorted."""
    if not len(pairs):
        return np.zeros(len(shown), dtype=np.int64), np.ones(len(shown), dtype=np.bool_)
    span = 1 + int(max(pairs[:, 1].max(), shown[:, 1].max(initial=0))) + 4
    known = (pairs[:, 0] + 2) * span + pairs[:, 1] + 2
    seen = (shown[:, 0] + 2) * span + shown[:, 1] + 2
    at = np.minimum(np.searchsorted(known, seen), len(known) - 1)
    return at, known[at] != seen


def _slots(frames: Frames, rows: NDArray[np.int64]) -> list[_Rows]:
    """For each of these rows, all rows of its slot: same code, same sub-shift, without a break."""
    slot = np.append(0, np.cumsum((np.diff(frames.code) != 0) | (np.diff(frames.shift) != 0)))
    first = np.searchsorted(slot, slot[rows], side="left")
    last = np.searchsorted(slot, slot[rows], side="right")
    return [np.arange(a, b, dtype=np.int32) for a, b in zip(first, last, strict=True)]
