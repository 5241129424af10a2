"""Names of the arrays that every floor computes with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Arrays that are summed or subtracted."""
Singles = NDArray[np.float32]
"""Large arrays of values that were rounded or counted."""
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]
Bytes = NDArray[np.uint8]
