"""What is found on the machine of a bench, for tests of what is proposed."""

from __future__ import annotations

from typing import Any

from pdcd.presenter.edid import Edid
from pdcd.presenter.outputs import Output
from pdcd.presenter.timings import VideoTiming
from pdcd.setup.facts import BenchFacts, CameraFact, PortFact

FULL_HD = VideoTiming(148_500, (1920, 2008, 2052, 2200), (1080, 1084, 1089, 1125))
UXGA = VideoTiming(162_000, (1600, 1664, 1856, 2160), (1200, 1201, 1204, 1250))
LAPTOP = Output("eDP-1", True, timings=(FULL_HD,))
BEAMER = Output("HDMI-1", True, edid=Edid("EPS", 1, 0, "EPSON PJ", "X4K7"), timings=(FULL_HD, UXGA))
LCD = Output("DP-1", True, edid=Edid("SHP", 2, 77, "LM201U05"), timings=(UXGA,))
EOS = CameraFact("ptp", "04a9:3145", "Canon on bus 1", "450d")
OTHER_EOS = CameraFact("ptp", "04a9:3199", "Canon on bus 2")
VISION = CameraFact("genicam", "S123", "Maker model, serial S123 (GigEVision)")
ADAPTER = PortFact("/dev/serial/by-id/usb-FTDI-A50285BI", "A50285BI")
BOARD = PortFact("/dev/ttyS0")


def bare(**more: Any) -> BenchFacts:
    """Two panels on a server that shows nothing else."""
    outputs = (
        Output("DUMMY1", True, 0, 0, 1920, 1080, "a", 60.0),
        Output("DUMMY0", True, 1920, 0, 1600, 1200, "b", 60.00004),
    )
    return BenchFacts(**{"outputs": outputs, "server": ":9", "card": True, **more})


def desk(**more: Any) -> BenchFacts:
    """A laptop with a desktop, and both panels plugged in."""
    return BenchFacts(**{"outputs": (LAPTOP, LCD, BEAMER), **more})
