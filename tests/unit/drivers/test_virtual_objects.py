"""What is read of a photo on the virtual camera's card, by standard operations and Canon's."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.virtual_eos import BULB, Client, virtual_usb

OK, BAD_HANDLE, BAD_PARAMETER = 0x2001, 0x2009, 0x201D


@pytest.fixture
def client() -> Iterator[Client]:
    client = Client(virtual_usb())
    client.start()
    client.set(*BULB)
    client.events()
    yield client
    client.close()


@pytest.fixture
def photo(client: Client) -> int:
    """A photo on the card; its handle."""
    client.ok(0x9125)
    client.wait(1.0)
    client.ok(0x9126)
    client.wait(0.2)
    ((handle, size, _),) = client.files()
    client.ok(0x9117, handle)
    assert size == 3000
    return handle


@pytest.mark.parametrize(
    ("start", "size", "count"),
    [(0, 3000, 3000), (0, 1, 1), (10, 100, 100), (2999, 5, 1), (3000, 5, 0), (0, 9999, 3000)],
)
def test_a_file_is_read_in_pieces(
    client: Client, photo: int, start: int, size: int, count: int
) -> None:
    whole = client.ok(0x1009, photo)
    assert client.ok(0x9104, photo) == whole
    for code in (0x101B, 0x9107):
        response, parameters, piece = client.call(code, photo, start, size)
        assert (response, parameters) == (OK, (count,))
        assert piece == whole[start : start + count]


def test_what_is_not_there_is_not_read(client: Client, photo: int) -> None:
    for code in (0x1009, 0x9104, 0x101B, 0x9107):
        assert client.call(code, photo + 77, 0, 5)[0] == BAD_HANDLE
    for code in (0x101B, 0x9107):
        assert client.call(code, photo, 3001, 5)[0] == BAD_PARAMETER
