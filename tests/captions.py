"""The strip below a drawn picture."""

from __future__ import annotations

from pdcd.pictures.written.picture_files import CAPTION_SHARES


def caption_height(width_px: float) -> int:
    """Rows of pixels of the strip below a picture of that width."""
    return round(CAPTION_SHARES[0] * width_px)
