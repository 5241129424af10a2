"""pdcd from Python: benches that take photos, and runs that were taken (docs/python.md).

The public names are those of `pdcd` itself; what lies here is where they are at home.
"""
