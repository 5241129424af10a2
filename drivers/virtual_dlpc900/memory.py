"""The LUT of the virtual DLPC900 and its images: what entries are, and which planes they show."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .decode import STORED_HEADER_LENGTH, BadHeaderError, DecodedWords, decode_image
from .model import (
    MOST_PLAYED_ENTRIES,
    MOST_STORED_IMAGES,
    PLANES_OF_STORED_IMAGE,
    RefusalCode,
    RefusedError,
    VirtualDmdModel,
    VirtualDmdOptions,
)
from .sequencer import PlayedEntry, PlayedPlane, PlayedProgram

_LONGEST_PIECE = 504
_STARTUP_PX = 8
_WORD = 0xFFFFFF


def parse_entry(
    data: bytes,
    model: VirtualDmdModel,
    options: VirtualDmdOptions,
    *,
    in_flash: bool,
    of_video: bool = False,
) -> tuple[int, PlayedEntry]:
    """The number of an entry and the entry, from the twelve bytes that define it.

    in_flash : images are those of the flash, which has one plane. of_video : planes are those of
    the picture on the signal, and the number of the image is ignored. Raises RefusedError.
    """
    number, low, high, kind = struct.unpack_from("<HHBB", data)
    exposure_us = low | high << 16
    dark_us, extra = int.from_bytes(data[6:9], "little"), data[9]
    where = int.from_bytes(data[10:12], "little")
    image, bit = where & 0x7FF, where >> 11
    if number >= MOST_PLAYED_ENTRIES:
        raise RefusedError(RefusalCode.NUMBER, f"entry {number} of {MOST_PLAYED_ENTRIES}")
    if exposure_us < model.least_exposure_us:
        raise RefusedError(RefusalCode.EXPOSURE, f"an exposure of {exposure_us} us")
    if kind >> 1 & 7 or extra & 2:
        raise RefusedError(RefusalCode.DEFINITION, "a pattern of several bits")
    if 0 < dark_us < options.least_dark_us:
        raise RefusedError(RefusalCode.DARK_TIME, f"a dark time of {dark_us} us")
    if bit >= PLANES_OF_STORED_IMAGE:
        raise RefusedError(RefusalCode.BIT, f"plane {bit} of {PLANES_OF_STORED_IMAGE}")
    if in_flash and (image or bit):
        raise RefusedError(RefusalCode.NOT_IN_FLASH, f"image {image} in flash")
    if of_video:
        image = 0
    elif image >= MOST_STORED_IMAGES or image * PLANES_OF_STORED_IMAGE + bit >= model.planes:
        raise RefusedError(RefusalCode.MEMORY, f"plane {bit} of image {image}")
    pulses = extra & 1 == options.trigger_2_bit
    waits, clear = bool(kind & 0x80), bool(kind & 1)
    return number, PlayedEntry(exposure_us, dark_us, clear, waits, pulses, image, bit)


@dataclass
class _Upload:
    """An image on its way to one controller."""

    index: int
    length: int
    data: bytearray = field(default_factory=bytearray)
    spoilt: bool = False


class PatternMemory:
    """Images of 24 planes, by controller, and the planes of the entries that were configured."""

    def __init__(self, model: VirtualDmdModel, options: VirtualDmdOptions) -> None:
        self._model, self._options = model, options
        width, height = model.size_px
        tiles = np.add.outer(np.arange(height) // _STARTUP_PX, np.arange(width) // _STARTUP_PX)
        self.startup = PlayedPlane(((tiles + 1) % 2 * _WORD).astype(np.uint32), 0)
        """The pattern of its flash."""
        self.white = PlayedPlane(np.ones((height, width), np.uint32), 0)
        """All mirrors on."""
        self.forget()

    def forget(self) -> None:
        """Forget all images and entries."""
        self.entries: tuple[PlayedEntry, ...] = ()
        self._definitions: dict[int, PlayedEntry] = {}
        self._order: Sequence[int] = ()
        self._most = 0
        self._images: dict[int, DecodedWords] = {}
        self._slots: dict[int, PlayedPlane] = {}
        self._uploads: list[_Upload | None] = [None, None]
        self._lowest = [MOST_STORED_IMAGES, MOST_STORED_IMAGES]

    @property
    def counts(self) -> tuple[int, int]:
        """Number of entries in the order shown, and of patterns to show."""
        return len(self._order), self._most

    def define(self, data: bytes, *, in_flash: bool, of_video: bool = False) -> None:
        """Take the definition of one entry, which has no effect before `configure`. Raises
        RefusedError."""
        number, entry = parse_entry(
            data, self._model, self._options, in_flash=in_flash, of_video=of_video
        )
        self._definitions[number] = entry

    def configure(self, count: int, most: int) -> None:
        """Put the defined entries into effect, in their order. Raises RefusedError.

        Their planes come from images loaded from now on, unless the unit keeps those it has.
        """
        if not 1 <= count <= MOST_PLAYED_ENTRIES:
            raise RefusedError(RefusalCode.NUMBER, f"{count} entries")
        if any(number not in self._definitions for number in range(count)):
            raise RefusedError(RefusalCode.DEFINITION, "an entry is not defined")
        if count != len(self.entries):
            self._slots.clear()
        self.entries = tuple(self._definitions[number] for number in range(count))
        self._order, self._most = range(count), most
        self._lowest = [MOST_STORED_IMAGES, MOST_STORED_IMAGES]
        if self._options.keeps_images:
            self._slots.clear()
            for index in self._images:
                self._fill(index)

    def reorder(self, order: Sequence[int], most: int) -> None:
        """Show entries in another order. Raises RefusedError."""
        if max(order) >= len(self.entries):
            raise RefusedError(RefusalCode.NUMBER, f"entry {max(order)}")
        self._order, self._most = order, most

    def make_program(self) -> PlayedProgram:
        """The program to show; an entry for which nothing was loaded shows the flash's pattern.
        From then on, images may again be loaded starting from the last one."""
        self._lowest = [MOST_STORED_IMAGES, MOST_STORED_IMAGES]
        numbers = range(len(self.entries))
        planes = [self._slots.get(number, self.startup) for number in numbers]
        return PlayedProgram(self.entries, self._order, planes, self._most)

    def make_video_program(self, words: DecodedWords | None) -> PlayedProgram:
        """The program for one picture on the signal, 0xRRGGBB a pixel; None: black. The first
        entry waits for the next picture, so that the last one ends with a black pattern."""
        first = replace(self.entries[0], waits=True)
        entries = (first, *(replace(entry, waits=False) for entry in self.entries[1:]))
        planes: list[PlayedPlane | None] = [None] * len(entries)
        if words is not None:
            shifts = [8 * "BGR".index(colour) for colour in self._options.video_planes]
            planes = [PlayedPlane(words, shifts[e.bit // 8] + e.bit % 8) for e in entries]
        return PlayedProgram(entries, range(len(entries)), planes, self._most)

    def begin_image(self, half: int, index: int, length: int) -> None:
        """Begin an image of `length` bytes for one controller, 0 or 1. Raises RefusedError."""
        if half and not self._model.dual:
            raise RefusedError(RefusalCode.OTHER_CONTROLLER, "there is no second controller")
        if index >= MOST_STORED_IMAGES:
            raise RefusedError(RefusalCode.MEMORY, f"image {index} of {MOST_STORED_IMAGES}")
        if not self._options.any_order and index > self._lowest[half]:
            raise RefusedError(RefusalCode.MEMORY, f"image {index} after {self._lowest[half]}")
        width, height = self._model.half_px
        if not STORED_HEADER_LENGTH < length < 2 * 3 * width * height + 1024:
            raise RefusedError(RefusalCode.PARAMETER, f"an image of {length} bytes")
        self._uploads[half] = _Upload(index, length)
        self._lowest[half] = index

    def add_data(self, half: int, piece: bytes, *, acked: bool) -> None:
        """Add the next bytes of an image; the last ones decode it. Raises RefusedError, also for a
        damaged image, of which the readable part is kept."""
        upload = self._uploads[half]
        if upload is None:
            raise RefusedError(RefusalCode.WRONG_MODE, "no image was announced")
        stated, data = int.from_bytes(piece[:2], "little"), piece[2:]
        if len(piece) < 2 or stated != len(data) or stated > _LONGEST_PIECE:
            raise RefusedError(RefusalCode.PARAMETER, f"{stated} bytes stated of {len(data)}")
        if not data:
            return  # some programs end with an empty piece
        if len(upload.data) + len(data) > upload.length:
            raise RefusedError(RefusalCode.MEMORY, f"more than the {upload.length} bytes announced")
        upload.data += data
        upload.spoilt |= acked and self._options.acks_spoil
        if len(upload.data) == upload.length:
            self._decode(half, upload)

    def _decode(self, half: int, upload: _Upload) -> None:
        try:
            image = decode_image(bytes(upload.data), self._model.half_px, self._options.copies)
        except BadHeaderError as bad:
            code = RefusalCode.COMPRESSION if bad.compression else RefusalCode.PARAMETER
            raise RefusedError(code, str(bad)) from None
        words = image.words
        if upload.spoilt:
            words[len(words) // 2 :] = 0
        if self._model.dual:
            width = self._model.half_px[0]
            whole = self._images.get(upload.index)
            whole = (
                np.zeros(self._model.size_px[::-1], np.uint32) if whole is None else whole.copy()
            )
            whole[:, half * width : (half + 1) * width] = words
            words = whole
        self._images[upload.index] = words
        self._fill(upload.index)
        if image.fault:
            raise RefusedError(RefusalCode.INTERNAL, image.fault)

    def _fill(self, index: int) -> None:
        """Give the entries that show an image their planes."""
        words = self._images[index]
        for number, entry in enumerate(self.entries):
            if entry.image == index:
                group, place = divmod(entry.bit, 8)
                byte = self._options.plane_bytes.index(group)
                self._slots[number] = PlayedPlane(words, 8 * (2 - byte) + place)
