"""The promises of a camera's finder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from pdcd.bench.devices import DriverContext, Preview
from pdcd.bench.registry import load_driver
from pdcd.testing.promises import Promise
from pdcd.testing.rigs import make_rig

FINDER_SAYS = Promise(
    "`connect` says what the finder is: names and words", 'return a dict of str, {"model": "..."}'
)
FINDER_PICTURES = Promise(
    "`grab` returns a picture, (H, W) or (H, W, 3) uint8",
    "hand over bytes, grey or sRGB, upright as the sensor has it",
)
FINDER_DISCONNECT = Promise(
    "`disconnect` may be called twice, before `connect` too, and `connect` after it",
    "forget the device in `disconnect`, and do nothing where there is none",
)


class PreviewContract:
    """Each promise of `pdcd.driver.Preview`, as tests of one driver."""

    driver: ClassVar[str]
    """Its name: `preview.<driver>` is the entry point."""
    config: ClassVar[Mapping[str, Any] | Path | str] = {}
    """Tables of a configuration file, or the path of one."""
    wait_s: ClassVar[float] = 5.0
    """How long a picture may take."""

    @pytest.fixture
    def preview(self) -> Iterator[Preview]:
        """The finder that is tested, not connected; override it where `config` is not enough."""
        rig = make_rig(self.config)
        context = DriverContext(rig.config, rig.clock)
        preview: Preview = load_driver("preview", self.driver).create(context)
        yield preview
        preview.disconnect()

    def test_connect_says_what_it_is(self, preview: Preview) -> None:
        with FINDER_SAYS.keep():
            said = preview.connect()
        words = isinstance(said, dict) and all(isinstance(text, str) for text in said.values())
        FINDER_SAYS.require(words, repr(said))

    def test_pictures_are_bytes_grey_or_coloured(self, preview: Preview) -> None:
        preview.connect()
        for _ in range(2):
            with FINDER_PICTURES.keep():
                picture = preview.grab(self.wait_s)
                known = picture.dtype == np.uint8 and 0 not in picture.shape
                shaped = picture.ndim == 2 or (picture.ndim == 3 and picture.shape[2] == 3)
            FINDER_PICTURES.require(known and shaped, f"{picture.dtype} {picture.shape}")

    def test_disconnect_twice_and_connect_again(self, preview: Preview) -> None:
        with FINDER_DISCONNECT.keep():
            preview.disconnect()
            preview.connect()
            preview.disconnect()
            preview.disconnect()
            preview.connect()
