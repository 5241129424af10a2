"""The RAW files of one run, on the disk or in memory alone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pdcd.files.reading import MAX_RAW_BYTES, read_file, refuse_unsound
from pdcd.sensor.raw import RawFrame, RawHead, read_raw, read_raw_head


class PhotoShelf:
    """The RAW files of one run, by their paths below its folder.

    The bytes of photos whose files are not kept are held here, and read as the files would be.
    Paths are those of the run's record; digests are those that the files have, or would have.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._held: dict[str, bytes] = {}

    def hold(self, raw: str, data: bytes | None) -> None:
        """Read this photo from these bytes from now on; None: from its file."""
        if data is None:
            self._held.pop(raw, None)
        else:
            self._held[raw] = data

    def held(self, raw: str) -> bytes | None:
        """The bytes that this photo is read from; None where it is read from its file."""
        return self._held.get(raw)

    def list_all(self) -> Iterator[tuple[str, bytes]]:
        """Every photo that is there, held or in the folder, by its path. Raises DecodeError."""
        yield from self._held.items()
        for path in sorted((self._folder / "raw").glob("*")):
            name = f"raw/{path.name}"
            if name not in self._held:
                with refuse_unsound(path):
                    yield name, read_file(path, MAX_RAW_BYTES)

    def read(
        self,
        raw: str,
        *,
        sha256: str | None = None,
        size_bytes: int | None = None,
        saturation_dn: float | None = None,
    ) -> RawFrame:
        """`read_raw` for this photo. Raises DecodeError."""
        return read_raw(
            self._folder / raw,
            sha256=sha256,
            size_bytes=size_bytes,
            saturation_dn=saturation_dn,
            data=self._held.get(raw),
        )

    def read_head(self, raw: str, *, sha256: str | None = None) -> RawHead:
        """`read_raw_head` for this photo. Raises DecodeError."""
        return read_raw_head(self._folder / raw, sha256=sha256, data=self._held.get(raw))
