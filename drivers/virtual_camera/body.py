"""The virtual camera: a state machine that answers PTP operations as a Canon EOS 450D does.

It has no connection of its own: `drivers.virtual_camera.usb_backend` and
`drivers.virtual_camera.ptpip` bring operations in and answers out. Time comes from the injected
clock alone.

Modelled: session; remote and event mode; the property list, sent once a session; settings checked
against the camera's own lists; destination, room on the computer, and memory that stays full until
the client reports a transfer as complete; bulb by BulbStart/End or RemoteReleaseOn/Off, timed
releases, a cable release; files announced on the card or in memory, whole and partial reads,
deletion; live view of fifteen pictures a second; the class requests;
`drivers.virtual_camera.faults`.

Assumed, as no body was at hand: a release with autofocus on, with an empty battery or with the dial
off M is a GeneralError; a shutter held open stays open when the session, the connection or the
device is reset, until it is told to close. Not modelled: mirror, focusing and all else that answers
OperationNotSupported although the body lists it; checking of transaction ids; the speed of the USB;
automatic power-off; a full or missing card; the time that settings take.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

from pdcd.driver import Clock

from ..ptp.codes import (
    FINDER_PC,
    EosEvent,
    ExposureMode,
    FocusMode,
    Operation,
    Property,
    ResponseCode,
)
from ..ptp.containers import WireError
from ..ptp.datasets import parse_property_set
from ..ptp.events import EosRecord, ObjectAdded, PlainRecord, pack_events
from .develop import Develop, develop_at_once
from .faults import FaultScript, Occasions
from .model import BULB_BODY, CameraModel
from .objects import ObjectReader
from .properties import Properties
from .reply import OK, CameraReply, make_error_reply
from .shutter import CameraShutter, FileStore, ShutterFilm

DATA_OUT = frozenset(
    {Operation.EOS_SET_DEVICE_PROP_VALUE_EX, Operation.SET_DEVICE_PROP_VALUE, 0x100C, 0x100D}
)
"""Operations that send data to the camera; all others receive data or have none."""

_WITHOUT_SESSION = frozenset({Operation.GET_DEVICE_INFO, Operation.OPEN_SESSION})
_HALF, _FULL = 1, 2
_NO_FOCUS = 1
_FINDER_NS = 66_666_667
"""Time between two pictures of live view."""


_Handler = Callable[["CameraBody", tuple[int, ...], bytes], CameraReply]


class CameraBody:
    """One camera. Not safe for two threads at once: its transport must serialize calls."""

    def __init__(
        self,
        clock: Clock,
        film: ShutterFilm,
        model: CameraModel = BULB_BODY,
        script: FaultScript | None = None,
        develop: Develop = develop_at_once,
        finder: Callable[[], bytes] | None = None,
    ) -> None:
        """finder : makes the JPEG of a picture of live view; None: this body has none."""
        self.model = model
        self.script = script or FaultScript()
        self.clock = clock
        self.plugged = True
        self.plugged_again = 0
        """How often the cable came back."""
        self.store = FileStore()
        self.settings = Properties(model, self.script)
        self.shutter = CameraShutter(clock, film, self.script, self.store, develop)
        self.kept_on = 0
        """How often the client asked the camera to stay on."""
        self._finder = finder
        self._finder_due_ns = 0
        self._occasions = Occasions(self.script)
        self._reading = ObjectReader(self.store, self.settings, model).handlers
        self._session: int | None = None
        self._remote = self._events = False
        self._pc_has_room = False
        self._told_everything = False
        self._queue: list[EosRecord] = []

    @property
    def session_open(self) -> bool:
        """Whether a client has a session."""
        return self._session is not None

    # What the transport calls

    def transact(
        self, code: int, parameters: tuple[int, ...] = (), data: bytes = b""
    ) -> CameraReply:
        """Do one operation. Omitted parameters count as zero."""
        fault = self._occasions.meet(code)
        match fault:
            case "unplug":
                self.plugged = False
                return CameraReply(fault=fault)
            case "deaf":
                return CameraReply(fault=fault)
            case "busy":
                return make_error_reply(ResponseCode.DEVICE_BUSY)
            case "error":
                return make_error_reply(ResponseCode.GENERAL_ERROR)
            case "lost-session":
                self.forget_session()
        reply = self._answer(code, parameters, data)
        if fault == "no-data":
            return replace(reply, data=None)
        if fault == "corrupt" and reply.data:
            damaged = bytearray(reply.data)
            damaged[len(damaged) // 2] ^= 0x5A
            return replace(reply, data=bytes(damaged))
        return replace(reply, fault=fault)

    def forget_session(self) -> None:
        """Class request 66, or a lost connection: session and modes are gone.

        Files in memory stay, and so does an open shutter.
        """
        self._session = None
        self._remote = self._events = False
        self._told_everything = False
        self._queue.clear()

    # Cable release and USB cable

    def press(self) -> None:
        """The cable release is pressed home: the shutter opens if the camera is ready for it."""
        if self._ready() is None:
            self._open()

    def release(self) -> None:
        """The cable release is let go: an exposure in bulb ends."""
        if self.settings.bulb:
            self._close()

    def unplug(self) -> None:
        """Pull the cable to the computer."""
        self.plugged = False

    def replug(self) -> None:
        """Plug the cable in again: the camera has no session any more."""
        self.plugged = True
        self.plugged_again += 1
        self.forget_session()

    # Operations

    def _answer(self, code: int, parameters: tuple[int, ...], data: bytes) -> CameraReply:
        handler = self._handlers.get(code)
        reads = self._reading.get(code)
        if code not in self.model.info.operations or not (handler or reads):
            return make_error_reply(ResponseCode.OPERATION_NOT_SUPPORTED)
        if self._session is None and code not in _WITHOUT_SESSION:
            return make_error_reply(ResponseCode.SESSION_NOT_OPEN)
        padded = (*parameters, 0, 0, 0, 0, 0)[:5]
        if handler is not None:
            return handler(self, padded, data)
        return reads(padded) if reads else make_error_reply(ResponseCode.OPERATION_NOT_SUPPORTED)

    def _device_info(self, _p: tuple[int, ...], _data: bytes) -> CameraReply:
        return CameraReply(data=self.model.info.pack())

    def _open_session(self, p: tuple[int, ...], _data: bytes) -> CameraReply:
        if self._session is not None:
            return CameraReply(ResponseCode.SESSION_ALREADY_OPEN, (self._session,))
        if p[0] == 0:
            return make_error_reply(ResponseCode.INVALID_PARAMETER)
        self._session = p[0]
        return OK

    def _close_session(self, _p: tuple[int, ...], _data: bytes) -> CameraReply:
        self.forget_session()
        return OK

    def _remote_mode(self, p: tuple[int, ...], _data: bytes) -> CameraReply:
        self._remote = p[0] != 0
        return OK

    def _event_mode(self, p: tuple[int, ...], _data: bytes) -> CameraReply:
        self._events = p[0] != 0
        # Once a session: sending all again would look as if all settings had changed.
        if self._events and not self._told_everything:
            self._told_everything = True
            self._queue += self.settings.everything()
            if self.script.battery == 0:
                self._queue.append(PlainRecord(EosEvent.WILL_SOON_SHUT_DOWN, struct.pack("<I", 0)))
        return OK

    def _get_event(self, _p: tuple[int, ...], _data: bytes) -> CameraReply:
        if not self._events:
            return CameraReply(data=pack_events([]))
        found = self.shutter.records()
        self._queue += found
        if any(isinstance(record, ObjectAdded) for record in found):
            self._count_shots()
        records, self._queue = self._queue, []
        return CameraReply(data=pack_events(records))

    def _set_property(self, _p: tuple[int, ...], data: bytes) -> CameraReply:
        try:
            prop, value = parse_property_set(data)
        except WireError:
            return make_error_reply(ResponseCode.INVALID_PARAMETER)
        if not self.settings.has(prop):
            return make_error_reply(ResponseCode.DEVICE_PROP_NOT_SUPPORTED)
        if self.shutter.is_open:
            return make_error_reply(ResponseCode.DEVICE_BUSY)
        if not self.settings.put(prop, value):
            return make_error_reply(ResponseCode.INVALID_DEVICE_PROP_VALUE)
        self._queue.append(self.settings.record(prop))
        if prop == Property.CAPTURE_DESTINATION:
            self._count_shots()
        return OK

    def _request_property(self, p: tuple[int, ...], _data: bytes) -> CameraReply:
        if not self.settings.has(p[0]):
            return make_error_reply(ResponseCode.GENERAL_ERROR)
        self._queue.append(self.settings.record(p[0]))
        return OK

    def _pc_capacity(self, p: tuple[int, ...], _data: bytes) -> CameraReply:
        self._pc_has_room = p[0] > 0
        self._count_shots(tell=True)
        return OK

    def _set_lock(self, _p: tuple[int, ...], _data: bytes) -> CameraReply:
        return OK

    def _keep_on(self, _p: tuple[int, ...], _data: bytes) -> CameraReply:
        self.kept_on += 1
        return OK

    def _bulb_start(self, _p: tuple[int, ...], _data: bytes) -> CameraReply:
        refused = self._refusal() or (None if self.settings.bulb else ResponseCode.GENERAL_ERROR)
        if refused is not None:
            return make_error_reply(refused)
        self._open()
        return OK

    def _bulb_end(self, _p: tuple[int, ...], _data: bytes) -> CameraReply:
        if not self.shutter.is_open:
            return make_error_reply(ResponseCode.GENERAL_ERROR)
        self._close()
        return OK

    def _remote_release(self, _p: tuple[int, ...], _data: bytes) -> CameraReply:
        if self.settings.bulb:
            return make_error_reply(ResponseCode.GENERAL_ERROR)
        refused = self._refusal()
        if refused is ResponseCode.GENERAL_ERROR and self._out_of_focus:
            return CameraReply(ResponseCode.OK, (_NO_FOCUS,))
        if refused is not None:
            return make_error_reply(refused)
        self._open()
        return CameraReply(ResponseCode.OK, (0,))

    def _release_on(self, p: tuple[int, ...], _data: bytes) -> CameraReply:
        if not p[0] & _FULL:
            return OK if p[0] & _HALF else make_error_reply(ResponseCode.INVALID_PARAMETER)
        refused = self._refusal()
        if refused is not None:
            return make_error_reply(refused)
        self._open()
        return CameraReply(ResponseCode.OK, (0,))

    def _release_off(self, p: tuple[int, ...], _data: bytes) -> CameraReply:
        if p[0] & _FULL and self.settings.bulb:
            self._close()
        return OK

    def _transfer_complete(self, p: tuple[int, ...], _data: bytes) -> CameraReply:
        stored = self.store.files.get(p[0])
        if stored is None:
            return make_error_reply(ResponseCode.INVALID_OBJECT_HANDLE)
        if not stored.on_card:
            del self.store.files[p[0]]
            self._count_shots(tell=True)
        return OK

    def _delete(self, p: tuple[int, ...], _data: bytes) -> CameraReply:
        if p[0] not in self.store.files:
            return make_error_reply(ResponseCode.INVALID_OBJECT_HANDLE)
        del self.store.files[p[0]]
        self._count_shots(tell=True)
        return OK

    def _view_finder(self, _p: tuple[int, ...], _data: bytes) -> CameraReply:
        """When there is a new picture: blocks of length, type and content, the picture in one."""
        now_ns = self.clock.now_ns()
        if self._finder is None or not self.settings[Property.FINDER_OUTPUT] & FINDER_PC:
            return make_error_reply(ResponseCode.GENERAL_ERROR)
        if now_ns < self._finder_due_ns:
            return make_error_reply(ResponseCode.EOS_NOT_READY)
        self._finder_due_ns = max(self._finder_due_ns, now_ns - _FINDER_NS) + _FINDER_NS
        jpeg = self._finder()
        blocks = ((3, bytes(16)), (1, jpeg), (14, bytes(4)))
        packed = (struct.pack("<II", 8 + len(held), kind) + held for kind, held in blocks)
        return CameraReply(data=b"".join(packed))

    # The release

    def _refusal(self) -> ResponseCode | None:
        """Why a client may not release now; None when it may."""
        self._queue += self.shutter.records()  # a timed exposure may just have ended
        if not self._remote:
            return ResponseCode.GENERAL_ERROR
        if self._queue or self.shutter.has_news:
            return ResponseCode.DEVICE_BUSY  # the client must fetch earlier events first
        return self._ready()

    def _ready(self) -> ResponseCode | None:
        """Why the camera itself cannot release now."""
        if self.shutter.busy:
            return ResponseCode.DEVICE_BUSY
        if self.settings[Property.AVAILABLE_SHOTS] == 0:
            return ResponseCode.STORE_FULL
        manual = self.script.dial in (ExposureMode.MANUAL, ExposureMode.BULB)
        if not manual or self._out_of_focus or self.script.battery == 0:
            return ResponseCode.GENERAL_ERROR
        return None

    @property
    def _out_of_focus(self) -> bool:
        return self.script.focus is not FocusMode.MANUAL  # autofocus finds nothing on a dark bench

    def _open(self) -> None:
        settings = self.settings
        for_s = None if settings.bulb else settings.exposure_s
        self.shutter.open(settings.iso, settings.f_number, on_card=settings.on_card, for_s=for_s)

    def _close(self) -> None:
        self.shutter.close()

    def _count_shots(self, *, tell: bool = False) -> None:
        changed = self.settings.count_shots(pc_has_room=self._pc_has_room, in_ram=self.store.in_ram)
        if changed or tell:
            self._queue.append(self.settings.record(Property.AVAILABLE_SHOTS))

    _handlers: ClassVar[dict[int, _Handler]] = {
        Operation.GET_DEVICE_INFO: _device_info,
        Operation.OPEN_SESSION: _open_session,
        Operation.CLOSE_SESSION: _close_session,
        Operation.DELETE_OBJECT: _delete,
        Operation.EOS_DELETE_OBJECT: _delete,
        Operation.EOS_SET_DEVICE_PROP_VALUE_EX: _set_property,
        Operation.EOS_REQUEST_DEVICE_PROP_VALUE: _request_property,
        Operation.EOS_SET_REMOTE_MODE: _remote_mode,
        Operation.EOS_SET_EVENT_MODE: _event_mode,
        Operation.EOS_GET_EVENT: _get_event,
        Operation.EOS_TRANSFER_COMPLETE: _transfer_complete,
        Operation.EOS_CANCEL_TRANSFER: _transfer_complete,
        Operation.EOS_PC_HDD_CAPACITY: _pc_capacity,
        Operation.EOS_SET_UI_LOCK: _set_lock,
        Operation.EOS_RESET_UI_LOCK: _set_lock,
        Operation.EOS_KEEP_DEVICE_ON: _keep_on,
        Operation.EOS_REMOTE_RELEASE: _remote_release,
        Operation.EOS_BULB_START: _bulb_start,
        Operation.EOS_BULB_END: _bulb_end,
        Operation.EOS_REMOTE_RELEASE_ON: _release_on,
        Operation.EOS_REMOTE_RELEASE_OFF: _release_off,
        Operation.EOS_GET_VIEW_FINDER_DATA: _view_finder,
    }
