"""The preview of a camera of libgphoto2."""

from __future__ import annotations

import pytest

pytest.importorskip("gphoto2", reason="gphoto2 IS MISSING: see .venv/gphoto2.log")

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gphoto2 as gp
import numpy as np

from drivers.gphoto.finder import GphotoPreview
from pdcd.errors import Cancelled, DeviceLost, ExposureError
from pdcd.files.images import encode_jpeg
from tests.fake_gphoto import Setting, failure
from tests.gphoto_bench import Bench

GREY = encode_jpeg(np.full((24, 32, 3), 100, np.uint8))


def test_pictures_come_and_the_mirror_comes_down(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bench = Bench(monkeypatch, tmp_path)
    camera: Any = bench.camera
    sent = [GREY]
    camera.capture_preview = lambda: SimpleNamespace(get_data_and_size=lambda: sent[0])
    camera.settings["viewfinder"] = Setting(1)
    finder = GphotoPreview(bench.session)
    bench.readout.connect()
    finder.connect()
    assert np.abs(finder.grab(5.0).astype(int) - 100).max() <= 2
    sent[0] = b"no picture"
    with pytest.raises(ExposureError, match="no JPEG"):
        finder.grab(5.0)
    bench.cancelled = True
    with pytest.raises(Cancelled):
        finder.grab(5.0)
    finder.disconnect()
    assert camera.settings["viewfinder"].value == 0 and camera.opened == 1  # the readout has it
    bench.cancelled = False
    bench.readout.disconnect()
    assert camera.opened == 0


def test_a_camera_that_is_lost_is_told_of(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bench = Bench(monkeypatch, tmp_path)
    camera: Any = bench.camera

    def lost() -> None:
        raise failure(gp.GP_ERROR_IO_USB_FIND)

    camera.capture_preview = lost
    finder = GphotoPreview(bench.session)
    finder.connect()
    with pytest.raises(DeviceLost, match="finder"):
        finder.grab(5.0)
    finder.disconnect()
    finder.disconnect()
