"""The binary pairs of projector and mask whose outer products build a probing matrix: families,
how cells that are near or linked are kept apart, and which numbers of codes there are.
"""
