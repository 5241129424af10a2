"""`python -m tests.fake_drm_presenter FD`: the display process over a fake kernel's vblanks.

The windows are real, on a dummy X server; that and the fake kernel know nothing of each other, so
this shows that the process runs by the counters, and nothing of what a screen would show.
"""

from __future__ import annotations

import os
import sys

from tests.fake_drm import Connector, Crtc, FakeKernel
from tests.xserver import QUARTER

PROJECTOR, MASK = 301, 302
"""The kernel's numbers of both connectors; more than a byte."""
LAG_NS = 5_000_000


def kernel() -> FakeKernel:
    """A card whose connectors have the modes of a small dummy server."""
    projector = Connector(PROJECTOR, Crtc(41, QUARTER[0]))
    mask = Connector(MASK, Crtc(45, QUARTER[1], first_ns=LAG_NS))
    return FakeKernel({"/dev/dri/card0": [projector, mask]}, real_time=True)


if __name__ == "__main__":
    os.environ["PYGLFW_LIBRARY_VARIANT"] = "x11"
    from pdcd.presenter import drm
    from pdcd.presenter.process import main

    drm.LINUX = kernel()  # type: ignore[assignment]
    raise SystemExit(main(int(sys.argv[1])))
