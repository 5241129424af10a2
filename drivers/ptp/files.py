"""From the event that announces a photo to a file on disk that is known to be whole.

A photo counts when its size is the one announced, its first bytes are those of a RAW file, and a
second reading gives the same bytes. Damage by the camera itself, at the right size, cannot be
noticed here; the SHA-256 that is returned guards against any later damage.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from pathlib import Path

from pdcd.driver import ExposureError, RawFile

from .codes import ObjectFormat, Operation, ResponseCode, format_code
from .eos import EosCamera
from .events import ObjectAdded
from .faults import DEVICE
from .transport import BLOCK_B

logger = logging.getLogger(__name__)

_SUFFIXES = frozenset({".cr2", ".cr3", ".crw", ".dng"})
_FORMATS: dict[int, str] = {ObjectFormat.CANON_CR2: ".cr2", ObjectFormat.CANON_CRW: ".crw"}
_TIFF = (b"II*\0", b"MM\0*")
_CRW = b"II\x1a\0"
_CR3 = b"ftypcrx "
_HEAD_B = 12
_POLL_S = 0.1


def wait_for_photo(camera: EosCamera, until_ns: int) -> ObjectAdded | None:
    """The oldest RAW file that waits in the camera; None when none came by that time.

    Other files (a JPEG beside the RAW) are thrown away.
    """
    while True:
        with camera.session.hold():
            camera.poll()
            while camera.files:
                photo = camera.files.popleft()
                if suffix_of(photo) is not None:
                    return photo
                logger.warning("not a RAW file, thrown away name=%s", photo.name)
                camera.discard(photo)
        if camera.clock.now_ns() >= until_ns:
            return None
        camera.pause(_POLL_S)


def suffix_of(photo: ObjectAdded) -> str | None:
    """File suffix of a RAW file, with its dot, in lower case; None for other files."""
    suffix = Path(photo.name).suffix.lower()
    if suffix in _SUFFIXES:
        return suffix
    return None if suffix else _FORMATS.get(photo.format)


def store_photo(
    camera: EosCamera, photo: ObjectAdded, path: Path, *, twice: bool = True
) -> RawFile | None:
    """Store a photo as `path`, complete or not at all, and free the camera's memory of it.

    With `twice` it is read a second time and compared.

    Returns None when the camera knows no such object: its event was repeated, or came late.
    Raises ExposureError when the photo is not whole, OSError when the disk refuses.
    """
    if photo.size_bytes > camera.most_photo_bytes:
        raise ExposureError(
            f"the camera says that {photo.name} has {photo.size_bytes} bytes, and a photo of its "
            f"sensor has {camera.most_photo_bytes} at most",
            device=DEVICE,
            hint="take it again; is camera.profile that of this body?",
        )
    part = path.with_name(path.name + ".part")
    try:
        with camera.session.hold(), part.open("xb") as file:
            digest = _copy(camera, photo, file.write)
            if digest is None:
                return None
            if twice and _copy(camera, photo, _nowhere) != digest:
                raise _spoiled(photo, "a second reading differs")
            camera.discard(photo)
        part.rename(path)
    finally:
        part.unlink(missing_ok=True)
    return RawFile(path, photo.size_bytes, digest)


def _copy(
    camera: EosCamera, photo: ObjectAdded, write: Callable[[memoryview], object]
) -> str | None:
    """Pass all bytes to `write`, block by block; returns their SHA-256, None for an unknown
    object."""
    info, renewed = camera.session.info, camera.session.renewed
    standard = info is not None and info.supports(Operation.GET_PARTIAL_OBJECT)
    read = Operation.GET_PARTIAL_OBJECT if standard else Operation.EOS_GET_PARTIAL_OBJECT
    digest, at = hashlib.sha256(), 0
    while at < photo.size_bytes:
        want = min(BLOCK_B, photo.size_bytes - at)
        camera.patience.look()  # a large photo on a slow bus takes minutes
        reply = camera.order(read, photo.handle, at, want)
        if camera.session.renewed != renewed:
            raise _spoiled(photo, "the connection was lost meanwhile")
        if reply.code == ResponseCode.INVALID_OBJECT_HANDLE and at == 0:
            return None
        if reply.code != ResponseCode.OK:
            raise _spoiled(photo, f"refused at byte {at}: {format_code(reply.code, ResponseCode)}")
        if not 0 < len(reply.data) <= want:
            raise _spoiled(photo, f"{len(reply.data)} bytes came at byte {at}, not {want}")
        if at == 0 and not _is_raw(bytes(reply.data[:_HEAD_B])):
            raise _spoiled(photo, "it does not begin as a RAW file does")
        digest.update(reply.data)
        write(reply.data)
        at += len(reply.data)
    if at == 0:
        raise _spoiled(photo, "it is empty")
    return digest.hexdigest()


def _nowhere(block: memoryview) -> None:
    """Drop a block: the second reading is only compared."""


def _is_raw(head: bytes) -> bool:
    return head.startswith((*_TIFF, _CRW)) or head[4:] == _CR3


def _spoiled(photo: ObjectAdded, why: str) -> ExposureError:
    return ExposureError(
        f"the photo {photo.name} of {photo.size_bytes} bytes did not come whole: {why}",
        device=DEVICE,
        hint="take it again",
    )
