"""Virtual scenes: light transport as a sum of effects, and what a camera sees of it."""

from pdcd.scene.build import DEFAULT_GRID, build_scene
from pdcd.scene.effects import Dense, Direct, Effect, LowRank, Sparse, rgb
from pdcd.scene.kernel import Kernel, gaussian
from pdcd.scene.matrix import load_matrix, matrix_effects
from pdcd.scene.milk import milk
from pdcd.scene.presets import PRESETS
from pdcd.scene.radiosity import Radiosity, Relief, radiosity
from pdcd.scene.scene import Scene

__all__ = [
    "DEFAULT_GRID",
    "PRESETS",
    "Dense",
    "Direct",
    "Effect",
    "Kernel",
    "LowRank",
    "Radiosity",
    "Relief",
    "Scene",
    "Sparse",
    "build_scene",
    "gaussian",
    "load_matrix",
    "matrix_effects",
    "milk",
    "radiosity",
    "rgb",
]
