"""A bulb release on a serial port: a modem line with an optocoupler, or a box that takes bytes."""

from .shutter import SerialShutter

__all__ = ["SerialShutter"]
