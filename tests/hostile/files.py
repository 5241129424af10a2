"""Content of hostile files, and hostile kinds of files."""

from __future__ import annotations

import functools
import io
import os
import random
import socket
import struct
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np

Random = random.Random
MOST_CELLS = 400
"""Whose transport takes a megabyte, and not the machine."""
Content = Callable[[Random, tuple[int, int]], bytes]

VALUES = (0.0, 1.0, 0.5, -1.0, 2.0, 1e300, -1e300, 5e-324, 1e-300, np.nan, np.inf, 1e18, 0.1)
DTYPES = (
    "f8", "f4", "f2", "i1", "u1", "i8", "u8", "?", ">f8", ">i4", "g", "c16", "c8", "O", "S4", "U4",
    "V8", "M8[s]", "m8[s]", "f4,i4",
)  # fmt: skip
HEADERS = (
    "", "{}", "(" * 9000, "[" * 5000 + "]" * 5000, "{'descr': '<f8'}", "None", "{1: 2}", "9" * 5000,
    "{'descr': '<f8', 'fortran_order': 0, 'shape': (3, 4)}",
    "{'descr': '<f8', 'fortran_order': False, 'shape': [3, 4]}",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (3.0, 4)}",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (True, 4)}",
    "{'descr': ['<f8'], 'fortran_order': False, 'shape': (3, 4)}",
    "{'descr': [('a', '<f8', (10**9,))], 'fortran_order': False, 'shape': (3, 4)}",
    "{'descr': '<f9', 'fortran_order': False, 'shape': (3, 4)}",
    "{'descr': ('<f8', (3, 4)), 'fortran_order': False, 'shape': ()}",
    "{'descr': '|V2000000000', 'fortran_order': False, 'shape': (3, 4)}",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (3L, 4L), }",
    "__import__('os').abort()",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4)" + ")" + " " * 1980 + "x",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4)" + ")" + " " * 9800 + "x",
)  # fmt: skip
SHAPES: tuple[tuple[int, ...], ...] = (
    (), (0,), (0, 0), (3, 0), (12,), (3, 4, 1), (1,) * 40, (4, 3), (10**6, 10**6), (2**63, 2),
    (-3, -4), (-1, 12), (10**5000, 1), (2**32, 2**32),
)  # fmt: skip


def npy(array: Any) -> bytes:
    """An array as numpy stores it."""
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


def raw_npy(header: str, data: bytes, version: int = 1) -> bytes:
    """A .npy file with any header."""
    text = header.encode("latin-1", "replace")
    size = struct.pack(
        "<H" if version == 1 else "<I", len(text) % (65536 if version == 1 else 2**32)
    )
    return b"\x93NUMPY" + bytes([version, 0]) + size + text + data


def honest(rng: Random, shape: tuple[int, int]) -> bytes:
    return npy(np.random.default_rng(rng.getrandbits(32)).integers(0, 2, shape).astype(float))


def odd_values(rng: Random, shape: tuple[int, int]) -> bytes:
    values = [rng.choice(VALUES) for _ in range(shape[0] * shape[1])]
    return npy(np.array(values).reshape(shape))


def one_value(rng: Random, shape: tuple[int, int]) -> bytes:
    return npy(np.full(shape, rng.choice(VALUES)))


def odd_type(rng: Random, shape: tuple[int, int]) -> bytes:
    array = np.zeros(shape, dtype=rng.choice(DTYPES))
    return npy(np.asfortranarray(array) if rng.random() < 0.3 else array)


def odd_shape(rng: Random, shape: tuple[int, int]) -> bytes:
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {_text(rng.choice(SHAPES))}, }}\n"
    return raw_npy(text, bytes(rng.choice((0, 8, 96, 800))), rng.choice((1, 2)))


def odd_header(rng: Random, shape: tuple[int, int]) -> bytes:
    return raw_npy(rng.choice(HEADERS) + "\n", bytes(96), rng.choice((1, 2, 3, 255)))


def empty(rng: Random, shape: tuple[int, int]) -> bytes:
    return b""


def noise(rng: Random, shape: tuple[int, int]) -> bytes:
    magic = rng.choice((b"", b"\x93NUMPY\x01\x00", b"PK\x03\x04", b"\x89PNG\r\n\x1a\n", b"II*\0"))
    return magic + rng.randbytes(rng.randrange(300))


def stacked(rng: Random, shape: tuple[int, int]) -> bytes:
    """An .npz with one array, with several, or with members beyond counting."""
    if rng.random() < 0.2:
        return _crowd()
    names = ("illumination", "kernel", "../../x", "a" * 200, "é", "0")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", rng.choice((0, 8, 12, 14))) as archive:
        for number in range(rng.choice((0, 1, 2))):
            archive.writestr(f"{number}{rng.choice(names)}.npy", npy(np.ones(shape)))
    return stream.getvalue()


@functools.cache
def _crowd() -> bytes:
    """An .npz whose directory is larger than all that is in it."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for number in range(2000):
            archive.writestr(f"{number}.npy", b"")
    return stream.getvalue()


def transport(rng: Random, shape: tuple[int, int]) -> bytes:
    """A prior, sound or not; of a matrix in its place a small one."""
    cells = min(shape[0] * shape[1], MOST_CELLS)
    stored: dict[str, Any] = {"transport": np.ones((cells, cells)), "grid": np.array(shape)}
    if rng.random() < 0.5:
        stored["grid"] = rng.choice(
            [np.array(3), np.array([1e300, 1]), np.array([0, 0]), np.array([[3, 4]]),
             np.array(["3"]), np.array([cells, 1]), np.array([-3, -4])]
        )  # fmt: skip
    if rng.random() < 0.5:
        stored["transport"] = stored["transport"] * rng.choice(VALUES)
    stream = io.BytesIO()
    np.savez(stream, **stored)
    return stream.getvalue()


@functools.cache
def _bomb() -> bytes:
    """An .npz of 200 kB that unpacks to 40 MB, though its header asks for 96 bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("illumination.npy", "w", force_zip64=True) as member:
            member.write(npy(np.zeros((3, 4))))
            for _ in range(40):
                member.write(bytes(10**6))
    return stream.getvalue()


def bomb(rng: Random, shape: tuple[int, int]) -> bytes:
    return _bomb()


def picture(rng: Random, shape: tuple[int, int]) -> bytes:
    """A PNG file, of any kind of pixel."""
    dtype: type[np.unsignedinteger[Any]] = rng.choice((np.uint8, np.uint16))
    size = (*shape, rng.choice((1, 3, 4)))
    pixels = np.random.default_rng(rng.getrandbits(32)).integers(0, 256, size)
    done, data = cv2.imencode(".png", pixels.astype(dtype))
    return data.tobytes() if done else b""


def odd_picture(rng: Random, shape: tuple[int, int]) -> bytes:
    """A PNG file with sound checksums and anything in it."""
    size = (1, 3, 4, 2**16, 2**31 - 1, 2**32 - 1, 0)
    head = struct.pack(
        ">IIBBBBB", rng.choice(size), rng.choice(size), rng.choice((1, 8, 16, 3)),
        rng.choice((0, 2, 3, 4, 6, 9)), rng.choice((0, 0, 0, 1)), 0, rng.choice((0, 0, 0, 1)),
    )  # fmt: skip
    pixels = zlib.compress(bytes(rng.choice((0, 12, 15, 30, 10**6))), 1)
    bodies = [(b"IHDR", head), (b"IDAT", pixels), (b"IEND", b"")]
    if rng.random() < 0.3:
        kind = rng.choice((b"acTL", b"iCCP", b"zTXt", b"eXIf", b"PLTE", b"IHDR", b"tRNS"))
        bodies.insert(rng.randrange(3), (kind, rng.randbytes(rng.randrange(40))))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(*body) for body in bodies)


def mutated(rng: Random, shape: tuple[int, int]) -> bytes:
    """A sound file with some bytes changed, taken out or put in."""
    data = bytearray(rng.choice((honest, picture, transport, stacked))(rng, shape))
    for _ in range(rng.randrange(1, 5)):
        at = rng.randrange(len(data)) if data else 0
        match rng.randrange(3):
            case 0:
                data[at : at + 1] = rng.randbytes(1)
            case 1:
                del data[at : at + rng.randrange(1, 20)]
            case _:
                data[at:at] = rng.randbytes(rng.randrange(1, 20))
    return bytes(data)


def truncated(rng: Random, shape: tuple[int, int]) -> bytes:
    data = rng.choice((honest, picture, transport))(rng, shape)
    return data[: rng.randrange(len(data))]


CONTENTS: tuple[Content, ...] = (
    honest, honest, odd_values, one_value, odd_type, odd_shape, odd_header, empty, noise, stacked,
    transport, bomb, picture, odd_picture, mutated, mutated, truncated,
)  # fmt: skip


def kinds(folder: Path) -> dict[str, Path]:
    """Files of every kind below a folder, by name: what a client might name or pass."""
    folder.mkdir(parents=True, exist_ok=True)
    made = {name: folder / name for name in ("fifo", "loop", "link", "secret", "sparse", "zero")}
    (folder / "good.npy").write_bytes(npy(np.ones((3, 4))))
    made["good.npy"], made["folder"] = folder / "good.npy", folder / "sub"
    made["folder"].mkdir()
    os.mkfifo(made["fifo"])
    made["loop"].symlink_to("loop")
    made["link"].symlink_to("good.npy")
    made["zero"].symlink_to("/dev/zero")
    made["secret"].write_bytes(npy(np.ones((3, 4))))
    made["secret"].chmod(0o600)
    with made["sparse"].open("wb") as stream:
        stream.write(npy(np.ones((3, 4))))
        stream.truncate(2**40)
    with socket.socket(socket.AF_UNIX) as sock:
        made["socket"] = folder / "socket"
        with suppress(OSError):  # a path too long for a socket
            sock.bind(str(made["socket"]))
    return made


def opened(rng: Random, path: Path) -> int:
    """A descriptor of a path, opened as a client may open it; of /dev/null where it cannot."""
    flags = rng.choice((os.O_RDONLY, os.O_RDONLY, os.O_RDWR, os.O_WRONLY, os.O_PATH))
    try:
        return os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return os.open("/dev/null", os.O_RDONLY | os.O_CLOEXEC)


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _text(shape: tuple[int, ...]) -> str:
    sides = ["1" + "0" * 5000 if side > 10**4000 else str(side) for side in shape]
    return f"({', '.join(sides)}{',' * (len(shape) == 1)})"
