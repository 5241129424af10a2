"""The experiments of the paper, taken again on the virtual bench: one readable file a figure.

`pdcd.figures.figure` defines a figure, `pdcd.figures.make` makes figures, `pdcd.figures.catalog`
lists them. docs/figures.md shows the results.
"""
