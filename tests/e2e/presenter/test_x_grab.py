"""Grabbed pixels against what was drawn and what xwd and ImageMagick read."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from Xlib import X

from pdcd.errors import ConfigError, DeviceLost
from pdcd.presenter.xconnection import close_x_connection, open_x_connection
from pdcd.presenter.xgrab import Pixels, RootGrabber
from tests.tools import needs, program
from tests.xserver import QUARTER, XServer, run


@pytest.fixture(params=["dummy", "xvfb"])
def server(request: pytest.FixtureRequest) -> Iterator[XServer]:
    # An odd width: a row padded to more than four bytes would shear the picture.
    with run((QUARTER[0][0] + 1, 192), QUARTER[1], kinds=(request.param,)) as server:
        yield server


@pytest.fixture
def grabber(server: XServer) -> Iterator[RootGrabber]:
    grabber = RootGrabber(server.display)
    yield grabber
    grabber.close()


@pytest.fixture
def display(server: XServer) -> Iterator[Any]:
    display = open_x_connection(server.display)
    yield display
    close_x_connection(display)


def draw(display: Any, pixels: Pixels) -> Any:
    """Show (H, W, 3) at the origin, in a window, by PutImage in strips; returns the window."""
    height, width = pixels.shape[:2]
    window = display.screen().root.create_window(
        0, 0, width, height, 0, 24, X.InputOutput, X.CopyFromParent, override_redirect=1
    )
    window.map()
    context = window.create_gc()
    bgrx = np.zeros((height, width, 4), dtype=np.uint8)
    bgrx[..., 2::-1] = pixels
    for top in range(0, height, 16):
        strip = bgrx[top : top + 16]
        window.put_image(context, 0, top, width, strip.shape[0], X.ZPixmap, 24, 0, strip.tobytes())
    display.sync()
    return window


def picture(width: int, height: int) -> Pixels:
    return np.random.default_rng(0).integers(0, 256, (height, width, 3)).astype(np.uint8)


def test_an_untouched_screen_is_black(grabber: RootGrabber, server: XServer) -> None:
    grabbed = grabber.grab()
    assert grabbed.shape == (server.size_px[1], server.size_px[0], 3)
    assert not grabbed.any()


def test_what_was_drawn_is_grabbed(grabber: RootGrabber, display: Any, server: XServer) -> None:
    drawn = picture(*server.size_px)
    draw(display, drawn)
    np.testing.assert_array_equal(grabber.grab(), drawn)


@needs("xwd", "imagemagick")
def test_xwd_and_imagemagick_read_the_same(
    grabber: RootGrabber, display: Any, server: XServer, tmp_path: Path
) -> None:
    draw(display, picture(*server.size_px))
    dump, raw = tmp_path / "root.xwd", tmp_path / "root.rgb"
    subprocess.run([program("xwd"), "-root", "-silent", "-out", dump], env=server.env(), check=True)
    convert = [program("imagemagick"), f"xwd:{dump}", "-depth", "8", f"rgb:{raw}"]
    subprocess.run(convert, check=True)
    theirs = np.fromfile(raw, dtype=np.uint8).reshape(grabber.grab().shape)
    np.testing.assert_array_equal(grabber.grab(), theirs)


def test_a_window_that_goes_leaves_black(
    grabber: RootGrabber, display: Any, server: XServer
) -> None:
    draw(display, picture(*server.size_px)).destroy()
    display.sync()
    assert not grabber.grab().any()


def test_a_server_that_dies_is_lost(server: XServer, grabber: RootGrabber) -> None:
    os.kill(server.pid, signal.SIGKILL)
    with pytest.raises(DeviceLost, match="does not answer"):
        for _ in range(100):
            grabber.grab()


def test_a_closed_grabber_says_so(grabber: RootGrabber) -> None:
    grabber.close()
    grabber.close()
    with pytest.raises(DeviceLost, match="closed"):
        grabber.grab()


def test_a_screen_of_another_depth_is_refused() -> None:
    with (
        run(kinds=("xvfb",), more=("-screen", "0", "64x64x16")) as server,
        pytest.raises(ConfigError, match="another form"),
    ):
        RootGrabber(server.display)
