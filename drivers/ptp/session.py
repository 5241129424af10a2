"""One PTP session with one camera, and the ladder that brings a lost one back.

::

    rung 1   clear the halted endpoint, transfer again          drivers.ptp.usb_port
    rung 2   cancel the transaction, wait until ready, drain    Transport.back_in_step
             (or open the session anew, where only that is lost)
    rung 3   device reset, open the session anew
    rung 4   reset the port, find the camera again, open anew
    rung 5   give up: DeviceLost, the camera is off line until `open` is called again

An operation that fails climbs one rung at a time and is repeated after each, except those that
must happen `once`: they are never sent twice unless the camera said that it did not do them.

Longest waits: 8 s for each transaction, 1.5 s for those of the first contact; an operation that
climbs all the way gives up within `LONGEST_OPERATION_S`. A cancel may interrupt it at any time
(`pdcd.driver.Patience`): the next operation then begins by getting back in step.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial

from pdcd.driver import Clock, ConfigError, DeviceLost, Patience, PdcdError

from .codes import Operation, ResponseCode, format_code
from .containers import WireError
from .datasets import DeviceInfo
from .faults import (
    DEVICE,
    POWER_CYCLE,
    DeviceGone,
    NoAnswer,
    SessionLost,
    TransactionMismatch,
    WireFault,
)
from .transport import TransactionReply, Transport
from .usb_port import UsbPort, describe_device, find_cameras

logger = logging.getLogger(__name__)

_CONTACT_S = 1.5
"""Longest wait for each transfer of the first contact: a sound camera answers at once."""
_CONTACT_TRIES = 3
_AGAIN_S = 5.0
"""How long a camera may take to come back on the bus after a reset of its port."""
LONGEST_OPERATION_S = 60.0
"""Longest time of one operation with all rungs (4 tries of 8 s, resets and their waits)."""

_HELD_S = 0.1
"""How long another thread may hold the session before `wanted` tells it that others wait."""

_SESSION = 1
_STEP, _RESET, _PORT, _GIVE_UP = 2, 3, 4, 5
_AGAIN_STEP_NS = 200_000_000


class PtpSession:
    """A session with the camera of this USB id and serial number; if neither is given, with the
    only camera.

    backend : a pyusb backend, or None for the machine's libusb.
    restore : called whenever a session was opened anew, to set the modes that were lost.
    patience : the rig's, checked between transfers and at every rung of the ladder.

    Every method may be called from any thread; it `hold`s the session while it runs.
    """

    def __init__(
        self,
        backend: object,
        clock: Clock,
        restore: Callable[[], None],
        *,
        usb_id: tuple[int, int] | None = None,
        serial: str | None = None,
        patience: Patience | None = None,
    ) -> None:
        self.lock = threading.RLock()
        self.wanted = threading.Event()
        """Whether a thread waits for the session that another one holds."""
        self.info: DeviceInfo | None = None
        self.renewed = 0
        """How often a session was opened; handles of objects are only valid within one."""
        self.found = 0
        """How often the camera was found on the bus; it may have been switched off between."""
        self.climbs = 0
        """How often the ladder was climbed: after that, an operation may have been done twice."""
        self._backend = backend
        self._clock = clock
        self._restore = restore
        self._usb_id = usb_id
        self._serial = serial
        self._patience = patience or Patience(clock)
        self._transport: Transport | None = None
        self._climbing = False

    @property
    def is_open(self) -> bool:
        """Whether there is a session; True does not prove that the camera still answers."""
        return self._transport is not None

    @property
    def is_opening(self) -> bool:
        """Whether a session is just being opened or restored."""
        return self._climbing

    @property
    def name(self) -> str:
        """Where the camera is; empty when there is no session."""
        return self._transport.name if self._transport else ""

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Hold the session for one thread, which may already hold it; raises what `Patience.look`
        raises."""
        if not self.lock.acquire(timeout=_HELD_S):
            self.wanted.set()
            try:
                self._patience.acquire(self.lock)
            finally:
                self.wanted.clear()
        try:
            yield
        finally:
            self.lock.release()

    def open(self) -> DeviceInfo:
        """Find the camera, open a session and set its modes; nothing to do when that is done.

        Raises DeviceLost when there is no such camera or it does not answer, and ConfigError when
        there is more than one to choose from.
        """
        with self.hold():
            if self._transport is None:
                try:
                    self._guarded(partial(self._find, self._serial))
                except WireFault as fault:
                    self._climb(_RESET, Operation.OPEN_SESSION, fault)
                except PdcdError:
                    self._drop()
                    raise
            if self.info is None:
                raise _off_line()
            return self.info

    def call(
        self, code: Operation, *params: int, data: bytes | None = None, once: bool = False
    ) -> TransactionReply:
        """Do an operation and return the camera's response, which may be a refusal.

        Raises NoAnswer if it must happen `once` and no answer came, and DeviceLost if the camera
        cannot be brought back.
        """
        with self.hold():
            rung = _STEP
            while True:
                try:
                    reply = self._connected().transact(code, params, data)
                except WireFault as fault:
                    if self._climbing:
                        raise
                    rung = 1 + self._climb(rung, code, fault)
                    if once:
                        raise NoAnswer(f"{code.name} was not answered") from fault
                    continue
                if reply.code != ResponseCode.SESSION_NOT_OPEN or self._climbing:
                    return reply
                # The camera did nothing, so even what must happen once may be sent again.
                rung = 1 + self._climb(rung, code, SessionLost())

    def close(self) -> None:
        """End the session and release the camera. Idempotent; never raises."""
        with self.hold():
            transport, self._transport = self._transport, None
            if transport is None:
                return
            try:
                transport.transact(Operation.CLOSE_SESSION, timeout_s=_CONTACT_S)
            except PdcdError as fault:  # of who waits no longer, too
                logger.warning("session not closed camera=%s error=%s", transport.name, fault)
            _let_go(transport)

    def _connected(self) -> Transport:
        if self._transport is None:
            raise _off_line()
        return self._transport

    def _climb(self, rung: int, code: Operation, fault: WireFault) -> int:
        """Bring the camera back, starting at this rung; returns the rung that succeeded."""
        self.climbs += 1
        try:
            while rung < _GIVE_UP:
                if isinstance(fault, DeviceGone):
                    rung = _PORT
                self._patience.look()
                what = fault.message
                logger.warning("recovering rung=%d operation=%s fault=%s", rung, code.name, what)
                try:
                    step = self._renew if isinstance(fault, SessionLost) else self._step
                    self._guarded({_STEP: step, _RESET: self._reset, _PORT: self._port}[rung])
                    return rung
                except PdcdError as err:
                    fault = err if isinstance(err, WireFault) else TransactionMismatch(err.message)
                    rung += 1
            self._patience.look()
        except PdcdError:  # nobody waits any longer, and half a session is none
            self._drop()
            raise
        self._drop()
        if isinstance(fault, DeviceGone):
            raise fault
        raise DeviceLost(
            f"cannot be brought back: {fault.message}", device=DEVICE, hint=POWER_CYCLE
        ) from fault

    def _guarded(self, action: Callable[[], None]) -> None:
        """Do something in which a fault must not climb the ladder again."""
        self._climbing = True
        try:
            action()
        finally:
            self._climbing = False

    def _step(self) -> None:
        self._connected().back_in_step()

    def _renew(self) -> None:
        self._begin(self._connected())

    def _reset(self) -> None:
        transport = self._connected()
        transport.device_reset()
        self._begin(transport)

    def _port(self) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.usb_reset()
        serial = self._serial or (self.info.serial if self.info else None)
        until_ns = self._clock.now_ns() + round(_AGAIN_S * 1e9)
        while True:
            self._patience.look()
            try:
                self._find(serial)
                return
            except PdcdError:
                self._drop()
                if self._clock.now_ns() >= until_ns:
                    raise
            self._clock.sleep_until_ns(self._clock.now_ns() + _AGAIN_STEP_NS)

    def _find(self, serial: str | None) -> None:
        """Claim the camera with this serial number, or the only one, and begin a session on it."""
        devices = find_cameras(self._backend, self._usb_id)
        places = ", ".join(describe_device(device) for device in devices)
        if len(devices) > 1 and not serial:
            raise ConfigError(
                f"there is more than one camera: {places}",
                device=DEVICE,
                hint="give the serial number or the USB id of one in the options",
            )
        seen = []
        for device in devices:
            self._transport = Transport(UsbPort(device, self._patience.look), self._clock)
            info = _greet(self._transport)
            if not serial or serial == info.serial:
                self.found += 1
                self._begin(self._transport, info)
                return
            seen.append(info.serial)
            self._drop()
        raise DeviceLost(
            f"no camera has serial number {serial}" if seen else "no camera was found",
            device=DEVICE,
            hint=f"found are {', '.join(seen)}"
            if seen
            else "switch it on, plug it in, and set it to normal PC connection (PTP)",
        )

    def _begin(self, transport: Transport, info: DeviceInfo | None = None) -> None:
        self.info = info or _greet(transport)
        self.renewed += 1
        self._restore()

    def _drop(self) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            _let_go(transport)


def _greet(transport: Transport) -> DeviceInfo:
    """Open a session and ask the camera what it is."""
    for left in range(_CONTACT_TRIES - 1, -1, -1):
        try:
            return _hello(transport)
        except DeviceGone:
            raise
        except WireFault as fault:
            if not left:
                raise
            logger.warning("no contact camera=%s error=%s", transport.name, fault)
        with suppress(WireFault):  # if this fails, so will the next try, and say why
            transport.back_in_step()
    raise TransactionMismatch(
        "was never asked"
    )  # pragma: no cover - the last try returns or raises


def _hello(transport: Transport) -> DeviceInfo:
    reply = _open_session(transport)
    if reply.code == ResponseCode.SESSION_ALREADY_OPEN:
        # Left over from a dead program. A camera reports its settings once a session: begin one.
        transport.transact(Operation.CLOSE_SESSION, timeout_s=_CONTACT_S)
        reply = _open_session(transport)
    if reply.code not in (ResponseCode.OK, ResponseCode.SESSION_ALREADY_OPEN):
        raise TransactionMismatch(f"refuses a session: {format_code(reply.code, ResponseCode)}")
    reply = transport.transact(Operation.GET_DEVICE_INFO, timeout_s=_CONTACT_S)
    if reply.code != ResponseCode.OK:
        raise TransactionMismatch(
            f"does not say what it is: {format_code(reply.code, ResponseCode)}"
        )
    try:
        return DeviceInfo.parse(reply.data)
    except WireError as err:
        raise TransactionMismatch(err.message) from err


def _open_session(transport: Transport) -> TransactionReply:
    transport.restart_ids()
    return transport.transact(Operation.OPEN_SESSION, (_SESSION,), timeout_s=_CONTACT_S)


def _off_line() -> DeviceLost:
    return DeviceLost("is off line", device=DEVICE, hint=POWER_CYCLE)


def _let_go(transport: Transport) -> None:
    try:
        transport.close()
    except WireFault as fault:
        logger.warning("port not released camera=%s error=%s", transport.name, fault)
