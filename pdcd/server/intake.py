"""Reads what clients pass with a request, before the request goes any further.

The daemon opens nothing that a client names, except for names in the folder that the operator set
for this. The client opens everything else itself and passes it on.
"""

from __future__ import annotations

import os
import weakref
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from pdcd.arrays import Floats
from pdcd.errors import RequestError
from pdcd.files.opening import Asker
from pdcd.planning.given import (
    FileSource,
    find_long_fields,
    list_file_fields,
    make_descriptor_source,
    make_folder_source,
    make_text_source,
    read_request_arrays,
)
from pdcd.protocol.request import CaptureRequest, SentArray
from pdcd.recipes.arrays import NO_ARRAYS, Given, count_most_elements
from pdcd.server.access import Peer
from pdcd.server.readers import Readers

HELD_BYTES = 256 * 2**20
"""Bytes of arrays of all waiting requests, half of it for one user; a single request may have
more."""


class Intake:
    """Reads the arrays of requests for a rig with that grid. Used from one event loop.

    `folder` is where names are looked up; None: names are refused.
    """

    def __init__(
        self, folder: Path | None, grid: tuple[int, int], readers: Readers | None = None
    ) -> None:
        self._folder, self._grid = folder, grid
        self._readers = readers or Readers()
        self._held: dict[int, weakref.WeakValueDictionary[int, Floats]] = {}
        self._expected: dict[object, tuple[int, int]] = {}
        """User and size in bytes of each read in progress."""

    async def take(
        self, request: CaptureRequest, descriptors: Sequence[int], peer: Peer
    ) -> tuple[CaptureRequest, Given]:
        """The request as it is to be kept, and its arrays; returns at once where nothing is to be
        read.

        `descriptors` came with it, and remain the caller's. Raises RequestError for what cannot be
        accepted, BusyError when too much is waiting already.
        """
        fields, rows = list_file_fields(request), find_long_fields(request)
        if not fields and not rows:
            return request, NO_ARRAYS
        size = 8 * (sum(rows.values()) + sum(count_most_elements(f, self._grid) for f in fields))
        ticket, uid = object(), peer.uid

        def prepare() -> Callable[[Callable[[], None]], tuple[CaptureRequest, Given]]:
            own = ExitStack()
            with ExitStack() as on_error:
                on_error.push(own)
                sources = self._sources(fields, descriptors, own)
                on_error.pop_all()
            self._expected[ticket] = uid, size

            def read(alive: Callable[[], None]) -> tuple[CaptureRequest, Given]:
                with own:  # closing a file may take as long as reading it
                    asker = Asker(peer.uid, frozenset({peer.gid, *peer.groups}))
                    made = {name: make(asker) for name, make in sources.items()}
                    return read_request_arrays(request, made, self._grid, alive)

            return read

        try:
            kept, given = await self._readers.run(
                peer.uid, prepare, lambda: self._room(peer.uid, size)
            )
        finally:
            self._expected.pop(ticket, None)
        held = self._held.setdefault(uid, weakref.WeakValueDictionary())
        for array in given.values():
            held[id(array)] = array
        return kept, given

    def _room(self, uid: int, size: int) -> bool:
        """Whether so many bytes may be read for a user in addition to what is held. A single
        request may use all of the memory, but nobody can shut others out by sending many."""
        held = Counter({user: sum(a.nbytes for a in kept.values())
                        for user, kept in self._held.items()})  # fmt: skip
        for user, expected in self._expected.values():
            held[user] += expected
        fits = held.total() + size <= HELD_BYTES
        return not held.total() or (fits and (not held[uid] or held[uid] + size <= HELD_BYTES // 2))

    def _sources(
        self, fields: Mapping[str, str | SentArray], descriptors: Sequence[int], own: ExitStack
    ) -> dict[str, Callable[[Asker], FileSource]]:
        """The source of each field, by whom it is asked for; duplicated descriptors are closed by
        `own`."""
        sources: dict[str, Callable[[Asker], FileSource]] = {}
        for name, value in fields.items():
            if isinstance(value, str):
                sources[name] = self._named(name, value)
                continue
            file = _label(name, value)
            if value.fd is not None and value.npy is None and value.sha256 is None:
                if value.fd >= len(descriptors):
                    raise RequestError(
                        f"{name} is descriptor {value.fd}; {len(descriptors)} came with the line",
                        hint='pass them with the line (SCM_RIGHTS), and say how many in "fds"',
                    )
                # A duplicate, because the caller may close its own while a read still hangs.
                copy = os.dup(descriptors[value.fd])
                own.callback(os.close, copy)
                sources[name] = _always(make_descriptor_source(copy, file))
            elif value.npy is not None and value.fd is None and value.sha256 is None:
                sources[name] = _always(make_text_source(value.npy, file))
            else:
                raise RequestError(
                    f"{name} is neither a descriptor nor a file",
                    hint='give {"fd": index} or {"npy": base64}, and "file" if it has a name',
                )
        return sources

    def _named(self, name: str, value: str) -> Callable[[Asker], FileSource]:
        folder = self._folder
        if folder is None:
            raise RequestError(
                f"{name} is a name, and this daemon has no folder of arrays",
                hint="pass the file itself, as pdcd capture does, or set [server] arrays",
            )
        if not value.isprintable():
            raise RequestError(f"{name}: {value[:80]!r} is no name of a file")
        return lambda asker: make_folder_source(folder, value, asker)


def _always(source: FileSource) -> Callable[[Asker], FileSource]:
    return lambda asker: source


def _label(name: str, value: SentArray) -> str | None:
    if value.file is not None and not value.file.isprintable():
        raise RequestError(f"{name}: {value.file[:80]!r} is no name of a file")
    return value.file
