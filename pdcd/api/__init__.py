"""pdcd from Python: benches that take photos, and runs that were taken (docs/python.md).

The public names are those of `pdcd` itself; their code lies here.
"""
