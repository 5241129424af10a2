"""OpenEXR files: three channels of 32-bit floats and what is known of them as text.

One part, scan lines in blocks of 16, compressed by ZIP as the format's specification has it
(OpenEXR File Layout). Every value comes back exactly, negative ones and NaN as well.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

MAGIC, VERSION = 20000630, 2
ZIP, BLOCK_LINES = 3, 16
FLOAT = 2
LEVEL = 4
"""Of the compression: more takes far longer and gains little."""


def exr_bytes(image: NDArray[np.float32], told: Mapping[str, str]) -> bytes:
    """A picture as the bytes of a file.

    image : (h, w, 3) float32, linear RGB; told : attributes, names of up to 31 ASCII letters.
    """
    height, width, _ = image.shape
    # Channels lie in the order of their names, line by line.
    lines = np.ascontiguousarray(image[..., ::-1].swapaxes(1, 2), dtype="<f4")
    blocks = [_packed(lines[y : y + BLOCK_LINES].tobytes()) for y in range(0, height, BLOCK_LINES)]
    head = struct.pack("<ii", MAGIC, VERSION) + b"".join(_header(width, height, told)) + b"\0"
    at, offsets, body = len(head) + 8 * len(blocks), [], []
    for number, block in enumerate(blocks):
        offsets.append(at)
        body.append(struct.pack("<ii", number * BLOCK_LINES, len(block)) + block)
        at += len(body[-1])
    return b"".join([head, struct.pack(f"<{len(offsets)}Q", *offsets), *body])


def _header(width: int, height: int, told: Mapping[str, str]) -> Iterator[bytes]:
    channels = b"".join(
        name + b"\0" + struct.pack("<iB3xii", FLOAT, 0, 1, 1) for name in (b"B", b"G", b"R")
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    yield _attribute("channels", "chlist", channels + b"\0")
    yield _attribute("compression", "compression", bytes([ZIP]))
    yield _attribute("dataWindow", "box2i", window)
    yield _attribute("displayWindow", "box2i", window)
    yield _attribute("lineOrder", "lineOrder", b"\0")
    yield _attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0))
    yield _attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0))
    yield _attribute("screenWindowWidth", "float", struct.pack("<f", 1.0))
    for name, words in told.items():
        yield _attribute(name, "string", words.encode())


def _attribute(name: str, kind: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value


def _packed(raw: bytes) -> bytes:
    """A block of scan lines: bytes of even and odd places apart, as differences, deflated."""
    plain = np.frombuffer(raw, np.uint8)
    apart = np.concatenate([plain[0::2], plain[1::2]])
    steps = apart.copy()
    steps[1:] -= apart[:-1] + np.uint8(128)  # modulo 256, as the format wants it
    packed = zlib.compress(steps.tobytes(), LEVEL)
    return packed if len(packed) < len(raw) else raw
