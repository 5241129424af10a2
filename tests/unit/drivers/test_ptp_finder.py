"""Live view of the virtual EOS body, in order and out of it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from drivers.ptp.codes import FINDER_OFF, FINDER_PC, Operation, Property
from drivers.ptp.finder import PtpPreview, find_finder_jpeg
from drivers.virtual_camera import FaultScript, ScriptedFault
from drivers.virtual_camera.faults import WireKind
from pdcd.errors import Cancelled, ExposureError, PdcdError
from pdcd.files.images import encode_jpeg
from tests.ptp_rig import PtpRig

PICTURE = np.arange(24 * 32, dtype=np.uint8).reshape(24, 32)
LOOK = Operation.EOS_GET_VIEW_FINDER_DATA


def rig_with(*faults: ScriptedFault) -> tuple[PtpRig, PtpPreview]:
    rig = PtpRig(FaultScript(wire=faults))
    rig.body._finder = lambda: encode_jpeg(PICTURE)
    rig.connect()
    return rig, PtpPreview.create(rig.context)


def test_pictures_come_at_the_bodys_pace_and_a_photo_afterwards(tmp_path: Path) -> None:
    rig, finder = rig_with()
    finder.connect()
    assert rig.body.settings[Property.FINDER_OUTPUT] == FINDER_PC
    begun_ns = rig.clock.now_ns()
    for _ in range(30):
        picture = finder.grab(5.0)
    assert picture.shape == (24, 32, 3)
    assert np.abs(picture[..., 1].astype(int) - PICTURE).mean() < 8.0
    assert (rig.clock.now_ns() - begun_ns) * 1e-9 == pytest.approx(29 / 15, abs=0.1)
    finder.disconnect()
    assert rig.body.settings[Property.FINDER_OUTPUT] == FINDER_OFF
    assert rig.photo(tmp_path, "after").size_bytes > 0
    rig.disconnect()


@pytest.mark.parametrize(
    ("kind", "error"), [("error", ExposureError), ("unplug", PdcdError), ("deaf", PdcdError)]
)
def test_a_body_that_fails_in_it_is_told_of(kind: WireKind, error: type[PdcdError]) -> None:
    rig, finder = rig_with(ScriptedFault(kind, LOOK, first=2, times=1000))
    finder.connect()
    finder.grab(5.0)
    with pytest.raises(error):
        finder.grab(5.0)
    finder.disconnect()
    rig.disconnect_quietly()


def test_one_that_never_has_a_picture_is_given_up_and_a_cancel_is_heard() -> None:
    rig, finder = rig_with(ScriptedFault("busy", LOOK, times=10**6))
    finder.connect()
    with pytest.raises(ExposureError, match="no picture"):
        finder.grab(5.0)
    rig.job.cancelled = True
    with pytest.raises(Cancelled):
        finder.grab(5.0)
    finder.disconnect()
    assert rig.body.settings[Property.FINDER_OUTPUT] == FINDER_OFF
    rig.job.cancelled = False
    rig.disconnect()


def test_what_was_left_on_is_switched_off() -> None:
    rig = PtpRig()
    assert rig.body.settings.put(Property.FINDER_OUTPUT, struct.pack("<I", FINDER_PC))
    rig.connect()
    assert rig.body.settings[Property.FINDER_OUTPUT] == FINDER_OFF
    rig.disconnect()


def test_a_session_that_was_lost_is_gone_on_with() -> None:
    rig, finder = rig_with(ScriptedFault("lost-session", LOOK, first=3))
    finder.connect()
    for _ in range(4):
        assert finder.grab(5.0).shape == (24, 32, 3)
    finder.disconnect()
    rig.disconnect()


def block(kind: int, held: bytes) -> bytes:
    return struct.pack("<II", 8 + len(held), kind) + held


@pytest.mark.parametrize(
    ("data", "found"),
    [
        (block(3, b"abc") + block(1, b"picture") + block(7, b""), b"picture"),
        (block(11, b"picture"), b"picture"),
        (block(3, b"abc"), b""),
        (b"", b""),
        (b"\0" * 7, b""),
        (b"\0" * 4096, b""),  # lengths of nothing lead on all the same
        (struct.pack("<II", 2**32 - 1, 1) + b"cut", b"cut"),
        (struct.pack("<II", 2**32 - 1, 2) + b"cut", b""),
    ],
)
def test_the_picture_among_the_blocks(data: bytes, found: bytes) -> None:
    assert find_finder_jpeg(data) == found
