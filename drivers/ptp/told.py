"""What a body has told in its events: settings, what they may be, and the photos that wait."""

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
"""Photos that wait: an exposure makes two files at most."""
_MOST_SETTINGS = 4096
"""Bodies have some hundred."""


class Told:
    """What one camera has told since its session began, no more than a camera can have to tell."""

    def __init__(self) -> None:
        self.values: dict[int, int] = {}
        self.choices: dict[int, tuple[int, ...]] = {}
        self.custom: dict[int, int] = {}
        """Custom functions by their number."""
        self.files: deque[ObjectAdded] = deque()
        """Photos that wait to be fetched, oldest first."""
        self.done: set[int] = set()
        """Handles on the card, which stay good when announced twice."""
        self.formats: tuple[bytes, ...] = ()

    def forget(self) -> None:
        """A new session begins."""
        for known in (self.values, self.choices, self.files, self.done):
            known.clear()

    def hear(self, event: EosRecord) -> bool:
        """Take note of an event; whether it is that the camera will soon switch itself off.

        Raises DeviceLost when there is no end to what it tells.
        """
        if len(self.files) > _MOST_FILES or len(self.values) + len(self.choices) > _MOST_SETTINGS:
            self.forget()
            raise DeviceLost("sends events without end", device=DEVICE, hint=POWER_CYCLE)
        match event:
            case ObjectAdded():
                if event.handle not in self.done:
                    self.files.append(event)
            case PropValue(prop=Property.CUSTOM_FUNCTIONS):
                with suppress(WireError):  # only bodies that pack them otherwise
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
