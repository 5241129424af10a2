"""A Canon EOS body over PTP: modes, settings, events, bulb, files.

The body reports its settings and their allowed values in events, once a session, so everything
known about it comes from `poll`. An event also announces a waiting photo.

Not modelled: focusing, timed exposures, movies.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from pdcd.driver import (
    Cancelled,
    Clock,
    DeviceLost,
    DriverContext,
    ExposureError,
    Patience,
    PdcdError,
    load_profile,
)

from .bulb import Bulb, choose_method
from .codes import (
    DESTINATION_RAM,
    FINDER_OFF,
    FINDER_PC,
    PC_HDD_ROOM,
    SHUTTER_BULB,
    ExposureMode,
    Operation,
    Property,
    ResponseCode,
    format_code,
)
from .containers import WireError
from .datasets import pack_property_bytes, pack_property_set
from .events import ObjectAdded, is_raw_only, parse_events
from .faults import DEVICE, POWER_CYCLE, TransactionMismatch
from .keepalive import PERIOD_S, KeepAlive
from .options import PtpOptions, read_ptp_options
from .session import PtpSession
from .told import Told
from .transport import TransactionReply
from .values import list_setup_faults

logger = logging.getLogger(__name__)

SHUTTER = "shutter"
"""The user that opens and closes."""

_BUSY_S = 5.0
"""How long a busy camera is asked again; it answers 2019 while events wait to be read."""
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.05, 0.8
_MOST_POLLS, _MOST_DAMAGED = 64, 3
_MARGIN_S = 10.0
_LIMIT = "limits.max_exposure_s"
_LONGEST_S = 1e6
"""Eleven days, even if limits.max_exposure_s is infinite."""
_POLLS = 20
_CALL_S = 120.0
"""Longest time for anything but fetching a photo, whatever the camera answers."""
_LEAVE_S, _CLOSE_S, _LAST_CLOSE_S = 5.0, 1.0, 0.5
"""Time to leave a camera in order; to close it when all tries have used up their time; and to close
it when it does nothing else, which may be after a cancel."""
_CLOSING_S = 10.0
"""Longest wait for all tries together to close one exposure."""
MOST_PHOTO_B = 1 << 30
"""Largest photo of a camera whose sensor is not known."""


class EosCamera(Told):
    """One body, used by a shutter, a readout, or both; open while at least one of them is.

    May be called from any thread; each call holds the session until it returns.
    """

    def __init__(
        self,
        options: PtpOptions,
        clock: Clock,
        backend: object,
        longest_s: float,
        patience: Patience | None = None,
        most_photo_bytes: int = MOST_PHOTO_B,
    ) -> None:
        super().__init__()
        self.options = options
        self.patience = patience or Patience(clock)
        self.most_photo_bytes = most_photo_bytes
        """Largest possible photo of this sensor."""
        self.session = PtpSession(
            backend,
            clock,
            self._set_modes,
            usb_id=options.usb_id,
            serial=options.serial,
            patience=self.patience,
        )
        self.bulb = Bulb(self.order, lambda: self.session.climbs, clock)
        self.clock = clock
        self._longest_ns = round((min(longest_s, _LONGEST_S) + _MARGIN_S) * 1e9)
        self._due_ns = self._longest_ns
        """How long the present exposure may last."""
        self._close_by_ns: int | None = None
        """When the tries to close it end; set by the first try."""
        self._users: set[str] = set()
        self.alive_period_s = PERIOD_S
        self._alive: KeepAlive | None = None

    @classmethod
    def of(cls, context: DriverContext) -> EosCamera:
        """The camera of this rig; made by the first driver that asks."""

        def make() -> EosCamera:
            options = read_ptp_options(context.config)
            backend = context.usb_backend(options.usb)
            if backend is None:
                context.require_real_time("camera", "camera")
            longest_s = context.config.limits.max_exposure_s
            most_b = MOST_PHOTO_B
            if context.config.camera.driver == "ptp" and not options.in_process:
                most_b = load_profile(context.config.camera.profile).largest_photo_bytes
            return cls(options, context.clock, backend, longest_s, context.patience, most_b)

        return context.the(cls, make)

    @contextmanager
    def in_time(self, seconds: float = _CALL_S) -> Iterator[None]:
        """The session for one call, which ends with DeviceLost if the camera takes too long."""

        def over() -> PdcdError:
            return DeviceLost(
                f"did not get on with it in {seconds:.3g} s",
                device=DEVICE,
                hint=POWER_CYCLE,
            )

        with self.patience.within(seconds, over), self.session.hold():
            yield

    @contextmanager
    def _closing(self) -> Iterator[None]:
        """The session for one try to close an exposure. All tries share one deadline; a try after
        it still gets `_CLOSE_S`."""
        if self._close_by_ns is None:
            self._close_by_ns = self.clock.now_ns() + round(_CLOSING_S * 1e9)
        left_s = (self._close_by_ns - self.clock.now_ns()) * 1e-9
        with self.in_time(max(left_s, _CLOSE_S)):
            yield

    @property
    def releases(self) -> bool:
        """Whether the shutter is operated from here, not by a cable release."""
        return SHUTTER in self._users

    def open(self, user: str) -> dict[str, str]:
        """Open the camera for this user: session, modes, settings read, shutter closed. Idempotent.

        Returns the camera's description. For the user `SHUTTER`, raises ConfigError when this body
        cannot be released over USB.
        """
        with self.in_time():
            info = self.session.open()
            if self._alive is None:
                self._alive = KeepAlive(self.tick, self.alive_period_s)
            self._users.add(user)
            method = self.bulb.method
            if user == SHUTTER:
                method = self.bulb.chosen()
                self.bulb.settle()
            return {
                "model": info.model,
                "serial": info.serial,
                "firmware": info.device_version,
                "place": self.session.name,
                "release": method.name if method else "external",
            }

    def let_go(self, user: str) -> None:
        """`close` for a driver object that was dropped, where errors cannot be reported."""
        try:
            with self.patience.deaf():
                self.close(user)
        except PdcdError as err:
            logger.critical("camera not left as it should be error=%s", err)

    def renew(self) -> None:
        """Begin a new session: anything waiting in the camera is dropped."""
        with self.in_time():
            self.session.close()
            self.session.open()

    def close(self, user: str) -> None:
        """End the use by this user, for `SHUTTER` after closing it; after the last user the camera
        is released.

        Idempotent. Raises what `Bulb.end` raises, and DeviceLost when a camera that may be exposing
        is not found; the camera is released all the same.
        """
        with self.in_time(_CLOSING_S):
            held = user in self._users
            self._users.discard(user)
            try:
                if user == SHUTTER or not self._users:
                    with self._closing():
                        if held and self.bulb.since_ns is not None:
                            self.session.open()  # a camera that was lost may be exposing
                        if self.session.is_open:
                            self.bulb.end()
            finally:
                if not self._users:
                    self._leave_modes()
                    self.session.close()
                    alive, self._alive = self._alive, None
                    if alive is not None:
                        alive.stop()

    def order(
        self, code: Operation, *params: int, data: bytes | None = None, once: bool = False
    ) -> TransactionReply:
        """Do an operation; ask a busy camera again, and read its events meanwhile."""
        until_ns = self.clock.now_ns() + round(_BUSY_S * 1e9)
        pause_s = _FIRST_PAUSE_S
        while True:
            reply = self.session.call(code, *params, data=data, once=once)
            if reply.code != ResponseCode.DEVICE_BUSY or self.clock.now_ns() >= until_ns:
                return reply
            self.pause(pause_s)
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)
            self.poll()

    def pause(self, seconds: float) -> None:
        """Wait on the rig's clock, and check for a cancel."""
        self.patience.sleep(seconds)

    def poll(self) -> None:
        """Read all waiting events."""
        with self.in_time():
            damaged = 0
            for _ in range(_MOST_POLLS):
                reply = self.session.call(Operation.EOS_GET_EVENT)
                if reply.code != ResponseCode.OK:
                    return  # busy: there will be another poll
                try:
                    events = parse_events(reply.data)
                except WireError as err:
                    logger.warning("events lost camera=%s error=%s", self.session.name, err)
                    damaged += 1
                    if damaged == _MOST_DAMAGED:
                        return
                    continue
                try:
                    last_words = [self.hear(event) for event in events]
                except DeviceLost:  # all it told is forgotten: it is to tell it anew
                    if not self.session.is_opening:  # which is given up by itself
                        self.session.close()
                    raise
                if any(last_words):
                    self.session.call(Operation.EOS_KEEP_DEVICE_ON)
                if not events:
                    return

    def set_value(self, prop: Property, value: int, what: str) -> None:
        """Set a property and check that the camera accepted it. Raises ExposureError if not."""
        if self.values.get(prop) == value:
            return
        data = pack_property_set(prop, value)
        reply = self.order(Operation.EOS_SET_DEVICE_PROP_VALUE_EX, data=data)
        self.values[prop] = value
        self.poll()
        if reply.code != ResponseCode.OK or self.values[prop] != value:
            self.values.pop(prop)
            raise ExposureError(
                f"the camera does not take {what}", device=DEVICE, hint="set it on the camera"
            )

    def tick(self) -> None:
        """Sign of life, from the thread that keeps the camera awake; a busy camera is left
        alone."""
        session = self.session
        if not session.lock.acquire(blocking=False):
            return
        try:
            with self.patience.deaf(), self.patience.until(session.wanted.is_set, _give_way):
                self._stay_awake()
        finally:
            session.lock.release()

    def _stay_awake(self) -> None:
        if self._is_given_up:
            self.cut_short("the camera closed late")
        if self.session.is_open:
            if self.bulb.overdue(self._due_ns):
                logger.critical("shutter open for too long, closing camera=%s", self.session.name)
                told = self._due_ns < self._longest_ns
                limit = f"the {self._due_ns * 1e-9:.0f} s that it can take" if told else _LIMIT
                self.cut_short(f"it was open for longer than {limit}")
            self.session.call(Operation.EOS_KEEP_DEVICE_ON)
            self.poll()

    def begin_exposure(self, longest_s: float | None = None) -> None:
        """Open the shutter. Raises ExposureError, with it closed, when that cannot be done.

        longest_s : the longest exposure, if that is less than the general limit.
        """
        with self.in_time():
            if self.bulb.since_ns is None:
                self._close_by_ns = None
            expected_ns = self._longest_ns if longest_s is None else round(longest_s * 1e9)
            self._due_ns = min(expected_ns, self._longest_ns)
            self.session.open()
            self.set_bulb()
            self.poll()  # what waits to be heard makes the camera busy
            self.check_ready()
            self._throw_away(len(self.files))
            self.bulb.begin()

    def cut_short(self, why: str) -> None:
        """Close the shutter in place of the thread that opened it, which learns of it at the end.

        May be called from any thread. Raises what `Bulb.end` raises.
        """
        with self.patience.deaf(), self.in_time(_CLOSING_S):
            if self.bulb.since_ns is not None:
                try:
                    self.session.open()
                    self.bulb.end()
                finally:
                    if self.bulb.since_ns is None:
                        self.bulb.spoil(why)

    @property
    def _is_given_up(self) -> bool:
        """Whether an exposure may still go on whose end is no longer awaited, as it took too
        long."""
        by_ns, since_ns = self._close_by_ns, self.bulb.since_ns
        return by_ns is not None and since_ns is not None and self.clock.now_ns() >= by_ns

    def end_exposure(self) -> bool:
        """Close the shutter; returns whether it was open. Raises what `Bulb.end` raises.

        If all tries together take longer than `_CLOSING_S`, this stops waiting: the thread that
        keeps the camera awake goes on trying.
        """
        if self.bulb.since_ns is None:  # nobody is asked, who might not answer
            self.bulb.end()
            return False
        with self._closing():
            self.session.open()  # a lost camera is looked for: it may be exposing
            strays = len(self.files)
            try:
                self.bulb.end()
            except ExposureError:
                if self.bulb.since_ns is not None:  # it refuses; a new session begins with closed
                    self.renew()
                raise
            self._throw_away(strays)
            return True

    def discard(self, photo: ObjectAdded) -> bool:
        """Remove a photo from the camera's memory; one on the card stays there.

        Returns whether there was such a photo, as far as the camera reports.
        """
        if photo.on_card:
            self.done.add(photo.handle)
            return True
        reply = self.order(Operation.EOS_TRANSFER_COMPLETE, photo.handle)
        return reply.code == ResponseCode.OK

    def check_ready(self) -> None:
        """Raise ExposureError, which says what to change on the camera, if it cannot expose."""
        found = list_setup_faults(self.values, self.custom, self.options.destination)
        if found:
            raise ExposureError("the camera is not ready", device=DEVICE, hint="; ".join(found))

    def set_bulb(self) -> None:
        """Set the shutter speed to bulb. Raises ExposureError when the camera does not offer it."""
        if self.values.get(Property.EXPOSURE_MODE) == ExposureMode.BULB:
            return  # the dial itself says bulb
        offered = self.choices.get(Property.SHUTTER_SPEED, ())
        speed = next((speed for speed in SHUTTER_BULB if speed in offered), None)
        if speed is None:
            raise ExposureError(
                "the camera does not offer bulb", device=DEVICE, hint="turn the mode dial to M"
            )
        self.set_value(Property.SHUTTER_SPEED, speed, "shutter speed bulb")

    def _set_modes(self) -> None:
        """Set up a new session: remote control, events, destination, shutter closed."""
        self.forget()
        try:
            with self.patience.within(_CLOSING_S, _give_way):
                self._must(Operation.EOS_SET_REMOTE_MODE, 1)
                self._must(Operation.EOS_SET_EVENT_MODE, 1)
                if not self._heard(lambda: Property.ISO in self.choices):
                    raise TransactionMismatch("does not tell its settings")
        except PdcdError:
            # It may be exposing, and close though it does nothing else.
            with (
                suppress(PdcdError),
                self.patience.deaf(),
                self.patience.within(_LAST_CLOSE_S, _give_way),
            ):
                self._begin_closed()
            raise
        self._begin_closed()
        if self.values.get(Property.FINDER_OUTPUT, 0) & FINDER_PC:  # left on by one that was killed
            self.set_value(Property.FINDER_OUTPUT, FINDER_OFF, "the end of live view")
        self.set_value(Property.CAPTURE_DESTINATION, self._destination(), "the destination")
        if self.options.destination == "ram":
            self._must(Operation.EOS_PC_HDD_CAPACITY, *PC_HDD_ROOM)
            self._heard(lambda: self.values.get(Property.AVAILABLE_SHOTS) != 0)  # counted anew
        self._set_raw()

    def _begin_closed(self) -> None:
        """Close a shutter that was left open, in this body's way."""
        info = self.session.info
        if info is not None:
            self.bulb.new_session(choose_method(info, self.options.release))

    def _throw_away(self, count: int) -> bool:
        """Discard the oldest waiting photos: those that wait while the shutter is open are older.

        Returns whether the camera had one of them.
        """
        found = False
        for _ in range(min(count, len(self.files))):
            photo = self.files.popleft()
            logger.warning("photo of an earlier exposure thrown away name=%s", photo.name)
            found |= self.discard(photo)
        return found

    def _heard(self, known: Callable[[], bool]) -> bool:
        """Poll until `known()` is true, or for a second."""
        for _ in range(_POLLS):
            self.poll()
            if known():
                return True
            self.pause(_FIRST_PAUSE_S)
        return False

    def _leave_modes(self) -> None:
        """Give control back to the camera's own buttons, as far as the camera allows."""
        with suppress(PdcdError), self.patience.within(_LEAVE_S, _give_way):
            if self.session.is_open:
                card = self._card()
                if card is not None:
                    self.set_value(Property.CAPTURE_DESTINATION, card, "the destination")
                self.session.call(Operation.EOS_SET_EVENT_MODE, 0)
                self.session.call(Operation.EOS_SET_REMOTE_MODE, 0)

    def _must(self, code: Operation, *params: int) -> None:
        reply = self.order(code, *params)
        if reply.code != ResponseCode.OK:
            raise ExposureError(
                f"{code.name} is refused: {format_code(reply.code, ResponseCode)}",
                device=DEVICE,
                hint="is this a Canon EOS body, and idle?",
            )

    def _destination(self) -> int:
        if self.options.destination == "ram":
            return DESTINATION_RAM
        card = self._card()
        if card is None:
            raise ExposureError("the camera has no card", device=DEVICE, hint="put one in")
        return card

    def _card(self) -> int | None:
        offered = self.choices.get(Property.CAPTURE_DESTINATION, ())
        return next((value for value in offered if value != DESTINATION_RAM), None)

    def _set_raw(self) -> None:
        """Ask for RAW and nothing else, if the camera reports how."""
        formats = self.formats
        with suppress(WireError):
            raw = next((packed for packed in formats if is_raw_only(packed)), None)
            if raw is not None:
                data = pack_property_bytes(Property.IMAGE_FORMAT, raw)
                self.order(Operation.EOS_SET_DEVICE_PROP_VALUE_EX, data=data)
                self.poll()


def _give_way() -> PdcdError:
    return Cancelled("the camera is wanted, or slow", device=DEVICE)
