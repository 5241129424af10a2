"""The binary pairs of projector and mask whose outer products build a probing matrix: families, how
near or linked cells are kept apart, and which numbers of codes there are.
"""
