"""Do the samples that a decoder gives come from the file?

Three checks: does the decoder give the same samples when fresh memory is filled differently; are
there samples far below black, as in a file whose data are still missing; are there rows of one and
the same number, as from a decoder that lost its place.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.errors import DecodeError

_M_PERTURB = -6
"""Option of glibc's mallopt: fresh memory is filled with the complement of the given byte."""
_FILLINGS = (0x5A, 0xC3)
_UNTOUCHED = 0xA5A5
"""A sample of memory with the first of these fillings."""
_BLOCK_QUADS = 32
_ABSENT, _BLOCKS = 4, 16
"""From these numbers on, blocks of neighbours far below black, or of one number, are no fault of
the sensor; in a small picture a sixteenth of the blocks is enough for the first."""
_LEAST_BLACK, _LEAST_BLACK_SHARE = 4.0, 1.0 / 2000.0
"""Lowest black, in DN and as a share of white, that samples can lie far below."""
_MIXED_SHARE = 0.02
"""Most blocks with some zeros, as a share of all, where zeros are a hole: only at its edges."""
_PER_ZERO = 0.5
"""Least white or black samples that a byte of zeros can stand for."""
_AGAIN = "fetch it from the camera again"
_turn = threading.Condition()
_users: dict[int, int] = {}
"""Threads that decode now, by the filling they want for fresh memory: never two at once."""


def decode_proven(
    first: Callable[[], NDArray[np.uint16]],
    again: Callable[[], NDArray[np.uint16]],
    used: tuple[slice, slice],
    name: str,
    *,
    twice: bool,
) -> NDArray[np.uint16]:
    """A decoder's samples, if they do not depend on the filling of fresh memory.

    first, again : decode the file, each into memory of its own. used : rows and columns that
    matter; some decoders leave unused edges unwritten. twice : whether to decode twice and compare
    in any case; otherwise only if a sample equals the filling. Raises DecodeError.
    """
    with _fresh_memory(_FILLINGS[0]):
        found = first()
    if not twice and not np.any(found[used] == _UNTOUCHED):
        return found
    with _fresh_memory(_FILLINGS[1]):
        other = again()
    if not np.array_equal(found[used], other[used]):
        raise DecodeError(
            f"cannot decode {name}: not all samples are in it, some come from memory", hint=_AGAIN
        )
    return found


def check_samples(
    samples: NDArray[np.generic], black: Floats, white: float, name: str, *, packed: bool
) -> tuple[str, ...]:
    """Look for impossible samples; return what is odd, in words. Raises DecodeError.

    samples : (P, h, w) DN, black included. black : (P,) DN. packed : whether the file is
    compressed; the numbers of an uncompressed file are believed as they stand.
    """
    step = _row_step(samples)
    for plane, level in zip(samples, black, strict=True):
        low = 0.5 * float(level)
        if level >= max(_LEAST_BLACK, _LEAST_BLACK_SHARE * white):
            rows = np.flatnonzero(plane.min(axis=1) < low)
            absent = int(np.count_nonzero(_blocks(plane[rows]).max(axis=1) < low))
            if absent >= min(_ABSENT, max(plane.size // _BLOCK_QUADS // _ABSENT**2, 1)):
                raise DecodeError(
                    f"cannot decode {name}: not all samples are in it, {absent * _BLOCK_QUADS} of "
                    f"a colour lie far below black, from row {step * rows[0]} on",
                    hint=_AGAIN,
                )
        held, row = _count_held(plane, float(level), white)
        if held:
            said = f"{held} samples of a colour are one number, from row {step * row} on"
            if packed:
                raise DecodeError(f"cannot decode {name}: {said}", hint=_AGAIN)
            return (said,)
    return ()


def check_zeros(samples: NDArray[np.generic], name: str, *, packed: bool) -> tuple[str, ...]:
    """Look for blocks of zeros in a file whose black is zero and whose other blocks have none;
    noise that reaches zero would mix zeros and others. A compressed file is refused, else it is
    reported in words.

    samples, packed : as for `check_samples`. Raises DecodeError.
    """
    step = _row_step(samples)
    for plane in samples:
        lit = _blocks(plane) != 0.0
        empty, full = ~lit.any(axis=1), lit.all(axis=1)
        mixed = int(np.count_nonzero(~empty & ~full))
        if empty.sum() >= _ABSENT and full.any() and mixed <= max(1, _MIXED_SHARE * empty.size):
            first = int(np.flatnonzero(empty)[0]) * _BLOCK_QUADS // plane.shape[1]
            said = (
                f"{int(empty.sum())} times {_BLOCK_QUADS} of a colour are zero, from row "
                f"{step * first} on"
            )
            if packed:
                raise DecodeError(
                    f"cannot decode {name}: not all samples are in it, {said}", hint=_AGAIN
                )
            return (f"{said}: black, or not in the file",)
    return ()


def check_hole(hole_bytes: int, even: int, name: str) -> None:
    """Check that `hole_bytes` zeros in a file can stand for samples. Raises DecodeError.

    even : number of white or black samples; only these are packed into zeros.
    """
    if even < _PER_ZERO * hole_bytes:
        raise DecodeError(
            f"cannot decode {name}: not all samples are in it, {hole_bytes} bytes are zero",
            hint=_AGAIN,
        )


def _row_step(samples: NDArray[np.generic]) -> int:
    """Rows of the sensor from one row of a plane to the next."""
    return 1 if len(samples) == 1 else 2


def _count_held(plane: NDArray[np.generic], black: float, white: float) -> tuple[int, int]:
    """Number of samples in blocks of one number that is neither white nor black, and the first row
    with such blocks; 0 if they are few, or most of the plane."""
    top, level = min(0.98 * float(plane.max()), white), max(2.0, 0.002 * (white - black))
    near = plane[:, ::_BLOCK_QUADS].astype(np.float32)
    held_on = (near[:, 1:] == near[:, :-1]) & (near[:, 1:] < top)
    held_on &= np.abs(near[:, 1:] - black) > level
    many = np.count_nonzero(held_on, axis=1) >= min(_BLOCKS, max(near.shape[1] // 2, 1))
    rows = np.flatnonzero(many)
    held = 0
    for row in rows:
        blocks = _blocks(plane[row : row + 1])
        low, high = blocks.min(axis=1), blocks.max(axis=1)
        held += int(np.count_nonzero((low == high) & (abs(low - black) > level) & (low < top)))
    if _BLOCKS <= held < plane.size // _BLOCK_QUADS // 2:
        return held * _BLOCK_QUADS, int(rows[0])
    return 0, 0


def _blocks(rows: NDArray[np.generic]) -> NDArray[np.float64]:
    """Samples in blocks of neighbours, (blocks, quads); an incomplete last block is left out."""
    count = rows.size // _BLOCK_QUADS
    blocks = rows.ravel()[: count * _BLOCK_QUADS].reshape(count, _BLOCK_QUADS)
    return blocks.astype(np.float64)


@contextmanager
def _fresh_memory(filling: int) -> Iterator[None]:
    """Have new memory filled with a byte. Threads that want the same byte share it; those that want
    another wait. Where the C library cannot, nothing is done.

    Memory stays filled afterwards. Were that to end while another thread takes memory of zeros, the
    C library would leave the byte in part of it.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", lambda *_: 0)
    with _turn:
        _turn.wait_for(lambda: not _users or filling in _users)
        _users[filling] = _users.get(filling, 0) + 1
        mallopt(_M_PERTURB, filling)
    try:
        yield
    finally:
        with _turn:
            _users[filling] -= 1
            if not _users[filling]:
                del _users[filling]
                _turn.notify_all()
