"""The PTP readout: photos are waited for, read twice, and kept whole or not at all."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import msgspec
import pytest

from drivers.ptp import files
from drivers.ptp.codes import Operation
from drivers.ptp.events import ObjectAdded
from drivers.ptp.readout import PtpReadout
from drivers.ptp.transport import TransactionReply
from drivers.virtual_camera import FaultScript
from pdcd.errors import ExposureError
from pdcd.sensor.profile import load_profile
from tests.ptp_rig import PHOTO_B, SETTINGS, Calls, PtpRig, answer


def waiting(rig: PtpRig) -> ObjectAdded:
    """Expose; the photo that waits in the camera."""
    rig.expose()
    rig.wait(1.0)
    rig.camera.poll()
    return rig.camera.files.popleft()


def reads(rig: PtpRig) -> list[tuple[int, ...]]:
    """Where, and how much, is asked for of files from now on."""
    asked: list[tuple[int, ...]] = []
    transact = rig.body.transact

    def heard(code: int, parameters: tuple[int, ...] = (), data: bytes = b"") -> Any:
        if code in (Operation.GET_PARTIAL_OBJECT, Operation.EOS_GET_PARTIAL_OBJECT):
            asked.append(parameters[1:3])
        return transact(code, parameters, data)

    rig.body.transact = heard  # type: ignore[method-assign]
    return asked


@pytest.mark.parametrize("twice", [True, False])
def test_a_photo_is_read_in_blocks_of_a_mib_and_twice_unless_told(
    rig: PtpRig, tmp_path: Path, twice: bool
) -> None:
    photo = waiting(rig)
    asked = reads(rig)
    raw = files.store_photo(rig.camera, photo, tmp_path / "a.cr2", twice=twice)
    assert asked == [(0, 1 << 20), (1 << 20, PHOTO_B - (1 << 20))] * (2 if twice else 1)
    assert raw is not None and rig.is_photo_of(raw, rig.body.shutter.exposures[-1])
    assert [path.name for path in tmp_path.iterdir()] == ["a.cr2"]
    assert not rig.body.store.files  # its memory is free again


def test_every_block_of_a_photo_is_a_sign_of_life(rig: PtpRig, tmp_path: Path) -> None:
    """On a slow bus all of them take longer than the daemon's watchdog waits."""
    photo = waiting(rig)
    asked = reads(rig)
    lived: list[int] = []
    rig.job.on_look = lambda: lived.append(len(asked))
    files.store_photo(rig.camera, photo, tmp_path / "a.cr2")
    assert set(lived) == {0, 1, 2, 3, 4}


def test_a_photo_whose_session_ended_meanwhile_is_refused(rig: PtpRig, tmp_path: Path) -> None:
    photo = waiting(rig)
    order = rig.camera.order

    def renewing(code: Operation, *params: int, **more: Any) -> Any:
        rig.camera.session.renewed += 1
        return order(code, *params, **more)

    rig.camera.order = renewing  # type: ignore[method-assign]
    with pytest.raises(ExposureError, match="the connection was lost meanwhile"):
        files.store_photo(rig.camera, photo, tmp_path / "a.cr2")


def test_a_readout_says_what_the_camera_says(rig: PtpRig) -> None:
    info = rig.readout.connect()
    assert info.frame_quads is None  # a body that is not there has films of any size
    config = rig.context.config.camera
    real = PtpReadout(rig.camera, rig.clock, config)
    rig.camera.options = msgspec.structs.replace(rig.camera.options, usb="libusb")
    assert real.connect().frame_quads == load_profile(config.profile).frame_quads


# The readout.


@pytest.mark.parametrize(("exposed_s", "waits_s"), [(0.0, 30.0), (10.0, 50.0), (40.0, 60.0)])
def test_a_photo_is_waited_for_twice_its_exposure_and_half_a_minute(
    tmp_path: Path, exposed_s: float, waits_s: float
) -> None:
    rig = PtpRig(FaultScript(file="none"))
    rig.connect()
    rig.readout.arm(SETTINGS)
    rig.wait(exposed_s)
    before_ns = rig.clock.now_ns()
    with pytest.raises(ExposureError, match=rf"no photo came within {waits_s:.0f} s"):
        rig.readout.fetch(tmp_path, "shot", 60.0)
    waited_s = (rig.clock.now_ns() - before_ns) * 1e-9
    assert waits_s <= waited_s <= waits_s + 0.1
    assert rig.camera.bulb.owed  # it may still come
    rig.disconnect_quietly()


def test_a_photo_of_another_session_is_not_taken(rig: PtpRig, tmp_path: Path) -> None:
    rig.expose()
    rig.camera.renew()
    with pytest.raises(ExposureError, match="connection was lost since the camera was armed"):
        rig.readout.fetch(tmp_path, "shot", 60.0)
    assert not list(tmp_path.iterdir())


# Files.


@pytest.mark.parametrize(
    ("name", "kind", "suffix"),
    [
        ("IMG_0001.CR2", 0xB103, ".cr2"),
        ("a.Cr3", 0, ".cr3"),
        ("a.dng", 0, ".dng"),
        ("a.jpg", 0xB103, None),
        ("IMG", 0xB101, ".crw"),
        ("IMG", 0x3801, None),
    ],
)
def test_raw_files_are_known_by_their_suffix_or_their_format(
    name: str, kind: int, suffix: str | None
) -> None:
    assert files.suffix_of(ObjectAdded(1, kind, 5, name, True)) == suffix


@pytest.mark.parametrize(
    ("head", "raw"),
    [
        (b"II*\0", True),
        (b"MM\0*", True),
        (b"II\x1a\0", True),
        (b"\0\0\0\x18ftypcrx ", True),
        (b"\xff\xd8\xff\xe0", False),
        (b"\0\0\0\x18ftypheic", False),
    ],
)
def test_raw_files_are_known_by_their_first_bytes(rig: PtpRig, head: bytes, raw: bool) -> None:
    data = head.ljust(40, b"x")
    photo = ObjectAdded(7, 0xB103, 40, "a.cr2", False)
    read = Operation.GET_PARTIAL_OBJECT
    Calls(rig, {read: [answer(0x2001, data)] * 2})
    taken: list[bytes] = []
    if raw:
        found = files._copy(rig.camera, photo, lambda block: taken.append(bytes(block)))
        assert found == hashlib.sha256(data).hexdigest() and taken == [data]
    else:
        with pytest.raises(ExposureError, match="does not begin as a RAW file does"):
            files._copy(rig.camera, photo, lambda block: taken.append(bytes(block)))
        assert taken == []


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ([answer(0x2001, b"II*\0" + bytes(37))], "41 bytes came at byte 0, not 40"),
        ([answer(0x2001, b"")], "0 bytes came at byte 0, not 40"),
        ([answer(0x2002)], "refused at byte 0: 0x2002 GENERAL_ERROR"),
        ([answer(0x2001, b"II*\0" + bytes(16)), answer(0x2009)], "refused at byte 20: 0x2009"),
    ],
)
def test_what_is_not_whole_says_where_it_broke(
    rig: PtpRig, answers: list[TransactionReply], words: str
) -> None:
    Calls(rig, {Operation.GET_PARTIAL_OBJECT: answers})
    photo = ObjectAdded(7, 0xB103, 40, "a.cr2", False)
    with pytest.raises(ExposureError, match=rf"a\.cr2 of 40 bytes did not come whole: {words}"):
        files._copy(rig.camera, photo, lambda block: None)


def test_an_object_that_is_unknown_or_empty(rig: PtpRig, tmp_path: Path) -> None:
    Calls(rig, {Operation.GET_PARTIAL_OBJECT: [answer(0x2009)]})
    path = tmp_path / "a.cr2"
    unknown = ObjectAdded(7, 0xB103, 40, "a.cr2", False)
    assert files.store_photo(rig.camera, unknown, path) is None
    empty = ObjectAdded(7, 0xB103, 0, "a.cr2", False)
    with pytest.raises(ExposureError, match="it is empty"):
        files.store_photo(rig.camera, empty, path)
    assert not list(tmp_path.iterdir())


def test_a_photo_that_waits_is_thrown_away_before_the_next_exposure(rig: PtpRig) -> None:
    rig.expose()
    rig.wait(1.0)
    before_ns = rig.clock.now_ns()
    rig.readout.arm(SETTINGS)
    assert rig.clock.now_ns() - before_ns < 10**9  # it was there, and nothing is waited for
    assert not rig.body.store.files and not rig.camera.bulb.owed
