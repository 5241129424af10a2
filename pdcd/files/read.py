"""One array from the bytes of a file, whatever form it has; the bytes tell, not a name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.files import npy, png
from pdcd.files.limits import Limits, Unsound

Floats = NDArray[np.float64]


def read_array(data: bytes, name: str, limits: Limits) -> Floats:
    """A two-dimensional array of finite numbers, (rows, columns) float64.

    Taken are .npy, .npz with one array or one of that `name`, and PNG: grey, full scale 1. Raises
    Unsound.
    """
    if data.startswith(png.MAGIC):
        return png.read_png(data, limits)
    if data.startswith(npy.NPY_MAGIC):
        array = npy.read_npy(data, limits)
    elif data.startswith(npy.ZIP_MAGIC):
        held = npy.members(data)
        if name not in held and len(held) != 1:
            raise Unsound(
                f"it holds {len(held)} arrays, none of which is called {name}",
                f"store it as {name} with numpy.savez",
            )
        (array,) = npy.read_npz(data, {name if name in held else held[0]: limits}).values()
    else:
        raise Unsound(
            "it is neither .npy nor .npz nor PNG",
            "pictures of other kinds are not read: convert them to PNG, or use numpy.save",
        )
    if array.ndim != 2:
        raise Unsound(f"it has {array.ndim} dimensions, not 2", "give rows and columns")
    return array
