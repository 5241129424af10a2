"""A scene made of numbers: a matte wall in an even haze, and what of it is indirect."""

import numpy as np

import pdcd

cells = 12 * 16
np.savez("haze.npz", transport=0.6 * np.eye(cells) + 0.2 / cells, grid=[12, 16])
with pdcd.local({"scene": {"kind": "matrix", "path": "haze.npz"}}, folder="runs") as bench:
    run = bench.capture("indirect", codes=32)

print(f"indirect light {run.image.mean():.4f}, in truth {0.2 * (cells - 1) / cells:.4f}")
