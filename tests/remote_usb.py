"""A virtual USB that other processes can use: what one of them holds is free when it dies.

`serve` lends a backend on a socket; `RemoteUsb` is that backend elsewhere. As the kernel does,
the server closes the devices that a connection had open when it ends.
"""

from __future__ import annotations

import array
import threading
from contextlib import suppress
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import TYPE_CHECKING, Any

import usb.backend
import usb.core

if TYPE_CHECKING:
    # It brings the mock bench and half of scipy, which no borrower needs.
    from drivers.virtual_camera import VirtualUsb

PLAIN = (
    "get_parent", "get_device_descriptor", "get_configuration_descriptor",
    "get_interface_descriptor", "get_endpoint_descriptor", "open_device", "close_device",
    "get_configuration", "set_configuration", "set_interface_altsetting", "claim_interface",
    "release_interface", "is_kernel_driver_active", "detach_kernel_driver",
    "attach_kernel_driver", "clear_halt", "reset_device", "bulk_write",
)  # fmt: skip
FILLING = ("bulk_read", "intr_read", "ctrl_transfer")
"""Methods that fill the array among their arguments."""


class RemoteUsb(usb.backend.IBackend):  # type: ignore[misc]  # pyusb has no types
    """The backend that is served at that address."""

    def __init__(self, address: Path) -> None:
        super().__init__()
        self._connection: Connection = Client(str(address))
        self._lock = threading.Lock()

    def enumerate_devices(self) -> Any:
        """All at once."""
        return iter(self._ask("enumerate_devices", ()))

    def _ask(self, name: str, args: tuple[Any, ...]) -> Any:
        with self._lock:
            self._connection.send((name, args))
            answer, fault = self._connection.recv()
        if fault is not None:
            timed_out, *words = fault
            raise (usb.core.USBTimeoutError if timed_out else usb.core.USBError)(*words)
        return answer


def _forwarded(name: str) -> Any:
    def call(self: RemoteUsb, *args: Any) -> Any:
        return self._ask(name, args)

    return call


def _filled(name: str) -> Any:
    def call(self: RemoteUsb, *args: Any) -> int:
        buffer = next(arg for arg in args if isinstance(arg, array.array))
        count, data = self._ask(name, args)
        memoryview(buffer).cast("B")[: len(data)] = data
        return int(count)

    return call


for _name in PLAIN:
    setattr(RemoteUsb, _name, _forwarded(_name))
for _name in FILLING:
    setattr(RemoteUsb, _name, _filled(_name))


def serve(usb_here: VirtualUsb, address: Path) -> Listener:
    """Lend a backend at that address until the listener is closed."""
    listener = Listener(str(address))

    def accept() -> None:
        with suppress(OSError):  # the listener was closed
            while True:
                connection = listener.accept()
                threading.Thread(target=_lend, args=(usb_here, connection), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    return listener


def _lend(usb_here: VirtualUsb, connection: Connection) -> None:
    handles: dict[int, Any] = {}
    with connection, suppress(EOFError, ConnectionError):
        while True:
            name, args = connection.recv()
            args = tuple(handles[arg.number] if isinstance(arg, _Handle) else arg for arg in args)
            try:
                answer = getattr(usb_here, name)(*args)
            except usb.core.USBError as err:
                timed_out = isinstance(err, usb.core.USBTimeoutError)
                fault = (timed_out, err.strerror, err.backend_error_code, err.errno)
                connection.send((None, fault))
                continue
            if name == "enumerate_devices":
                answer = list(answer)
            elif name == "open_device":
                handles[len(handles)] = answer
                answer = _Handle(len(handles) - 1)
            elif name in FILLING:
                buffer = next(arg for arg in args if isinstance(arg, array.array))
                answer = answer, buffer.tobytes()
            connection.send((answer, None))
    for handle in handles.values():
        usb_here.close_device(handle)


class _Handle:
    """An opened device, by its number with this connection."""

    def __init__(self, number: int) -> None:
        self.number = number
