"""Work that many ask for and few may do at the same time: users take turns, however much each asks.

What one user asks for is done in the order in which it came. Users are served in rotation, so that
a thousand requests of one delay another no more than a single request would.
"""

from __future__ import annotations

import asyncio
from collections import Counter, deque


class UserTurns:
    """Places for work, handed out to users in turn. Used from one event loop.

    each, total : places that one user may have, and all users together.
    """

    def __init__(self, each: int = 1, total: int = 1) -> None:
        self._each, self._total = each, total
        self._free = total
        self._held: Counter[int] = Counter()
        self._waiting: dict[int, deque[asyncio.Future[None]]] = {}
        """Waiting requests by user; the user whose turn is next comes first."""

    async def take(self, uid: int) -> None:
        """Wait for a place, which must be given back."""
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(uid, deque()).append(turn)
        self._hand_out()
        try:
            await turn
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled():  # handed out just now
                self.give_back(uid)
            raise

    def give_back(self, uid: int, rest_s: float = 0.0) -> None:
        """Give a place back; this user gets another only after a pause (s)."""
        self._free += 1
        if rest_s > 0.0:
            asyncio.get_running_loop().call_later(rest_s, self._end_rest, uid)
            self._hand_out()
        else:
            self._end_rest(uid)

    def _end_rest(self, uid: int) -> None:
        self._held[uid] -= 1
        if not self._held[uid]:
            del self._held[uid]
        if uid in self._waiting:  # behind all others who wait
            self._waiting[uid] = self._waiting.pop(uid)
        self._hand_out()

    def _hand_out(self) -> None:
        while self._free:
            uid = next((uid for uid in self._waiting if self._held[uid] < self._each), None)
            if uid is None:
                return
            queue = self._waiting.pop(uid)
            turn = queue.popleft()
            if queue:
                self._waiting[uid] = queue
            if not turn.done():  # who waited may have left
                self._free -= 1
                self._held[uid] += 1
                turn.set_result(None)
