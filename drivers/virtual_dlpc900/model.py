"""What kind of DLPC900 a virtual one is: its mirrors, its limits, and what no table specifies.

Numbers of commands, codes of errors and limits are those of TI's programmer's guide and data sheet.
Where these contradict themselves, or say nothing, there is an option.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Literal

VIRTUAL_USB_IDS = (0x0451, 0xC900)
MOST_PLAYED_ENTRIES = 400
"""Entries of the LUT of patterns."""
MOST_STORED_IMAGES = 18
PLANES_OF_STORED_IMAGE = 24
PLANES_BY_TI = (2, 0, 1)
"""Which eight planes the bytes of a pixel hold, in the order of the stream, in TI's own program."""
PLANES_BY_OTHERS = (2, 1, 0)
"""The same in all other programs."""


class DmdRegister(IntEnum):
    """Commands."""

    ERROR_CODE = 0x0100
    ERROR_TEXT = 0x0101
    POWER = 0x0200
    IDLE = 0x0201
    VERSION = 0x0205
    HARDWARE = 0x0206
    HARDWARE_STATUS = 0x1A0A
    SYSTEM_STATUS = 0x1A0B
    MAIN_STATUS = 0x1A0C
    MODE = 0x1A1B
    TRIGGER_OUT_1 = 0x1A1D
    TRIGGER_OUT_2 = 0x1A1E
    RUN = 0x1A24
    IMAGE_BEGIN = 0x1A2A
    IMAGE_DATA = 0x1A2B
    SECOND_BEGIN = 0x1A2C
    SECOND_DATA = 0x1A2D
    LUT_CONFIGURE = 0x1A31
    LUT_REORDER = 0x1A32
    LUT_DEFINE = 0x1A34
    TRIGGER_IN_1 = 0x1A35
    TRIGGER_IN_2 = 0x1A36
    LEAST_EXPOSURE = 0x1A42


class RefusalCode(IntEnum):
    """Why a command was refused."""

    NONE = 0
    DEVICE_FAILURE = 2
    UNKNOWN_COMMAND = 3
    OTHER_CONTROLLER = 4
    WRONG_MODE = 5
    PARAMETER = 6
    COMPRESSION = 9
    BIT = 10
    NOT_IN_FLASH = 11
    DARK_TIME = 12
    DELAY = 13
    EXPOSURE = 14
    NUMBER = 15
    DEFINITION = 16
    MEMORY = 17
    INTERNAL = 255


class RefusedError(Exception):
    """A command that is not done."""

    def __init__(self, code: RefusalCode, found: str = "") -> None:
        super().__init__(found or code.name.lower().replace("_", " "))
        self.code = code


@dataclass(frozen=True)
class VirtualDmdModel:
    """One kind of mirrors and its controllers.

    hardware : number that it reports of itself. dual : two controllers, one for each half.
    planes : how many its memory holds. least_exposure_us : of a plane.
    """

    name: str
    hardware: int
    size_px: tuple[int, int]
    planes: int
    dual: bool = False
    least_exposure_us: int = 105

    @property
    def half_px(self) -> tuple[int, int]:
        """Width and height of what one controller is sent."""
        width, height = self.size_px
        return (width // 2 if self.dual else width), height


DLP6500 = VirtualDmdModel("DLP6500", 1, (1920, 1080), 400)
DLP9000 = VirtualDmdModel("DLP9000", 2, (2560, 1600), 480, dual=True)


def choose_dmd_model(size_px: tuple[int, int]) -> VirtualDmdModel:
    """The model with mirrors of that size; for a size of no known model, a DLP6500 of that size,
    called unknown."""
    known = {model.size_px: model for model in (DLP6500, DLP9000)}
    return known.get(size_px, replace(DLP6500, name="unknown", hardware=0, size_px=size_px))


@dataclass(frozen=True)
class VirtualDmdTiming:
    """How one unit keeps time. The light of a pattern begins `latency_ns` late; when a trigger
    starts it, the delay varies with a standard deviation of `jitter_ns`. All times are by a crystal
    that is `crystal_ppm` too fast. A sequence begins `start_ns` after the command to start."""

    latency_ns: int = 0
    jitter_ns: int = 0
    crystal_ppm: float = 0.0
    start_ns: int = 0
    seed: int = 0


@dataclass(frozen=True)
class VirtualDmdOptions:
    """What a client cannot know beforehand.

    plane_bytes : which eight planes each byte of a pixel holds, in the order of the stream.
    trigger_2_bit : what bit 0 of byte 9 of an entry has to be for a pulse at TRIG_OUT_2.
    after_stop, after_last : what stands once a sequence was stopped, or has shown its last pattern:
        nothing, or the pattern that was there.
    keeps_images : whether images stay usable after other entries were configured; by the guide
        they do not, and entries go on showing what they last held.
    any_order : whether an image may follow one of a lower number; by the guide it may not.
    acks_spoil : a unit whose decompression fails if replies to image data are requested.
    copies : a unit that can copy pixels from the line above.
    replies_kept : how many replies wait to be fetched; older ones are gone.
    least_dark_us : shortest dark time other than zero.
    source_locked : whether the unit reports a video signal even without one.
    video_planes : colours that hold planes 0-7, 8-15 and 16-23 of a video picture.
    video_waits : what bit 7 of byte 5 of the first entry has to be in video-pattern mode: no table
        says whether the picture counts as a trigger there.
    startup : whether it shows the pattern of its flash when it is switched on, as new ones do.
    report_s : time that one report takes.
    """

    plane_bytes: tuple[int, int, int] = PLANES_BY_TI
    trigger_2_bit: Literal[0, 1] = 0
    after_stop: Literal["black", "holds"] = "black"
    after_last: Literal["black", "holds"] = "holds"
    keeps_images: bool = False
    any_order: bool = False
    acks_spoil: bool = False
    copies: bool = True
    replies_kept: int = 1
    least_dark_us: int = 0
    source_locked: bool = False
    video_planes: Literal["GRB", "GBR", "RGB", "RBG", "BRG", "BGR"] = "GRB"
    video_waits: Literal[0, 1] = 1
    startup: bool = True
    report_s: float = 0.001
    timing: VirtualDmdTiming = field(default_factory=VirtualDmdTiming)


@dataclass(frozen=True)
class VirtualDmdFault:
    """`kind` happens at the calls `first` to `first + times - 1` (from 1) of a command.

    error : refused with `code`. deaf : neither done nor answered. mute : done, not answered.
    late : answered after the next command that is answered. busy : for `seconds` the device takes
    and gives no report. unplug : the plug is pulled before it is done. reset : the device restarts
    instead of doing it. abort : done; the sequencer gives up after `patterns` patterns.
    """

    kind: Literal["error", "deaf", "mute", "late", "busy", "unplug", "reset", "abort"]
    command: int
    first: int = 1
    times: int = 1
    code: RefusalCode = RefusalCode.INTERNAL
    seconds: float = 0.0
    patterns: int = 0
