"""Names of the arrays that every floor computes with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""What is summed or subtracted."""
Singles = NDArray[np.float32]
"""What is large, and was rounded or counted."""
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]
Bytes = NDArray[np.uint8]
