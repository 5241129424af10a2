"""JPEGs of devices: read where they are sound, refused before memory is asked for."""

from __future__ import annotations

import struct
import time

import numpy as np
import pytest

from pdcd.files.images import decode_jpeg, encode_jpeg

PICTURE = np.full((40, 60, 3), (200, 60, 20), np.uint8)
GOOD = encode_jpeg(PICTURE)


def test_colours_and_sizes_come_back() -> None:
    found = decode_jpeg(GOOD)
    assert found is not None and found.shape == PICTURE.shape
    assert np.abs(found.astype(int) - PICTURE).max() <= 4
    grey = decode_jpeg(encode_jpeg(PICTURE[..., 0]))
    assert grey is not None and np.abs(grey.astype(int) - 200).max() <= 4


def with_size(height: int, width: int) -> bytes:
    at = GOOD.index(b"\xff\xc0") + 5
    return GOOD[:at] + struct.pack(">HH", height, width) + GOOD[at + 4 :]


@pytest.mark.parametrize(
    "data",
    [
        b"", b"\xff\xd8", GOOD[:1], GOOD[1:], b"\xff" * 100_000, b"\x89PNG" + GOOD,
        with_size(65500, 65500), with_size(0, 60), with_size(4097, 1), GOOD[:2] + GOOD[2:10] * 50,
        GOOD[:2] + b"\xff\xe0\x00\x00" * 1000,
    ],
)  # fmt: skip
def test_what_is_none_is_refused(data: bytes) -> None:
    assert decode_jpeg(data) is None


def test_nothing_random_raises_or_takes_long() -> None:
    rng = np.random.default_rng(3)
    begun_s = time.process_time()
    for _ in range(200):
        spoilt = bytearray(GOOD)
        for at in rng.integers(2, len(GOOD), 8):
            spoilt[at] = int(rng.integers(256))
        found = decode_jpeg(bytes(spoilt))
        assert found is None or max(found.shape) <= 4096
    assert time.process_time() - begun_s < 60.0
