"""All light under a pattern of your own, and the same without light that went astray."""

import numpy as np

import pdcd

with pdcd.local({"scene": {"grid": [24, 32]}}, folder="runs") as bench:
    stripes = np.indices(bench.grid)[1] // 4 % 2
    lit = bench.capture("illuminated", illumination=stripes)
    direct = bench.capture("direct", illumination=stripes, codes=32)

dark = stripes == 0
print(f"where the projector is dark: {lit.image[dark].mean():.4f} in all light")
print(f"and {direct.image[dark].mean():.4f} in direct light")
