"""Sixteen exposures with codes of their own: their spread measures the error of the photo."""

import pdcd

with pdcd.local({"scene": {"grid": [24, 32]}}, folder="runs") as bench:
    run = bench.capture("indirect", codes=128, parts=16)

for parts in (4, 8, 16):
    again = run.decode(parts=parts, progress=False)
    print(f"{parts} parts: sigma {again.rms_sigma:.2%}, {again.sigma_kind}")
