"""One photo of indirect light on the mock bench; what it is, and how far to trust it."""

import pdcd

with pdcd.local({"scene": {"kind": "wax-disk", "grid": [24, 32]}}, folder="runs") as bench:
    run = bench.capture("indirect", codes=32)

print(run.verdict, *run.warnings, sep="; ")
print(f"error {run.rms_error_quads:.1%}, sigma {run.rms_sigma:.1%}")
print("to look at:", run.folder / "preview" / "indirect.png")
