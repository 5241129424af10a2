"""DMD controllers that are not there: DLPC900s as seen over USB, down to the bytes.

`VirtualDlpc900` is one of them, `VirtualDmdBus` puts several on a pyusb backend, `make_bench_bus`
has two in front of the mock bench. `VirtualDmdFault` says what goes wrong.
"""

from __future__ import annotations

from pdcd.driver import DriverContext

from .bench import MASK_SERIAL, PROJECTOR_SERIAL, DmdPanels, make_bench_bus
from .controller import VirtualDlpc900
from .decode import BadHeaderError, DecodedImage, decode_image
from .model import (
    DLP6500,
    DLP9000,
    PLANES_BY_OTHERS,
    PLANES_BY_TI,
    DmdRegister,
    RefusalCode,
    VirtualDmdFault,
    VirtualDmdModel,
    VirtualDmdOptions,
    VirtualDmdTiming,
    choose_dmd_model,
)
from .usb_bus import VirtualDmdBus

__all__ = [
    "DLP6500",
    "DLP9000",
    "MASK_SERIAL",
    "PLANES_BY_OTHERS",
    "PLANES_BY_TI",
    "PROJECTOR_SERIAL",
    "BadHeaderError",
    "BenchDmdUsb",
    "DecodedImage",
    "DmdPanels",
    "DmdRegister",
    "RefusalCode",
    "VirtualDlpc900",
    "VirtualDmdBus",
    "VirtualDmdFault",
    "VirtualDmdModel",
    "VirtualDmdOptions",
    "VirtualDmdTiming",
    "choose_dmd_model",
    "decode_image",
    "make_bench_bus",
]


class BenchDmdUsb:
    """The USB called "virtual-dlpc900": projector and mask of the mock bench are on it."""

    maturity = "experimental"

    @classmethod
    def create(cls, context: DriverContext) -> VirtualDmdBus[VirtualDlpc900]:
        """`make_bench_bus` of the rig. Raises ConfigError for a bench that cannot be."""
        return make_bench_bus(context)
