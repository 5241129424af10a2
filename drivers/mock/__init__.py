"""The mock bench: two panels, a shutter and a camera in front of a virtual scene.

Ordinary drivers that share one `MockBench`: the panels record what they showed and when, the
shutter records when it was open, and the camera integrates the scene over both, exactly, and writes
a real DNG.
"""

from .bench import MockBench
from .camera import MockReadout
from .display import MockDisplay
from .shutter import MockShutter

__all__ = ["MockBench", "MockDisplay", "MockReadout", "MockShutter"]
