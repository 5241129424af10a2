"""A promise of a driver, and the failure that says that it was broken."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

_BESIDE_S = 10.0
"""How long a call beside another may take: what fails closed ends the process after that."""


class BrokenPromise(AssertionError):  # noqa: N818, it is no error of a driver
    """A driver does not do what its role promises."""


@dataclass(frozen=True)
class Promise:
    """One sentence of a role, and what to do where a driver breaks it."""

    says: str
    do: str

    def require(self, kept: object, found: object = "") -> None:
        """Raise BrokenPromise unless it was kept; `found` says what was seen instead."""
        if not kept:
            raise BrokenPromise(f"{self.says}\n  found: {found}\n  {self.do}")

    @contextmanager
    def keep(self) -> Iterator[None]:
        """Any error in this block breaks the promise."""
        try:
            yield
        except BrokenPromise:
            raise
        except Exception as err:
            raise BrokenPromise(f"{self.says}\n  found: {_told(err)}\n  {self.do}") from err

    def require_error(self, kind: type[Exception], call: Callable[[], object]) -> str:
        """See that a call raises such an error; returns what it says, with its hint."""
        try:
            found: object = call()
        except kind as err:
            return str(err)
        except Exception as err:
            raise BrokenPromise(f"{self.says}\n  found: {_told(err)}\n  {self.do}") from err
        raise BrokenPromise(f"{self.says}\n  found: no error, but {found!r:.80}\n  {self.do}")

    def require_beside(self, call: Callable[[], object]) -> None:
        """See that a call returns from another thread while this one is in the driver."""
        broken: list[BrokenPromise] = []

        def run() -> None:
            try:
                with self.keep():
                    call()
            except BrokenPromise as err:
                broken.append(err)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        thread.join(_BESIDE_S)
        self.require(not thread.is_alive(), f"it had not returned after {_BESIDE_S:g} s")
        for err in broken:
            raise err


def _told(err: Exception) -> str:
    return f"{type(err).__name__}: {err}"
