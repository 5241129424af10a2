"""The video input of the virtual DLPC900: whether there is a signal, and what its pictures show.

In video mode a picture lights every pixel whose level is not zero. In video-pattern mode its 24
bits are shown as the LUT says, from the LUT's beginning. A LUT that takes longer than a picture,
its black pattern included, is refused when it is configured; no table says anything about that.
"""

from __future__ import annotations

import numpy as np

from .decode import DecodedWords
from .memory import PatternMemory
from .model import RefusalCode, RefusedError, VirtualDmdModel, VirtualDmdOptions
from .sequencer import DmdSequencer, PlayedPlane


class VideoInput:
    """The video input of one device. Shows the entries of `memory` through `sequencer`."""

    def __init__(
        self,
        model: VirtualDmdModel,
        options: VirtualDmdOptions,
        memory: PatternMemory,
        sequencer: DmdSequencer,
    ) -> None:
        self._model, self._options = model, options
        self._memory, self._sequencer = memory, sequencer
        self._picture_us: float | None = None

    @property
    def locked(self) -> bool:
        """Whether there is a signal."""
        return self._options.source_locked or self._picture_us is not None

    def connect(self, refresh_hz: float) -> None:
        """Begin a signal of `refresh_hz` pictures a second."""
        self._picture_us = 1e6 / refresh_hz

    def disconnect(self, at_ns: int, *, of_patterns: bool) -> None:
        """End the signal. of_patterns : in video-pattern mode."""
        self._picture_us = None
        if of_patterns:
            self._sequencer.lose_picture(at_ns)

    def check_lut(self) -> None:
        """Refuse, and forget, entries that cannot show the signal's pictures. Without a signal, all
        entries are accepted."""
        if self._picture_us is None:
            return
        first, *others = self._memory.entries
        lasts_us = self._memory.make_video_program(None).start_us(1 + len(others))
        wrong = None
        if first.waits != bool(self._options.video_waits) or any(one.waits for one in others):
            wrong = RefusalCode.DEFINITION, "entries that wait for another trigger than a picture"
        elif lasts_us > self._picture_us:
            wrong = RefusalCode.EXPOSURE, f"{lasts_us} us of a picture of {self._picture_us:.0f} us"
        if wrong is not None:
            self._memory.forget()
            raise RefusedError(*wrong)

    def show(self, words: DecodedWords, at_ns: int, *, of_patterns: bool) -> None:
        """Begin a picture, (height, width) of 0xRRGGBB, which lasts one refresh. Raises ValueError
        if its size is not that of the mirrors."""
        if words.shape != self._model.size_px[::-1]:
            raise ValueError(f"a picture of {words.shape} for mirrors of {self._model.size_px}")
        if self._picture_us is None:
            return
        if not of_patterns:
            lit = (words & 0xFFFFFF != 0).astype(np.uint32)
            self._sequencer.hold(at_ns, PlayedPlane(lit, 0) if lit.any() else None)
        elif self._memory.entries:
            self._sequencer.show_picture(at_ns, self._memory.make_video_program(words))
