"""codes.npz from somebody else: damaged, or far larger than it looks."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from pdcd.errors import DecodeError
from pdcd.runs import patterns
from pdcd.runs.patterns import CODES_FILE, read_patterns


def _npy(shape: str, data: bytes) -> bytes:
    header = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + data


def _zip(path: Path, members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> None:
    with zipfile.ZipFile(path / CODES_FILE, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def test_what_numpy_wrote_comes_back(tmp_path: Path) -> None:
    bits = np.arange(12, dtype=np.uint8).reshape(3, 4)
    levels = np.linspace(0, 1, 5, dtype=np.float32)
    with (tmp_path / CODES_FILE).open("wb") as file:
        np.savez_compressed(file, bits=bits, levels=levels)
    found = read_patterns(tmp_path)
    assert found.keys() == {"bits", "levels"}
    np.testing.assert_array_equal(found["bits"], bits)
    assert found["levels"].dtype == np.float32


def test_a_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patterns, "MAX_CODES_BYTES", 2**20)
    _zip(tmp_path, {"a.npy": _npy("(2000000,)", bytes(2_000_000))})
    assert (tmp_path / CODES_FILE).stat().st_size < 10_000
    with pytest.raises(DecodeError, match="more than 1048576 bytes"):
        read_patterns(tmp_path)


def test_a_shape_beyond_its_bytes_takes_no_memory(tmp_path: Path) -> None:
    _zip(tmp_path, {"a.npy": _npy("(1099511627776,)", b"short")})
    with pytest.raises(DecodeError, match="an array of the shape"):
        read_patterns(tmp_path)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"PK",
        _npy("(3,)", b"abc"),
        _npy("(3, 'x')", b"abc"),
        np.lib.format.magic(3, 0) + bytes(20),
    ],
)
def test_damage_is_a_typed_error(tmp_path: Path, data: bytes) -> None:
    """As the file itself, and as a member of it."""
    (tmp_path / CODES_FILE).write_bytes(data)
    with pytest.raises(DecodeError, match=r"codes\.npz"):
        read_patterns(tmp_path)
    _zip(tmp_path, {"a.npy": data[:-1]})
    with pytest.raises(DecodeError, match=r"codes\.npz"):
        read_patterns(tmp_path)


def test_objects_are_not_read(tmp_path: Path) -> None:
    data = io.BytesIO()
    np.save(data, np.array([{}]), allow_pickle=True)
    _zip(tmp_path, {"a.npy": data.getvalue()})
    with pytest.raises(DecodeError, match="cannot read"):
        read_patterns(tmp_path)
