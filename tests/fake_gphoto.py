"""A camera as libgphoto2 would show it, for faults that no real library plays on request."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import gphoto2 as gp


def failure(code: int) -> Exception:
    """The error that libgphoto2 raises with a code."""
    return gp.GPhoto2Error(code)  # type: ignore[no-any-return]


@dataclass
class Setting:
    """A value, and what it may be."""

    value: str | int
    choices: tuple[str, ...] = ()

    def get_value(self) -> str | int:
        return self.value

    def set_value(self, value: str | int) -> None:
        self.value = value

    def get_type(self) -> int:
        return int(gp.GP_WIDGET_RADIO if self.choices else gp.GP_WIDGET_TOGGLE)

    def count_choices(self) -> int:
        return len(self.choices)

    def get_choice(self, number: int) -> str:
        return self.choices[number]


@dataclass
class FakeCamera:
    """Settings, a queue of events and the files they speak of."""

    settings: dict[str, Setting]
    events: list[tuple[int, Any]] = field(default_factory=list)
    files: dict[str, bytes] = field(default_factory=dict)
    fetched: list[str] = field(default_factory=list)
    written: list[tuple[str, str | int]] = field(default_factory=list)
    broken: Exception | None = None
    on_bulb: Callable[[int], None] = lambda _: None
    opened: int = 0
    place: str = "usb:001,004"
    sizes: dict[str, int] = field(default_factory=dict)
    """What pictures say of their size, where that is not true."""

    def add(self, name: str, data: bytes, times: int = 1) -> None:
        """A picture, told of once or more often."""
        self.files[name] = data
        event = (gp.GP_EVENT_FILE_ADDED, SimpleNamespace(folder="/", name=name))
        self.events += [event] * times

    def init(self) -> None:
        self._fail()
        self.opened += 1

    def exit(self) -> None:
        self.opened -= 1
        self._fail()

    def get_single_config(self, name: str) -> Setting:
        self._fail()
        if name not in self.settings:
            raise failure(gp.GP_ERROR_BAD_PARAMETERS)
        found = self.settings[name]
        return Setting(found.value, found.choices)

    def set_single_config(self, name: str, widget: Setting) -> None:
        self._fail()
        self.settings[name].value = widget.value
        self.written.append((name, widget.value))
        if name == "bulb":
            self.on_bulb(int(widget.value))

    def wait_for_event(self, timeout_ms: int) -> tuple[int, Any]:
        self._fail()
        return self.events.pop(0) if self.events else (gp.GP_EVENT_TIMEOUT, None)

    def file_get_info(self, folder: str, name: str) -> Any:
        self._fail()
        size = self.sizes.get(name, len(self.files[name]))
        return SimpleNamespace(file=SimpleNamespace(size=size, fields=gp.GP_FILE_INFO_SIZE))

    def file_get(self, folder: str, name: str, kind: int, into: Any, context: Any) -> None:
        self._fail()
        self.fetched.append(name)
        into.set_data_and_size(self.files[name])

    def get_port_info(self) -> Any:
        return SimpleNamespace(get_path=lambda: self.place)

    def _fail(self) -> None:
        if self.broken is not None:
            raise self.broken
