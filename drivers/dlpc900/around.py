"""Tables that come around again and again: they lie in a device side by side.

A device is to be sent its pictures anew as soon as an entry shows another plane, and USB is slow:
it would take seconds a photo where a stream shows its parts in turn. An order of entries leaves
pictures as they are; by the guide it may name some of them, and one several times. So tables that
have come around twice are loaded as one, and each is shown by an order of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

BLACK_PLANE = b""
"""Key of the plane without light."""
_ROUNDS = 2
"""Times that a table was loaded before, and others since, from which on it comes around."""
_REMEMBERED = 64


class TableEntry(NamedTuple):
    """What one entry shows: the plane of a key, for so long, then dark for so long."""

    plane: bytes
    exposure_us: int
    dark_us: int = 0


_Table = tuple[TableEntry, ...]


class TablesAround:
    """Tables that one device was to show lately, and the entries of those that it has as one.

    A trigger belongs to an entry. So what a table begins with is there twice, and waits once. The
    entry in front of one that waits takes longer by the guide, wherever it is shown, and ends in
    the dark: that one is black, and no order names it.
    """

    def __init__(self) -> None:
        self._lately: list[_Table] = []
        self._tables: frozenset[_Table] = frozenset()
        self._numbers: dict[tuple[TableEntry, bool], int] = {}

    def find_round(self, table: Sequence[TableEntry]) -> list[_Table]:
        """Note that a table is to be loaded; the tables among which it comes around, itself among
        them, none where it does not."""
        one = tuple(table)
        if not self._lately or self._lately[-1] != one:
            self._lately.append(one)
        del self._lately[:-_REMEMBERED]
        before = [n for n, other in enumerate(self._lately[:-1]) if other == one]
        return list(dict.fromkeys(self._lately[before[-1] :])) if len(before) >= _ROUNDS else []

    def hold(self, joined: JoinedTables) -> None:
        """The device has these."""
        self._tables = frozenset(joined.tables)
        self._numbers = {(one, n in joined.waiting): n for n, one in enumerate(joined.entries)}

    def part(self) -> None:
        """The device has them no longer."""
        self._tables = frozenset()

    def find(self, table: Sequence[TableEntry], *, waits: bool = False) -> list[int] | None:
        """The entries of a table, in order, the first of which waits for a trigger or not; None
        where it does not lie among others."""
        if tuple(table) not in self._tables:
            return None
        return [self._numbers[one, waits and n == 0] for n, one in enumerate(table)]


class JoinedTables(NamedTuple):
    """Tables as one. entries : each that is in any of them once, the last one black. waiting :
    numbers of those that wait for a trigger."""

    tables: tuple[_Table, ...]
    entries: tuple[TableEntry, ...]
    waiting: frozenset[int]


def join_tables(tables: Sequence[_Table]) -> JoinedTables:
    """As one, for `TablesAround.hold`; they end on black."""
    black = tables[0][-1]
    first = dict.fromkeys(table[0] for table in tables)
    rest = dict.fromkeys(one for table in tables for one in table if one != black)
    entries = (*(one for begin in first for one in (black, begin)), *rest, black)
    return JoinedTables(tuple(tables), entries, frozenset(range(1, 2 * len(first), 2)))
