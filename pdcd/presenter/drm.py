"""The kernel's own vblank counters of projector and mask, read beside the X server.

An X output is found among the kernel's connectors by the number that the X driver publishes
(CONNECTOR_ID, xf86-video-modesetting), by the panel's EDID, or by both; never by its name, which X
and the kernel spell differently. Its mode must have the output's size. Never run on a real card.
"""

from __future__ import annotations

import ctypes
import struct
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

from pdcd.errors import ConfigError, DeviceLost
from pdcd.presenter import drm_calls
from pdcd.presenter.drm_calls import Kernel
from pdcd.presenter.edid import Edid, parse_edid
from pdcd.presenter.outputs import Output, Size

LINUX = drm_calls.Linux()
PERMISSION_HINT = (
    "be in the group video: SupplementaryGroups= of pdcd.service, or usermod -aG video USER"
)


@dataclass(frozen=True)
class Route:
    """A connector that shows something, and the CRTC that feeds it, by the kernel's numbers."""

    node: str
    connector: int
    crtc: int
    size: Size
    edid: Edid | None = None

    def __str__(self) -> str:
        return f"{self.node}, CRTC {self.crtc}"

    def leads_to(self, output: Output) -> bool:
        """Whether this is the X server's output for certain."""
        if self.size != output.size or output.connector not in (None, self.connector):
            return False
        if self.edid is not None and output.edid is not None:
            return self.edid == output.edid
        return output.connector is not None


class Counter:
    """Vblanks of one CRTC, on a descriptor of its own.

    Asked like `PresentEvents`: after `wait` returns True, `ns` and `msc` are those of the vblank.

    Raises ConfigError when the kernel does not count this CRTC's vblanks.
    """

    def __init__(self, kernel: Kernel, route: Route) -> None:
        self.route = route
        self._kernel = kernel
        self._serial = 0
        self.ns = self.msc = 0
        last = drm_calls.GetSequence(crtc_id=route.crtc)
        try:
            self._fd = _open(kernel, route.node)
            try:
                kernel.call(self._fd, drm_calls.GET_SEQUENCE, last)
            except OSError:
                self.close()
                raise
        except OSError as err:
            raise _unusable(f"{route} counts no vblanks: {err.strerror}", err) from err
        if not last.active:
            self.close()
            raise _unusable(f"{route} is switched off")

    def ask(self, msc: int) -> None:
        """Ask for an event at vblank `msc`, at once when that has passed; 0 is always at once.

        Raises DeviceLost when the card is gone or the CRTC is switched off.
        """
        self._serial += 1
        # An absolute number that passed more than 2**23 vblanks ago counts as still to come.
        flags = 0 if msc else drm_calls.RELATIVE
        wish = drm_calls.QueueSequence(self.route.crtc, flags, msc, self._serial)
        try:
            self._kernel.call(self._fd, drm_calls.QUEUE_SEQUENCE, wish)
        except OSError as err:
            raise self._lost(err) from err

    def wait(self, kind: int, timeout_s: float) -> bool:
        """Take the event last asked for; False when it does not come in time.

        `kind` is of no use here, where all events are vblanks. Raises DeviceLost.
        """
        deadline_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        while True:
            left_s = (deadline_ns - time.monotonic_ns()) * 1e-9
            try:
                data = self._kernel.read(self._fd, max(0.0, left_s))
            except OSError as err:
                raise self._lost(err) from err
            for event in _events(data):
                if event.user_data == self._serial:  # others were given up before
                    self.ns, self.msc = event.time_ns, event.sequence
                    return True
            if left_s <= 0.0:
                return False

    def close(self) -> None:
        """Release the descriptor."""
        if self._fd >= 0:
            self._kernel.close(self._fd)
            self._fd = -1

    def _lost(self, err: OSError) -> DeviceLost:
        return DeviceLost(
            f"the kernel counts no more vblanks of {self.route}: {err.strerror}",
            device="display",
            hint="was the panel unplugged, or switched off?",
        )


Counters = tuple[Counter, Counter]
"""Those of projector and mask."""


def find(outputs: tuple[Output, Output], kernel: Kernel | None = None) -> Counters:
    """Counters of projector and mask.

    Raises ConfigError when there is no card, none may be opened, or it cannot be told for certain
    which of the kernel's CRTCs feeds an output.
    """
    kernel = kernel or LINUX
    nodes = kernel.nodes()
    if not nodes:
        raise _unusable(f"the kernel drives no graphics card: no card in {drm_calls.FOLDER}")
    routes: list[Route] = []
    failures: list[OSError] = []
    for node in nodes:
        try:
            routes += read_routes(kernel, node)
        except OSError as err:
            err.filename = node
            failures.append(err)
    first, second = (_route_to(output, routes, failures) for output in outputs)
    if (first.node, first.crtc) == (second.node, second.crtc):
        raise _unusable(f"both panels are fed by one CRTC: {first}")
    projector = Counter(kernel, first)
    try:
        return projector, Counter(kernel, second)
    except ConfigError:
        projector.close()
        raise


def read_routes(kernel: Kernel, node: str) -> list[Route]:
    """All connectors of a card that show something. Raises OSError."""
    fd = _open(kernel, node)
    try:
        found = []
        for connector in _connectors(kernel, fd):
            with suppress(FileNotFoundError):  # it has just gone
                route = _route(kernel, fd, node, connector)
                found += [] if route is None else [route]
        return found
    finally:
        kernel.close(fd)


def _open(kernel: Kernel, node: str) -> int:
    fd = kernel.open(node)
    # Whoever opens a card that nobody is master of becomes its master, and X could not any more.
    with suppress(OSError):
        kernel.call(fd, drm_calls.DROP_MASTER)
    return fd


def _connectors(kernel: Kernel, fd: int) -> list[int]:
    count = drm_calls.GetResources()
    kernel.call(fd, drm_calls.GET_RESOURCES, count)
    numbers = (ctypes.c_uint32 * count.count_connectors)()
    answer = drm_calls.GetResources(
        connector_id_ptr=ctypes.addressof(numbers), count_connectors=len(numbers)
    )
    kernel.call(fd, drm_calls.GET_RESOURCES, answer)
    return list(numbers[: answer.count_connectors])


def _route(kernel: Kernel, fd: int, node: str, connector: int) -> Route | None:
    """What feeds a connector; None when it shows nothing."""
    encoder = drm_calls.GetEncoder(encoder_id=_ask(kernel, fd, connector).encoder_id)
    if not encoder.encoder_id:
        return None
    kernel.call(fd, drm_calls.GET_ENCODER, encoder)
    if not encoder.crtc_id:
        return None
    crtc = drm_calls.GetCrtc(crtc_id=encoder.crtc_id)
    kernel.call(fd, drm_calls.GET_CRTC, crtc)
    if not crtc.mode_valid:
        return None
    size = crtc.mode.hdisplay, crtc.mode.vdisplay
    return Route(node, connector, crtc.crtc_id, size, _edid(kernel, fd, connector))


def _ask(kernel: Kernel, fd: int, connector: int, **room: int) -> drm_calls.GetConnector:
    # With no room for modes the kernel may look for a panel anew, which takes long.
    mode = drm_calls.ModeInfo()
    answer = drm_calls.GetConnector(
        connector_id=connector, modes_ptr=ctypes.addressof(mode), count_modes=1, **room
    )
    kernel.call(fd, drm_calls.GET_CONNECTOR, answer)
    return answer


def _edid(kernel: Kernel, fd: int, connector: int) -> Edid | None:
    """EDID of the panel at a connector; None when there is none, or a damaged one."""
    count = _ask(kernel, fd, connector).count_props
    numbers, values = (ctypes.c_uint32 * count)(), (ctypes.c_uint64 * count)()
    answer = _ask(
        kernel,
        fd,
        connector,
        props_ptr=ctypes.addressof(numbers),
        prop_values_ptr=ctypes.addressof(values),
        count_props=count,
    )
    known = min(count, answer.count_props)
    for number, value in zip(numbers[:known], values[:known], strict=True):
        found = drm_calls.GetProperty(prop_id=number)
        kernel.call(fd, drm_calls.GET_PROPERTY, found)
        if found.name == b"EDID" and value:
            return parse_edid(_blob(kernel, fd, value))
    return None


def _blob(kernel: Kernel, fd: int, number: int) -> bytes:
    size = drm_calls.GetBlob(blob_id=number)
    kernel.call(fd, drm_calls.GET_BLOB, size)
    data = (ctypes.c_uint8 * size.length)()
    answer = drm_calls.GetBlob(number, size.length, ctypes.addressof(data))
    kernel.call(fd, drm_calls.GET_BLOB, answer)
    return bytes(data)


def _events(data: bytes) -> Iterator[drm_calls.SequenceEvent]:
    """The vblanks among some events."""
    at, size = 0, ctypes.sizeof(drm_calls.SequenceEvent)
    while at + drm_calls.EVENT_HEADER <= len(data):
        kind, length = struct.unpack_from("=II", data, at)
        if kind == drm_calls.SEQUENCE_EVENT and at + size <= len(data):
            yield drm_calls.SequenceEvent.from_buffer_copy(data, at)
        at += max(length, drm_calls.EVENT_HEADER)


def _route_to(output: Output, routes: Sequence[Route], failures: Sequence[OSError]) -> Route:
    fits = [route for route in routes if route.leads_to(output)]
    if len(fits) == 1:
        return fits[0]
    how = f"{len(fits)} connectors of the kernel fit" if fits else "no connector of the kernel fits"
    told = "".join(f"; {failure.filename}: {failure.strerror}" for failure in failures)
    raise _unusable(f"{how} the output {output.name}{told}", *failures)


def _unusable(why: str, *causes: OSError) -> ConfigError:
    denied = any(isinstance(cause, PermissionError) for cause in causes)
    hint = PERMISSION_HINT if denied else 'choose another time_source, or "auto"'
    return ConfigError(f"no vblank counter: {why}", device="display", hint=hint)
