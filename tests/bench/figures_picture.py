"""The picture of docs/figures.md: ``python -m tests.bench.figures_picture DIR docs/figures.png``.

DIR is a page of `pdcd figures`. Shown are three rows of it, as they are, scaled down.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from tests.sheet import save

ROWS = ("fig-1-1", "fig-9-1", "fig-12-3")
"""Beginnings of the names of the pictures of each row."""
WIDTH_PX, GAP_PX = 1040, 8


def joined(folder: Path) -> Image.Image:
    """The rows below each other."""
    strips = []
    for begin in ROWS:
        tiles = [Image.open(path).convert("RGB") for path in sorted(folder.glob(f"{begin}[a-z]-*"))]
        if not tiles:
            raise SystemExit(f"{folder} has no {begin}*.png: make its page first")
        width = (WIDTH_PX - GAP_PX * (len(tiles) - 1)) // len(tiles)
        small = [t.resize((width, round(t.height * width / t.width))) for t in tiles]
        strip = Image.new("RGB", (WIDTH_PX, small[0].height), "white")
        for k, tile in enumerate(small):
            strip.paste(tile, (k * (width + GAP_PX), 0))
        strips.append(strip)
    height = sum(strip.height + GAP_PX for strip in strips) - GAP_PX
    whole = Image.new("RGB", (WIDTH_PX, height), "white")
    top = 0
    for strip in strips:
        whole.paste(strip, (0, top))
        top += strip.height + GAP_PX
    return whole


if __name__ == "__main__":
    save(np.asarray(joined(Path(sys.argv[1])), np.float64), Path(sys.argv[2]))
