"""`pdcd.driver`, the door for authors of drivers: what is there stays there."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

import pdcd.driver

PROMISED = """
    CameraInfo CameraSettings DisplayInfo DriverContext RawFile Display Shutter Readout Frames
    FrameLog BLACK WHITE draw draw_planes panels_of play_all streams responsivity_e read_options
    write_dng Finding Clock
    PdcdError ConfigError DriverUnavailable DeviceLost SyncError ExposureError DecodeError
    NoSpaceError DiskError Cancelled
""".split()
"""What drivers of other packages rely on: none of these may go, or be called otherwise."""


@pytest.mark.parametrize("name", PROMISED)
def test_every_name_that_was_promised_is_there(name: str) -> None:
    assert name in pdcd.driver.__all__
    assert getattr(pdcd.driver, name) is not None


def test_every_name_is_at_home_somewhere_and_in_the_table_of_contents() -> None:
    homes = [name for names in pdcd.driver._ROOMS.values() for name in names]
    assert sorted(homes) == sorted(pdcd.driver.__all__)
    assert pdcd.driver.__doc__ is not None
    told = re.findall(r"`(\w+)`", pdcd.driver.__doc__)
    assert set(homes) <= set(told)
    for name in homes:
        assert getattr(pdcd.driver, name) is not None
    assert set(pdcd.driver.__all__) <= set(dir(pdcd.driver))


def test_a_name_that_is_not_there() -> None:
    with pytest.raises(AttributeError, match="nothing_of_the_kind"):
        pdcd.driver.nothing_of_the_kind  # type: ignore[attr-defined]  # noqa: B018


def test_errors_and_protocols_do_not_load_what_reads_photos() -> None:
    """A process that guards a shutter is there in no time."""
    code = (
        "import sys; from pdcd.driver import DeviceLost, PdcdError; "
        "print([m for m in ('numpy', 'rawpy', 'cv2', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
