"""Error over the number of codes of one exposure, two families, as a table for a spreadsheet."""

import pdcd

requests = [
    {"goal": "indirect", "codes": codes, "family": family, "parts": 1, "pilot": 0}
    for family in ("bernoulli", "hadamard")
    for codes in (8, 32, 128)
]
table = pdcd.sweep({"scene": {"grid": [24, 32]}}, requests, folder="sweep")
table.to_csv("error-over-codes.csv")
for row in table:
    print(f"{row['family']:10} {row['codes']:4} codes: {row['rms_error_quads']:.2%}")
