"""What the second bucket of a sensor sees: the complement of the mask's patterns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.patterns import Patterns


def second_bucket(frames: Frames) -> Frames:
    """The same frames with the mask's patterns inverted, through the same windows.

    A sensor of two buckets gathers light that a pattern keeps out of the first one in the second.
    Where the mask is black by plan, and beside its windows, it gathers nothing in either.
    """
    patterns: Patterns
    if frames.dual_patterns.dtype == np.uint8:
        patterns = ~np.asarray(frames.dual_patterns, np.uint8)
    else:
        patterns = np.asarray(1.0 - frames.dual_patterns, np.float32)
    index = np.where(frames.dual_index == WHITE, BLACK, frames.dual_index).astype(np.int32)
    return replace(frames, dual_patterns=patterns, dual_index=index)
