"""What a body has reported in its events: settings, their allowed values, and waiting photos."""

from __future__ import annotations

from collections import deque
from contextlib import suppress

from pdcd.driver import DeviceLost

from .codes import EosEvent, Property
from .containers import WireError
from .datasets import parse_custom_functions
from .events import AvailList, EosRecord, ObjectAdded, PlainRecord, PropValue
from .faults import DEVICE, POWER_CYCLE

_U32_B = 4
_MOST_FILES = 256
"""Most photos that may wait; an exposure makes two files at most."""
_MOST_SETTINGS = 4096
"""Most settings; bodies have some hundred."""


class Told:
    """What one camera has reported since its session began, within the limits of real cameras."""

    def __init__(self) -> None:
        self.values: dict[int, int] = {}
        self.choices: dict[int, tuple[int, ...]] = {}
        self.custom: dict[int, int] = {}
        """Custom functions by their number."""
        self.files: deque[ObjectAdded] = deque()
        """Photos that wait to be fetched, oldest first."""
        self.done: set[int] = set()
        """Handles of photos on the card that are done, even if announced again."""
        self.formats: tuple[bytes, ...] = ()

    def forget(self) -> None:
        """Forget everything, as a new session begins."""
        for known in (self.values, self.choices, self.files, self.done):
            known.clear()

    def hear(self, event: EosRecord) -> bool:
        """Record an event; returns whether it says that the camera will soon switch itself off.

        Raises DeviceLost when the camera reports without end.
        """
        if len(self.files) > _MOST_FILES or len(self.values) + len(self.choices) > _MOST_SETTINGS:
            self.forget()
            raise DeviceLost("sends events without end", device=DEVICE, hint=POWER_CYCLE)
        match event:
            case ObjectAdded():
                if event.handle not in self.done:
                    self.files.append(event)
            case PropValue(prop=Property.CUSTOM_FUNCTIONS):
                with suppress(WireError):  # bodies that pack them differently
                    self.custom = parse_custom_functions(event.data)
            case PropValue() if len(event.data) == _U32_B:
                self.values[event.prop] = event.value
            case AvailList(prop=Property.IMAGE_FORMAT):
                self.formats = event.packed
            case AvailList():
                self.choices[event.prop] = event.values
            case PlainRecord(code=EosEvent.WILL_SOON_SHUT_DOWN):
                return True
        return False
