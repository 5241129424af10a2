"""Where photos of a run are read: files below its folder, or bytes that never were on a disk."""

from __future__ import annotations

from pathlib import Path

from pdcd.sensor.raw import RawFrame, RawHead, read_raw, read_raw_head


class PhotoShelf:
    """The RAW files of one run by their paths below its folder.

    Whoever takes photos that are not kept holds their bytes here: they are read as the files would
    be. Paths are those of the run's record; digests are those that the files had, or would have.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._held: dict[str, bytes] = {}

    def hold(self, raw: str, data: bytes | None) -> None:
        """Read that photo from these bytes from now on; None: from its file."""
        if data is None:
            self._held.pop(raw, None)
        else:
            self._held[raw] = data

    def read(
        self,
        raw: str,
        *,
        sha256: str | None = None,
        size_bytes: int | None = None,
        saturation_dn: float | None = None,
    ) -> RawFrame:
        """As `read_raw`, of that photo. Raises DecodeError."""
        return read_raw(
            self._folder / raw,
            sha256=sha256,
            size_bytes=size_bytes,
            saturation_dn=saturation_dn,
            data=self._held.get(raw),
        )

    def read_head(self, raw: str, *, sha256: str | None = None) -> RawHead:
        """As `read_raw_head`, of that photo. Raises DecodeError."""
        return read_raw_head(self._folder / raw, sha256=sha256, data=self._held.get(raw))
