"""A machine-vision camera that is not there: GigE Vision on this machine, by Aravis' simulator.

`description` is what it reports of itself, `simulator` the library's part, `camera` its exposures,
`bench` the drivers `virtual-genicam`, whose camera sees the mock bench.
"""
