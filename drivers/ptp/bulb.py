"""Holding the shutter of an EOS body open over USB, and letting go of it whatever happens.

There are two ways, and a body lists in its DeviceInfo which it knows: RemoteReleaseOn and Off hold
the release button (newer bodies, and the 50D and 5D Mark II), BulbStart and BulbEnd hold an
exposure (40D, 450D, 1000D). Bodies with neither need a cable release.

A start is never sent twice. If it is not answered, the exposure is ended, not started again: the
camera may have opened all the same, and a second start would be a second photo.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from pdcd.driver import Clock, ConfigError, DeviceLost, ExposureError

from .codes import Operation, ResponseCode, format_code
from .datasets import DeviceInfo
from .faults import DEVICE, NoAnswer
from .options import ReleaseName
from .transport import TransactionReply

logger = logging.getLogger(__name__)

_FULL_PRESS, _NO_AUTOFOCUS = 3, 1
_STOP_TRIES = 3
"""How many times a camera that refuses to close is asked before the refusal is accepted."""
_CLOSED = (ResponseCode.OK, ResponseCode.GENERAL_ERROR)
"""Responses to the end of an exposure from a camera that has closed, or held nothing open."""


@dataclass(frozen=True)
class _Method:
    """How the shutter is opened and closed: operations and their parameters."""

    name: ReleaseName
    start: Operation
    start_params: tuple[int, ...]
    stop: Operation
    stop_params: tuple[int, ...]


REMOTE = _Method(
    "remote",
    Operation.EOS_REMOTE_RELEASE_ON,
    (_FULL_PRESS, _NO_AUTOFOCUS),
    Operation.EOS_REMOTE_RELEASE_OFF,
    (_FULL_PRESS,),
)
BULB = _Method("bulb", Operation.EOS_BULB_START, (), Operation.EOS_BULB_END, ())


def choose_method(info: DeviceInfo, wanted: ReleaseName) -> _Method | None:
    """The way this body offers, or the one that is forced; None if it needs a cable release."""
    for method in (REMOTE, BULB):
        if wanted == method.name or (wanted == "auto" and info.supports(method.start, method.stop)):
            return method
    return None


class _Order(Protocol):
    """Does an operation, and repeats it for a busy camera (see `EosCamera.order`)."""

    def __call__(self, code: Operation, *params: int, once: bool = False) -> TransactionReply:
        """The camera's response, whatever it is."""
        ...


class Bulb:
    """The shutter of one camera. Callers hold the session's lock.

    `climbs` counts how often the session had to be restored.
    """

    def __init__(self, order: _Order, climbs: Callable[[], int], clock: Clock) -> None:
        self.method: _Method | None = None
        self.since_ns: int | None = None
        """Since when the shutter is or may be open; None when it is surely closed."""
        self.owed = False
        """Whether an exposure was begun whose photo has not been fetched yet."""
        self._order = order
        self._climbs = climbs
        self._clock = clock
        self._spoiled = ""
        self._unanswered = False
        """Whether the end of this exposure was requested with an unknown outcome."""

    def new_session(self, method: _Method | None) -> None:
        """In a new session, close a shutter that the last one, or another program, left open.

        An exposure that was under way is spoiled, as the time of its end is not known. Raises
        ExposureError when the camera does not close it.
        """
        self.method = method
        if method is not None:
            code = self._order(method.stop, *method.stop_params).code
            # Answers of bodies that hold nothing open are not all known; a busy one did not do it.
            doubted = self.since_ns is not None or code == ResponseCode.DEVICE_BUSY
            if doubted and code not in (*_CLOSED, ResponseCode.OPERATION_NOT_SUPPORTED):
                raise _refused_to_close(code)
        if self.since_ns is not None:
            self._spoiled = "the connection was lost while the shutter was open"
            self.since_ns = None

    def begin(self) -> None:
        """Open the shutter. Raises ExposureError, with it closed, when that is not sure."""
        method = self.chosen()
        if self.since_ns is not None:
            raise ExposureError("the shutter is open", device=DEVICE, hint="close it first")
        self._spoiled, self._unanswered = "", False
        self.owed = True
        self.since_ns = self._clock.now_ns()
        try:
            reply = self._order(method.start, *method.start_params, once=True)
        except NoAnswer as err:
            self._let_go(method)
            raise ExposureError(
                "the camera did not confirm that it opened the shutter",
                device=DEVICE,
                hint="the exposure was ended and its photo will be thrown away; try again",
            ) from err
        if reply.code != ResponseCode.OK:
            self.owed, self.since_ns = False, None
            raise ExposureError(
                f"the camera refuses to open the shutter: {format_code(reply.code, ResponseCode)}",
                device=DEVICE,
                hint="mode dial to M, lens to manual focus, enough battery; then try again",
            )
        # If the session had to be opened anew before the camera began, nothing was spoiled.
        self._spoiled, self.since_ns = "", self._clock.now_ns()
        logger.info("shutter held open method=%s", method.name)

    def settle(self) -> None:
        """Close the shutter before something new; the outcome of the old exposure is dropped."""
        if self.since_ns is not None:
            self._stop(self.chosen())
        self._spoiled = ""

    def end(self) -> None:
        """Close the shutter; nothing to do when it is closed.

        Raises ExposureError when it is closed but the exposure is spoiled, or when the camera
        refuses; DeviceLost when it cannot be reached. `since_ns` says whether it may be open.
        """
        if self.since_ns is not None:
            self._stop(self.chosen())
        spoiled, self._spoiled = self._spoiled, ""
        if spoiled:
            raise ExposureError(
                f"the exposure is spoiled: {spoiled}", device=DEVICE, hint="try again"
            )

    def _stop(self, method: _Method) -> None:
        before = self._climbs()
        for _ in range(_STOP_TRIES):
            asked_before, self._unanswered = self._unanswered, True
            reply = self._order(method.stop, *method.stop_params)
            self._unanswered = asked_before
            if self.since_ns is None:
                return  # a new session closed it meanwhile
            if reply.code == ResponseCode.OK:
                self.since_ns = None
                logger.info("shutter let go method=%s", method.name)
                return
            twice = asked_before or self._climbs() != before
            if reply.code == ResponseCode.GENERAL_ERROR and twice:
                self.since_ns = None  # the first time did it
                return
        raise _refused_to_close(reply.code)

    def overdue(self, longest_ns: int) -> bool:
        """Whether the shutter is open for longer than that."""
        return self.since_ns is not None and self._clock.now_ns() - self.since_ns > longest_ns

    def spoil(self, why: str) -> None:
        """Mark the exposure as spoiled; `end` then raises the reason."""
        self._spoiled = why

    def chosen(self) -> _Method:
        """How this body's shutter is opened; ConfigError when it has no way over USB."""
        if self.method is None:
            raise ConfigError(
                "this body cannot hold its shutter open over USB: an external trigger is needed",
                device=DEVICE,
                hint="connect a cable release and choose its driver in [trigger]",
            )
        return self.method

    def _let_go(self, method: _Method) -> None:
        """End an exposure whose start failed; the error of the start is the one to report."""
        try:
            code = self._order(method.stop, *method.stop_params).code
            if code in _CLOSED:
                self.since_ns = None
            else:
                logger.error("shutter may be open answer=%s", format_code(code, ResponseCode))
            if code == ResponseCode.GENERAL_ERROR:
                self.owed = False  # it held nothing open
        except DeviceLost as err:
            logger.error("shutter may be open error=%s", err)
        self._spoiled = ""


def _refused_to_close(code: int) -> ExposureError:
    return ExposureError(
        f"the camera refuses to close the shutter: {format_code(code, ResponseCode)}",
        device=DEVICE,
        hint="if it is still open, switch the camera off",
    )
