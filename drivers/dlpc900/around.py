"""Tables that come around again and again: they lie in a device side by side.

A device is to be sent its pictures anew as soon as an entry shows another plane, and USB is slow:
it would take seconds a photo where a stream shows its parts in turn. An order of entries leaves
pictures as they are; by the guide it may name some of them, and one several times. So tables that
have come around twice are loaded as one, and each is shown by the order of its own entries.
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
    """Tables that one device was to show lately, and where those lie that it has side by side.

    A trigger belongs to an entry. So each table has its first entry twice, one that waits in front
    of one that does not. What lies in front of either is black: the last entry of another table.
    """

    def __init__(self) -> None:
        self._lately: list[_Table] = []
        self._begins: dict[_Table, int] = {}
        self._joined: dict[_Table, int] = {}

    def find_round(self, table: Sequence[TableEntry]) -> list[_Table]:
        """Note that a table is to be loaded; the tables among which it comes around, itself among
        them, none where it does not."""
        one = tuple(table)
        if not self._lately or self._lately[-1] != one:
            self._lately.append(one)
        del self._lately[:-_REMEMBERED]
        *_, since = (n for n, other in enumerate(self._lately) if other == one)
        before = [n for n, other in enumerate(self._lately[:since]) if other == one]
        return list(dict.fromkeys(self._lately[before[-1] :])) if len(before) >= _ROUNDS else []

    def join(self, tables: Sequence[_Table]) -> tuple[list[TableEntry], set[int]]:
        """All entries of these tables, and which of them wait for a trigger."""
        entries, self._joined = list[TableEntry](), {}
        for table in tables:
            self._joined[table] = len(entries)
            entries += [table[0], *table]
        return entries, set(self._joined.values())

    def joined(self) -> None:
        """The device has what `join` told last."""
        self._begins = self._joined

    def part(self) -> None:
        """The device has them no longer."""
        self._begins = {}

    def find(self, table: Sequence[TableEntry], *, waits: bool = False) -> list[int] | None:
        """The entries of a table, the first of which waits for a trigger or not; None where it does
        not lie beside others."""
        begin = self._begins.get(tuple(table))
        if begin is None:
            return None
        return [begin + (not waits), *range(begin + 2, begin + 1 + len(table))]
