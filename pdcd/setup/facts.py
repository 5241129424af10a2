"""What was found on a machine that may become a bench, and what the user chose."""

from __future__ import annotations

from dataclasses import dataclass

from pdcd.presenter.outputs import Output

VIRTUAL, MOCK = "virtual", "none"
"""Cameras that can always be chosen: a virtual EOS 450D, and the mock camera."""
OWN_RELEASE = "camera"
"""The shutter is opened by the camera itself."""


@dataclass(frozen=True)
class CameraFact:
    """A camera: its driver, the key it is chosen by ("04a9:3145", a serial number, an address),
    what it is in words, and its sensor profile."""

    driver: str
    key: str
    words: str
    profile: str = "modern"


@dataclass(frozen=True)
class PortFact:
    """A serial port: its path, and the serial number of its adapter, "" where it has none."""

    path: str
    serial: str = ""


@dataclass(frozen=True)
class BenchFacts:
    """Everything that was found.

    outputs : connected ones, in the order in which they lie on the screen. server : an X server
        with nothing but these on it, to be used as it is; None: there is none yet. card : whether
        the machine has a graphics card. notes : what could not be examined, and why.
    """

    outputs: tuple[Output, ...] = ()
    server: str | None = None
    card: bool = True
    cameras: tuple[CameraFact, ...] = ()
    ports: tuple[PortFact, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class BenchChoices:
    """What the user chose, or else what is proposed.

    projector, mask : names of outputs; "" where there are not two. camera : key of one that was
    found, or `VIRTUAL`, or `MOCK`. release : path of a serial port, or `OWN_RELEASE`. open_hex,
    close_hex : commands for a box on that port; "" where a line of the port is held instead.
    f_number : of a lens that is set by hand.
    """

    projector: str = ""
    mask: str = ""
    camera: str = MOCK
    release: str = OWN_RELEASE
    line: str = "rts"
    open_hex: str = ""
    close_hex: str = ""
    f_number: float | None = None
