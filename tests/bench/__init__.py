"""Speed against error: ``python -m tests.bench`` measures, prints tables, writes docs and plots.

Nothing here is a gate and nothing is remembered between runs: every figure that is written was
measured in the run that wrote it.
"""
