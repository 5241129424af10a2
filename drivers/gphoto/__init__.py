"""Cameras that libgphoto2 knows: shutter and readout, by the extra "gphoto2"."""

from .camera import GphotoReadout, GphotoShutter

__all__ = ["GphotoReadout", "GphotoShutter"]
