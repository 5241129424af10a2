"""The experiments of the paper, taken again on the virtual bench: one readable file a figure.

`pdcd.figures.figure` says what a figure is, `pdcd.figures.make` makes them, `pdcd.figures.catalog`
lists them. docs/figures.md shows what comes out.
"""
