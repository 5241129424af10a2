"""pdcd: a projector, an LCD mask and a camera that photograph chosen light paths."""

__version__ = "0.1.0"
