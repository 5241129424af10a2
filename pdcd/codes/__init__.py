"""Code families: binary primal and dual sequences whose outer products build a probing matrix."""

from pdcd.codes.colouring import colour_lattice
from pdcd.codes.hadamard import hadamard_fits
from pdcd.codes.make import FAMILIES, Codes, make_codes
from pdcd.codes.orders import hadamard_columns, is_order, nearest_orders
from pdcd.codes.singer import line_count

__all__ = [
    "FAMILIES",
    "Codes",
    "colour_lattice",
    "hadamard_columns",
    "hadamard_fits",
    "is_order",
    "line_count",
    "make_codes",
    "nearest_orders",
]
