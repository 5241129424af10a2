"""Tables that come around again and again are kept in a device side by side.

A device must be sent its pictures anew as soon as an entry shows another plane, and USB is slow: a
stream that shows its parts in turn would need seconds a photo. An order of entries leaves pictures
as they are; by the guide it may name only some entries, and one several times. So tables that have
come around twice are loaded as one table, and each is shown by an order of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

BLACK_PLANE = b""
"""Key of the plane without light."""
_ROUNDS = 2
"""A table comes around once it was loaded this many times before, with others in between."""
_REMEMBERED = 64


class TableEntry(NamedTuple):
    """What one entry shows: the plane of a key, its exposure, and the dark time after it."""

    plane: bytes
    exposure_us: int
    dark_us: int = 0


_Table = tuple[TableEntry, ...]


class TablesAround:
    """Tables that one device was lately asked to show, and the entries of those it holds as one.

    A trigger belongs to an entry. So the first entry of each table is there twice: once it waits,
    once it does not. By the guide, the entry in front of a waiting one takes longer wherever it is
    shown, and ends in the dark: so a black entry stands there that no order names.
    """

    def __init__(self) -> None:
        self._lately: list[_Table] = []
        self._tables: frozenset[_Table] = frozenset()
        self._numbers: dict[tuple[TableEntry, bool], int] = {}

    def find_round(self, table: Sequence[TableEntry]) -> list[_Table]:
        """Note that a table is to be loaded. Returns the tables among which it comes around,
        including itself; none if it does not."""
        one = tuple(table)
        if not self._lately or self._lately[-1] != one:
            self._lately.append(one)
        del self._lately[:-_REMEMBERED]
        before = [n for n, other in enumerate(self._lately[:-1]) if other == one]
        return list(dict.fromkeys(self._lately[before[-1] :])) if len(before) >= _ROUNDS else []

    def hold(self, joined: JoinedTables) -> None:
        """Note that the device now holds these tables."""
        self._tables = frozenset(joined.tables)
        self._numbers = {(one, n in joined.waiting): n for n, one in enumerate(joined.entries)}

    def part(self) -> None:
        """Note that the device does not hold them any more."""
        self._tables = frozenset()

    def find(self, table: Sequence[TableEntry], *, waits: bool = False) -> list[int] | None:
        """The numbers of a table's entries, in order; with `waits`, the first waits for a trigger.
        None if the device does not hold the table among others."""
        if tuple(table) not in self._tables:
            return None
        return [self._numbers[one, waits and n == 0] for n, one in enumerate(table)]


class JoinedTables(NamedTuple):
    """Tables joined into one. entries : those of all tables, the last one black. waiting : numbers
    of those that wait for a trigger."""

    tables: tuple[_Table, ...]
    entries: tuple[TableEntry, ...]
    waiting: frozenset[int]


def join_tables(tables: Sequence[_Table]) -> JoinedTables:
    """Tables that end on black, joined into one, for `TablesAround.hold`."""
    black = tables[0][-1]
    first = dict.fromkeys(table[0] for table in tables)
    rest = dict.fromkeys(one for table in tables for one in table if one != black)
    entries = (*(one for begin in first for one in (black, begin)), *rest, black)
    return JoinedTables(tuple(tables), entries, frozenset(range(1, 2 * len(first), 2)))
