"""Numbers of a page: rounded to whole steps, compressed, as text; `unpack.js` unpacks them.

The error of rounding is always kept: every block has its step, or the share by which its values may
be off.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

PackedBlock = dict[str, Any]
"""A block of numbers in the page's data: `shape`, `kind`, and its bytes in base64."""

MOST_STEPS = 32766
"""Most steps of a value."""
NO_VALUE = -32768
"""The number that stands for NaN."""
_SHARE = 0.02
"""Step of a logarithm: values are off by 1 %."""
_PAIR = 255.0
"""Steps between the least and the largest value of a row of factors."""


def pack_linear(values: NDArray[np.floating], step: float) -> PackedBlock:
    """Values (..., H, W) as whole steps, off by at most half of one; NaN stays NaN.

    step : at least 1 / `MOST_STEPS` of the largest absolute value (`choose_step`).
    """
    with np.errstate(invalid="ignore"):
        steps = np.rint(np.clip(values / step, -MOST_STEPS, MOST_STEPS))
    whole = np.where(np.isfinite(values), steps, NO_VALUE).astype(np.int16)
    # Neighbours are similar, so differences from the value to the left are kept, folded so that
    # small ones of either sign have an empty upper byte.
    apart = np.diff(whole, axis=-1, prepend=np.int16(0))
    folded = ((apart << 1) ^ (apart >> 15)).view(np.uint16)
    halves = np.concatenate([(folded & 0xFF).ravel(), (folded >> 8).ravel()]).astype(np.uint8)
    return {"kind": "linear", "shape": list(values.shape), "step": step, "data": _text(halves)}


def choose_step(values: NDArray[np.floating], wanted: float) -> float:
    """The wanted step, or the least that the largest value allows; always above 0."""
    known = np.abs(values[np.isfinite(values)])
    top = float(known.max()) if known.size else 0.0
    return max(wanted, top / MOST_STEPS) or 1.0


def pack_logarithmic(values: NDArray[np.floating]) -> PackedBlock:
    """Values from 0 on (..., H, W) as whole steps of their logarithm, off by at most the share
    `off`. NaN becomes infinite, infinite values stay so, and 0 becomes nearly 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(values)
    logs = np.where(values == 0.0, -MOST_STEPS * _SHARE, logs)
    return {
        **pack_linear(logs, _SHARE),
        "kind": "logarithmic",
        "off": float(np.expm1(0.5 * _SHARE)),
    }


def pack_factors(rows: NDArray[np.floating]) -> tuple[PackedBlock, NDArray[np.float32]]:
    """Rows (R, N) of factors, each in steps of its own span, and their values when unpacked.

    Rows of codes have two values, or a few, and are then unpacked almost exactly.
    """
    low, high = rows.min(axis=1), rows.max(axis=1)
    step = np.where(high > low, (high - low) / _PAIR, 1.0).astype(np.float32)
    low = low.astype(np.float32)
    whole = np.clip(np.rint((rows - low[:, None]) / step[:, None]), 0, _PAIR).astype(np.uint8)
    back = low[:, None] + step[:, None] * whole
    block = {
        "kind": "factored",
        "shape": list(rows.shape),
        "low": _text(low.astype("<f4")),
        "step": _text(step.astype("<f4")),
        "data": _text(whole, level=3),
    }
    return block, back.astype(np.float32)


def pack_singles(values: NDArray[np.floating]) -> PackedBlock:
    """Values in single precision."""
    data = np.ascontiguousarray(values, dtype="<f4")
    return {"kind": "singles", "shape": list(values.shape), "data": _text(data)}


def pack_integers(values: NDArray[np.integer]) -> PackedBlock:
    """Whole numbers of 32 bits (..., n), of which neighbours are often similar."""
    data = np.diff(values.astype("<i4"), axis=-1, prepend=np.int32(0)).astype("<i4")
    return {"kind": "integers", "shape": list(values.shape), "data": _text(data, level=6)}


def block_size_bytes(block: PackedBlock) -> int:
    """Approximate size of a block in the page."""
    return sum(len(part) for part in block.values() if isinstance(part, str))


def _text(data: NDArray[Any], level: int = 0) -> str:
    """Bytes of an array, compressed, in base64. Without a `level` they are compressed as noise, in
    which nothing repeats but some bytes are more frequent."""
    strategy = zlib.Z_DEFAULT_STRATEGY if level else zlib.Z_RLE
    packer = zlib.compressobj(level or 6, zlib.DEFLATED, 15, 9, strategy)
    raw = packer.compress(np.ascontiguousarray(data).tobytes()) + packer.flush()
    return base64.b64encode(raw).decode("ascii")
