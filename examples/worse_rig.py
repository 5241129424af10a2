"""What a slow mask does to the photo, and what of it one can see in the probing matrix."""

import pdcd

RIG = {"scene": {"grid": [24, 32]}, "mask": {"rise_s": 0.004, "fall_s": 0.008}}
for guards in ("full", "none"):
    with pdcd.local(RIG, folder="runs") as bench:
        run = bench.capture("indirect", codes=32, guards=guards, window="whole")
    kept = run.row(12, 16).realised[12, 16]
    print(f"guards {guards}: error {run.rms_error_quads:.1%}, direct light kept {kept:.3f}")
