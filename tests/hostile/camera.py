"""A camera on a USB that means harm, in one mood after another; its shutter does what it is told.

It may be honest again at any time, and knows nothing then of what it did.
"""

from __future__ import annotations

import array
import itertools
import threading
from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Any

import usb.core

from drivers.ptp.codes import Operation, ResponseCode
from drivers.ptp.events import ObjectAdded, PropValue, pack_events
from drivers.virtual_camera import CameraBody, VirtualUsb
from drivers.virtual_camera.reply import CameraReply

DRIP_S, PACKET_B = 0.15, 512
ENDS = frozenset({Operation.EOS_BULB_END, Operation.EOS_REMOTE_RELEASE_OFF})
MUTE = CameraReply(fault="mute")
BUSY = CameraReply(ResponseCode.DEVICE_BUSY)
REFUSED = CameraReply(ResponseCode.GENERAL_ERROR)
_NUMBERS = itertools.count(0x10000)


def _long_list(photos: bool) -> bytes:
    """Photos, or settings, that nobody has heard of yet: as many as there may be in one list."""
    numbers = itertools.islice(_NUMBERS, 250 if photos else 4000)
    if photos:
        return pack_events(ObjectAdded(n, 0x3801, 9, "IMG_1.JPG", on_card=True) for n in numbers)
    return pack_events(PropValue.of(n, 1) for n in numbers)


def _answer_lists(code: int, p: tuple[int, ...]) -> CameraReply | None:
    if code != Operation.EOS_GET_EVENT:
        return None
    number = next(_NUMBERS)
    return CameraReply(data=bytes(3 << 20) if number % 3 == 0 else _long_list(number % 2 == 0))


def _answer_huge(code: int, p: tuple[int, ...]) -> CameraReply | None:
    if code != Operation.EOS_GET_EVENT:
        return None
    photo = ObjectAdded(next(_NUMBERS), 0xB103, 0xFFFFFFFF, "IMG_1.CR2", on_card=False)
    return CameraReply(data=pack_events([photo]))


def _answer_bytes(code: int, p: tuple[int, ...]) -> CameraReply | None:
    """A photo of 20 MB, of which a byte comes at a time."""
    if code == Operation.EOS_GET_EVENT:
        photo = ObjectAdded(next(_NUMBERS), 0xB103, 20_000_000, "IMG_1.CR2", on_card=False)
        return CameraReply(data=pack_events([photo]))
    if code in (Operation.GET_PARTIAL_OBJECT, Operation.EOS_GET_PARTIAL_OBJECT):
        return CameraReply(data=b"x" if p[1] else b"II*\0")
    return None


def _answer_with(reply: CameraReply) -> Callable[[int, tuple[int, ...]], CameraReply | None]:
    """Always that; what ends an exposure is done and told all the same."""
    return lambda code, _: None if code in ENDS else reply


MOODS: dict[str, Callable[[int, tuple[int, ...]], CameraReply | None]] = {
    "honest": lambda *_: None,
    "drips": lambda *_: None,
    "late": lambda *_: None,
    "silent": lambda *_: None,
    "long lists": _answer_lists,
    "4 GiB": _answer_huge,
    "a byte at a time": _answer_bytes,
    "busy": _answer_with(BUSY),
    "refuses": _answer_with(REFUSED),
}
"""By name: what is answered to an operation and its parameters instead of the truth."""


class HostileBody(CameraBody):
    """What it answers depends on its mood."""

    mood = "honest"

    def calm_down(self) -> None:
        """Be honest. Photos that were told of to nobody are gone, as if it had been switched off
        and on: else there would be no room for another."""
        self.mood = "honest"
        for handle in [h for h, stored in self.store.files.items() if not stored.on_card]:
            self.store.files.pop(handle, None)
        self._count_shots(tell=True)

    def transact(
        self, code: int, parameters: tuple[int, ...] = (), data: bytes = b""
    ) -> CameraReply:
        """The mood's answer, else the truth, which nobody hears of a silent one."""
        instead = MOODS[self.mood](code, (*parameters, 0, 0)[:2])
        if instead is not None:
            return instead
        reply = super().transact(code, parameters, data)
        return replace(reply, fault="mute") if self.mood == "silent" else reply


class HostileUsb(VirtualUsb):
    """And so does the way that its answers come: a packet at a time, or late."""

    def __init__(self, body: HostileBody) -> None:
        super().__init__(body)
        self._mood_of = body
        self.late_s = 3.0
        """What every answer takes in that mood."""
        self._due_ns = 0
        self._calm, self._rng = threading.Event(), Random(1)

    def provoke(self, on: bool) -> None:
        """Change the mood every few seconds from now on; or be honest, switched off and on."""
        self._calm.set()
        if on:
            self._calm = threading.Event()
            threading.Thread(target=self._go_on, args=(self._calm,), daemon=True).start()
            return
        with self._lock:
            self._mood_of.calm_down()
            self.body.unplug()
            self.body.replug()

    def _go_on(self, ended: threading.Event) -> None:
        rng = self._rng
        while not ended.wait(rng.uniform(0.1, 6.0)):
            self._mood_of.mood = rng.choice(sorted(MOODS))
            ended.wait(rng.uniform(0.1, 2.0))
            self._mood_of.calm_down()

    def bulk_write(
        self, dev_handle: Any, ep: int, intf: int, data: array.array[int], timeout: int
    ) -> int:
        """As ever; a late answer is due from here on."""
        late_s = self.late_s if self._mood_of.mood == "late" else 0.0
        self._due_ns = self.body.clock.now_ns() + round(late_s * 1e9)
        return super().bulk_write(dev_handle, ep, intf, data, timeout)

    def bulk_read(
        self, dev_handle: Any, ep: int, intf: int, buff: array.array[int], timeout: int
    ) -> int:
        """What has come by now."""
        clock = self.body.clock
        now_ns, patience_ns = clock.now_ns(), timeout * 1_000_000
        if self._due_ns > now_ns:
            clock.sleep_until_ns(min(self._due_ns, now_ns + patience_ns))
            if self._due_ns > now_ns + patience_ns:
                raise usb.core.USBTimeoutError("Operation timed out", -7, 110)
        if self._mood_of.mood != "drips":
            return super().bulk_read(dev_handle, ep, intf, buff, timeout)
        clock.sleep_until_ns(now_ns + min(round(DRIP_S * 1e9), patience_ns))
        packet = array.array("B", bytes(min(PACKET_B, len(buff))))
        count = super().bulk_read(dev_handle, ep, intf, packet, timeout)
        memoryview(buff).cast("B")[:count] = packet[:count]
        return count
