"""What a reader may take, and the one error that it raises."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


class Unsound(Exception):  # noqa: N818 - reads as the state it reports
    """A file cannot be taken. `message` goes on from the file's name; `hint` says what to do.

    Callers know whose file it is, and turn this into the error of a request or of the
    configuration.
    """

    def __init__(self, message: str, hint: str = "write it with numpy.save, or as PNG") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


@dataclass(frozen=True)
class Limits:
    """How much one array may be.

    elements : the most numbers in it.
    alive : called at least once for each MiB read, and may raise to end the work.
    """

    elements: int
    alive: Callable[[], None] = lambda: None

    @property
    def file_bytes(self) -> int:
        """The most bytes of its file: numbers of 8 bytes, and 1 MiB for all that is around."""
        return 8 * self.elements + 2**20

    def check(self, shape: tuple[int, ...]) -> int:
        """The numbers in an array of that shape. Raises Unsound when they are none or too many."""
        count = 1
        for side in shape:
            count *= side
        if min(shape, default=1) < 1:
            raise Unsound(f"it has the shape {_said(shape)}, which holds no number")
        if count > self.elements:
            raise Unsound(
                f"it has the shape {_said(shape)}; at most {self.elements} numbers are taken",
                "give one value for each cell, or one for each pair of them in a matrix",
            )
        return count


def _said(shape: tuple[int, ...]) -> str:
    """A shape for people, however long its numbers are."""
    text = " x ".join(str(side) if side < 10**12 else "more than 10^12" for side in shape[:8])
    return text + (" ..." if len(shape) > 8 else "")
