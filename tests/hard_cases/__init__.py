"""Cases that are hard for arithmetic, shared by tests and bench; `ALL` has them in order."""

from tests.hard_cases import captures, differences, matrices, panels, scenes, sums

ALL = (
    *differences.CASES,
    *sums.CASES,
    *panels.CASES,
    *scenes.CASES,
    *matrices.CASES,
    *captures.CASES,
)
