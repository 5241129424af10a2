"""The virtual camera's settings: their values, and the lists of allowed values."""

from __future__ import annotations

import struct

from ..ptp.codes import (
    APERTURE_CODES,
    CUSTOM_LONG_EXPOSURE_NR,
    DESTINATION_RAM,
    FINDER_OFF,
    FINDER_PC,
    FINDER_SCREEN,
    ISO_CODES,
    SHUTTER_BULB,
    ExposureMode,
    Property,
)
from ..ptp.datasets import pack_custom_functions
from ..ptp.events import AvailList, EosRecord, PropValue
from .faults import FaultScript
from .model import DESTINATION_CARD, RAW_FORMAT, STORAGE, CameraModel

_CARD_SHOTS = 92


class Properties:
    """Settings of one body. Raw bytes inside; numbers where they are u32."""

    def __init__(self, model: CameraModel, script: FaultScript) -> None:
        self._model = model
        self._script = script
        manual = script.dial is ExposureMode.MANUAL
        speeds = model.shutter_speeds if manual else ()  # the dial decides what can be set
        self.lists: dict[int, tuple[int, ...]] = {
            Property.APERTURE: model.apertures if manual else (),
            Property.SHUTTER_SPEED: speeds,
            Property.ISO: model.isos,
            Property.DRIVE_MODE: model.drive_modes,
            Property.CAPTURE_DESTINATION: model.destinations,
            Property.FINDER_OUTPUT: (FINDER_OFF, FINDER_SCREEN, FINDER_PC),
        }
        bulb_dial = script.dial is ExposureMode.BULB
        self._values: dict[int, int] = {
            Property.APERTURE: model.apertures[0] if model.apertures else 0,
            Property.SHUTTER_SPEED: SHUTTER_BULB[0] if bulb_dial else 0x68,  # 1/60 s
            Property.ISO: 0x48,
            Property.EXPOSURE_MODE: script.dial,
            Property.DRIVE_MODE: 0,
            Property.FOCUS_MODE: script.focus,
            Property.BATTERY: script.battery,
            Property.AUTO_POWER_OFF: 60,
            Property.AVAILABLE_SHOTS: 0 if script.buffer_full else _CARD_SHOTS,
            Property.CAPTURE_DESTINATION: DESTINATION_CARD,
            Property.CURRENT_STORAGE: STORAGE,
            Property.FINDER_OUTPUT: FINDER_OFF,
        }
        nr = 2 if script.long_exposure_nr else 0
        self._packed: dict[int, bytes] = {
            Property.IMAGE_FORMAT: RAW_FORMAT,
            Property.CUSTOM_FUNCTIONS: pack_custom_functions(
                {1: {0x0101: 0, 0x010F: 0}, 2: {CUSTOM_LONG_EXPOSURE_NR: nr, 0x0202: 0}}
            ),
        }

    def __getitem__(self, prop: int) -> int:
        return self._values[prop]

    @property
    def numbers(self) -> tuple[int, ...]:
        """All properties there are."""
        return (*self._values, *self._packed)

    def has(self, prop: int) -> bool:
        """Whether the body knows the property."""
        return prop in self._values or prop in self._packed

    def record(self, prop: int) -> EosRecord:
        """The record that reports the value of a property."""
        if prop in self._packed:
            return PropValue(prop, self._packed[prop])
        return PropValue.of(prop, self._values[prop])

    def everything(self) -> list[EosRecord]:
        """All values and all lists, as a body reports them once a session."""
        records: list[EosRecord] = [self.record(prop) for prop in self.numbers]
        records += [AvailList(prop, values) for prop, values in self.lists.items()]
        return [*records, AvailList(Property.IMAGE_FORMAT, (), self._model.image_formats)]

    def put(self, prop: int, data: bytes) -> bool:
        """Set a property as a client does; False when the value is not on offer."""
        if prop == Property.IMAGE_FORMAT:
            if data not in self._model.image_formats:
                return False
            self._packed[prop] = data
            return True
        if prop not in self.lists or len(data) != 4:
            return False
        (value,) = struct.unpack("<I", data)
        if value not in self.lists[prop]:
            return False
        self._values[prop] = value
        return True

    def count_shots(self, *, pc_has_room: bool, in_ram: int) -> bool:
        """Recount the shots that there is room for; True when the number changed."""
        if self._script.buffer_full:
            shots = 0
        elif self._values[Property.CAPTURE_DESTINATION] != DESTINATION_RAM:
            shots = _CARD_SHOTS
        else:
            shots = max(0, self._model.ram_shots - in_ram) if pc_has_room else 0
        changed = shots != self._values[Property.AVAILABLE_SHOTS]
        self._values[Property.AVAILABLE_SHOTS] = shots
        return changed

    @property
    def on_card(self) -> bool:
        """Whether files go to the card."""
        return self._values[Property.CAPTURE_DESTINATION] != DESTINATION_RAM

    @property
    def iso(self) -> int:
        """ISO in use; 100 where the camera chooses."""
        return ISO_CODES.get(self._values[Property.ISO], 0) or 100

    @property
    def f_number(self) -> float | None:
        """Aperture in use; None for a lens without contacts."""
        return APERTURE_CODES.get(self._values[Property.APERTURE])

    @property
    def bulb(self) -> bool:
        """Whether the shutter stays open while it is held."""
        return self._values[Property.SHUTTER_SPEED] in SHUTTER_BULB

    @property
    def exposure_s(self) -> float:
        """Time of a timed exposure; 0x10 is 30 s and 8 codes halve it."""
        return float(30.0 * 2.0 ** (-(self._values[Property.SHUTTER_SPEED] - 0x10) / 8.0))
