"""What can be read of the virtual camera: its card and memory, files, and standard properties."""

from __future__ import annotations

import struct
from collections.abc import Callable

from ..ptp.codes import EosEvent, Operation, ResponseCode
from ..ptp.datasets import pack_string, pack_u16s, pack_u32s
from .model import STORAGE, CameraModel
from .properties import Properties
from .reply import CameraReply, make_error_reply
from .shutter import FileStore

_P = tuple[int, ...]
_ALL_FORMATS = (0, 0xFFFFFFFF)


class ObjectReader:
    """The operations that read. handlers : of each, a function of its five parameters; none of them
    changes anything."""

    def __init__(self, store: FileStore, settings: Properties, model: CameraModel) -> None:
        self._store = store
        self._settings = settings
        self._model = model
        self.handlers: dict[int, Callable[[_P], CameraReply]] = {
            Operation.GET_STORAGE_IDS: self._storage_ids,
            Operation.EOS_GET_STORAGE_IDS: self._storage_ids,
            Operation.GET_STORAGE_INFO: self._storage_info,
            Operation.EOS_GET_STORAGE_INFO: self._storage_info,
            Operation.GET_NUM_OBJECTS: self._count,
            Operation.GET_OBJECT_HANDLES: self._handles,
            Operation.GET_OBJECT_INFO: self._object_info,
            Operation.EOS_GET_OBJECT_INFO_EX: self._object_info_ex,
            Operation.EOS_GET_DEVICE_INFO_EX: self._device_info_ex,
            Operation.GET_OBJECT: self._get_object,
            Operation.EOS_GET_OBJECT: self._get_object,
            Operation.GET_PARTIAL_OBJECT: self._get_partial,
            Operation.EOS_GET_PARTIAL_OBJECT: self._get_partial,
            Operation.GET_DEVICE_PROP_DESC: self._property_desc,
            Operation.GET_DEVICE_PROP_VALUE: self._property_value,
            0x9801: self._object_props,  # MTP: properties of objects, of which there are none
        }

    def _storage_ids(self, _p: _P) -> CameraReply:
        return CameraReply(data=pack_u32s((STORAGE,)))

    def _storage_info(self, p: _P) -> CameraReply:
        if p[0] != STORAGE:
            return make_error_reply(ResponseCode.INVALID_STORAGE_ID)
        # removable RAM, DCF, read and write; bytes in all, bytes free, photos free (unknown)
        fixed = struct.pack("<HHHQQI", 4, 3, 0, 2_059_010_048, 1_156_874_240, 0xFFFFFFFF)
        return CameraReply(data=fixed + pack_string("SD") + pack_string(""))

    def _handles(self, p: _P) -> CameraReply:
        return CameraReply(data=pack_u32s(self._listed(p)))

    def _count(self, p: _P) -> CameraReply:
        return CameraReply(ResponseCode.OK, (len(self._listed(p)),))

    def _listed(self, p: _P) -> list[int]:
        handles = self._store.children(p[2]) if p[2] else self._store.everything
        if p[1] in _ALL_FORMATS:
            return handles
        return [h for h in handles if (info := self._store.info(h)) and info.format == p[1]]

    def _object_info(self, p: _P) -> CameraReply:
        info = self._store.info(p[0])
        return (
            make_error_reply(ResponseCode.INVALID_OBJECT_HANDLE)
            if info is None
            else CameraReply(data=info.pack())
        )

    def _object_info_ex(self, p: _P) -> CameraReply:
        """Canon's listing of a folder: a count, then records of 56 bytes (see libgphoto2)."""
        packed = b""
        handles = self._store.children(p[1])
        for handle in handles:
            info = self._store.info(handle)
            if info is not None:
                packed += struct.pack(
                    "<IIIHHIIIII16sI", 56, handle, info.storage, info.format, 0, 0, 0,
                    info.size_bytes, info.parent, 0, info.name.encode("ascii"), 0,
                )  # fmt: skip
        return CameraReply(data=struct.pack("<I", len(handles)) + packed)

    def _device_info_ex(self, _p: _P) -> CameraReply:
        """Events, properties and one more list, all u32, behind the length of the whole."""
        events = (0xC101, *(code for code in EosEvent if code != EosEvent.END))
        lists = pack_u32s(events) + pack_u32s(sorted(self._settings.numbers)) + pack_u32s(())
        return CameraReply(data=struct.pack("<I", 4 + len(lists)) + lists)

    def _get_object(self, p: _P) -> CameraReply:
        stored = self._store.files.get(p[0])
        if stored is None:
            return make_error_reply(ResponseCode.INVALID_OBJECT_HANDLE)
        return CameraReply(data=memoryview(stored.data))

    def _get_partial(self, p: _P) -> CameraReply:
        stored = self._store.files.get(p[0])
        if stored is None:
            return make_error_reply(ResponseCode.INVALID_OBJECT_HANDLE)
        if p[1] > stored.info.size_bytes:
            return make_error_reply(ResponseCode.INVALID_PARAMETER)
        piece = memoryview(stored.data)[p[1] : p[1] + p[2]]
        return CameraReply(ResponseCode.OK, (len(piece),), piece)

    def _property_desc(self, p: _P) -> CameraReply:
        """The three standard properties that the body lists: name, a flag, the client's name."""
        texts = {0xD402: (self._model.info.model, 0), 0xD406: ("Unknown Initiator", 1)}
        if p[0] in texts:
            text, writable = texts[p[0]]
            packed = pack_string(text)
            head = struct.pack("<HHB", p[0], 0xFFFF, writable)
            return CameraReply(data=head + packed + packed + b"\0")
        if p[0] == 0xD407:
            return CameraReply(data=struct.pack("<HHBIIB", p[0], 6, 0, 1, 1, 0))
        return make_error_reply(ResponseCode.DEVICE_PROP_NOT_SUPPORTED)

    def _property_value(self, p: _P) -> CameraReply:
        if p[0] == 0xD402:
            return CameraReply(data=pack_string(self._model.info.model))
        if p[0] == 0xD406:
            return CameraReply(data=pack_string("Unknown Initiator"))
        if p[0] == 0xD407:
            return CameraReply(data=struct.pack("<I", 1))
        return make_error_reply(ResponseCode.DEVICE_PROP_NOT_SUPPORTED)

    def _object_props(self, _p: _P) -> CameraReply:
        return CameraReply(data=pack_u16s(()))
