"""Blocks of numbers of a page, unpacked as its script does it; written apart from the packing."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.pages.report.packing import PackedBlock


def raw(text: str, dtype: str) -> NDArray[Any]:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype)


def unpacked(block: PackedBlock) -> NDArray[Any]:
    """As docs say that `unpack.js` does: along the last axis differences are summed up."""
    shape = block["shape"]
    if block["kind"] in ("linear", "logarithmic"):
        low, high = raw(block["data"], "u1").reshape(2, *shape).astype(np.int64)
        folded = low + 256 * high
        steps = np.where(folded % 2, -(folded // 2) - 1, folded // 2)
        whole = (np.cumsum(steps, axis=-1) + 2**15) % 2**16 - 2**15
        values = np.where(whole == -32768, np.nan, whole * block["step"])
        if block["kind"] == "linear":
            return values
        return np.where(np.isnan(values), np.inf, np.exp(values))
    if block["kind"] == "factored":
        steps = raw(block["data"], "u1").reshape(shape)
        low, step = (raw(block[part], "<f4")[:, None] for part in ("low", "step"))
        return np.asarray(low + step * steps)
    if block["kind"] == "integers":
        return np.cumsum(raw(block["data"], "<i4").reshape(shape), axis=-1)
    single: NDArray[Any] = raw(block["data"], "<f4").reshape(shape)
    return single
