"""Pictures for a DLPC900: bytes by hand from the guide's table of pieces, and taken apart again.

Streams are those of the words of TI DLPU018, section "Pattern BMP": not of any program's output.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.dlpc900.erle import CopyAbove, PlaneOrder, encode_erle, encode_picture
from tests.dlpc900_reports import read_picture

ORDERS: tuple[PlaneOrder, ...] = ("GBR", "BGR", "RGB", "RBG", "GRB", "BRG")
COPIES: tuple[CopyAbove, ...] = ("lines", "parts", "never")
END = "000100"
Words = NDArray[np.uint32]


def words(*lines: list[int]) -> Words:
    return np.array(lines, dtype=np.uint32)


def erle(picture: Words, copy_above: CopyAbove = "lines", order: PlaneOrder = "BGR") -> str:
    return encode_erle(picture, order, copy_above).hex()


def test_runs_copies_and_the_end() -> None:
    """In the order "BGR" a word's highest byte is sent first."""
    one, two = 0x0D1E2F, 0xFFFFFF
    line = [one] * 5 + [two] * 3
    assert erle(words(line)) == "050d1e2f" + "03ffffff" + END
    assert erle(words(line, line)) == "050d1e2f" + "03ffffff" + "000108" + END
    assert erle(words(line, line), "never") == 2 * ("050d1e2f" + "03ffffff") + END
    assert erle(words([one])) == "010d1e2f" + END


def test_counts_from_128_on_take_two_bytes() -> None:
    """n: (n & 127) + 128, then n >> 7. 130 is 82 01, in spite of the guide's own example."""
    for count, coded in ((127, "7f"), (128, "8001"), (130, "8201"), (300, "ac02"), (1920, "800f")):
        line = [0x010203] * count
        assert erle(words(line, line)) == f"{coded}010203" + f"0001{coded}" + END


def test_the_first_line_is_never_a_copy_of_what_is_not_there() -> None:
    for copy_above in COPIES:
        assert erle(words([0, 0, 0]), copy_above) == "03000000" + END


def test_parts_of_a_line_are_copied_where_that_is_shorter() -> None:
    """An edge between two cells that moves by a pixel, in a line of eight cells of five pixels."""
    cells = np.repeat(np.arange(1, 9, dtype=np.uint32), 5)
    moved = cells.copy()
    moved[19] = cells[20]
    picture = np.stack([cells, moved])
    runs = "".join(f"050000{n:02x}" for n in range(1, 9))
    assert erle(picture, "parts") == runs + "000113" + "01000005" + "000114" + END
    again = "".join(f"{n:02x}0000{v:02x}" for v, n in enumerate([5, 5, 5, 4, 6, 5, 5, 5], 1))
    assert erle(picture, "lines") == runs + again + END
    # Copies on both sides of one pixel would take more bytes than one run.
    dented = words([7, 7, 8, 7, 7], [7, 7, 7, 7, 7])
    assert erle(dented, "parts") == erle(dented, "never")


def test_each_plane_is_one_bit_of_one_byte() -> None:
    """Letters say which of the bytes R, G and B, sent in this order, holds planes 0-7, 8-15 ..."""
    for order, plane in product(ORDERS, (0, 7, 8, 15, 16, 23)):
        stream = encode_erle(words([1 << plane]), order, "lines")
        byte = "RGB".index(order[plane // 8])
        assert list(stream[1:4]) == [(1 << plane % 8) if n == byte else 0 for n in range(3)]


def test_the_header() -> None:
    data = encode_picture(words([0xABCDEF] * 3, [0xABCDEF] * 3), "BGR", "lines")
    stream = bytes.fromhex("03abcdef" + "000103" + END)
    assert data == (
        b"Spld" + bytes([3, 0, 2, 0, len(stream), 0, 0, 0]) + b"\xff" * 8 + bytes(4)
        + bytes([1, 2, 1, 0, 0, 1]) + bytes(18) + stream
    )  # fmt: skip
    assert len(data) - len(stream) == 48


def test_noise_is_sent_as_it_is() -> None:
    rng = np.random.default_rng(1)
    picture = rng.integers(0, 2**24, (6, 40)).astype(np.uint32)
    data = encode_picture(picture, "GBR", "lines")
    assert data[25] == 0 and len(data) == 48 + 3 * picture.size
    first = int(picture[0, 0])
    assert list(data[48:51]) == [first >> 16, first & 255, first >> 8 & 255]


@settings(max_examples=60)
@given(
    size=st.tuples(st.integers(1, 12), st.integers(1, 300)),
    block=st.tuples(st.integers(1, 5), st.integers(1, 150)),
    values=st.integers(1, 5),
    slant=st.integers(0, 3),
    seed=st.integers(0, 2**16),
)
def test_nothing_is_lost(
    size: tuple[int, int], block: tuple[int, int], values: int, slant: int, seed: int
) -> None:
    down, across = block
    row, column = np.indices(size)
    cells = np.random.default_rng(seed).integers(0, values, (13, 306)) * 0x214365 % 2**24
    picture = cells[row // down, (column + slant * row) // across % 306].astype(np.uint32)
    for order in ORDERS[:2]:
        lengths = []
        for copy_above in COPIES:
            data = encode_picture(picture, order, copy_above)
            lengths.append(len(data))
            found = read_picture(data)
            shown = sum(
                found[..., "RGB".index(letter)].astype(np.uint32) << (8 * n)
                for n, letter in enumerate(order)
            )
            np.testing.assert_array_equal(shown, picture)
        lines, parts, never = lengths
        assert parts <= lines <= never
