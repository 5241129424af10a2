"""Readers take damage of a file for damage, and faults that are not the file's for nothing else."""

from __future__ import annotations

import io
import zipfile
import zlib
from typing import Any

import cv2
import numpy as np
import pytest

from pdcd.files import arrays as png
from pdcd.files.arrays import check_finite, list_members, read_array, read_npy, read_npz
from pdcd.files.opening import ArrayLimits, UnsoundFileError
from tests.hostile import files

LIMITS = ArrayLimits(1000)
ONE = files.npy(np.ones((2, 3)))


class OurError(LookupError):
    """A fault of the program, or of who asked whether anybody still waits."""


def fails(*_: Any, **__: Any) -> Any:
    raise OurError


def packed(**arrays: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in arrays.items():
            archive.writestr(f"{name}.npy", data)
    return stream.getvalue()


def picture() -> bytes:
    done, data = cv2.imencode(".png", np.arange(6, dtype=np.uint8).reshape(2, 3))
    assert done
    return data.tobytes()


@pytest.mark.parametrize("data", [ONE, packed(kernel=ONE), picture()])
def test_who_no_longer_waits_ends_any_reader(data: bytes) -> None:
    with pytest.raises(OurError):
        read_array(data, "kernel", ArrayLimits(1000, fails))
    assert read_array(data, "kernel", LIMITS).shape == (2, 3)


def test_an_archive_that_fails_otherwise_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    data = packed(a=ONE)
    monkeypatch.setattr(zipfile.ZipFile, "infolist", fails)
    with pytest.raises(OurError):
        list_members(data)
    with pytest.raises(OurError):
        read_npz(data, {"a": LIMITS})


def test_a_decoder_that_fails_otherwise_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "imdecode", fails)
    with pytest.raises(OurError):
        read_array(picture(), "x", LIMITS)


@pytest.mark.parametrize(
    "fault",
    [ValueError("bad"), EOFError("bad"), KeyError("bad"), MemoryError("bad"), OverflowError("bad"),
     RuntimeError("bad"), OSError("bad"), zipfile.BadZipFile("bad"), TypeError("bad")],
)  # fmt: skip
def test_what_numpy_and_zipfile_raise_is_damage(
    monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    def breaks(*_: Any, **__: Any) -> Any:
        raise fault

    data = packed(a=ONE)
    with monkeypatch.context() as patch:
        patch.setattr(np, "frombuffer", breaks)
        with pytest.raises(UnsoundFileError, match=r"^it is damaged: .*bad"):
            read_npy(ONE, LIMITS)
        with pytest.raises(UnsoundFileError, match=r"^`a`: it is damaged: .*bad") as caught:
            read_npz(data, {"a": LIMITS})
        assert caught.value.hint.startswith("write it again with numpy.save")
    monkeypatch.setattr(zipfile.ZipFile, "infolist", breaks)
    for read in (lambda: list_members(data), lambda: read_npz(data, {"a": LIMITS})):
        with pytest.raises(UnsoundFileError, match=r"^it is damaged: .*bad"):
            read()


def test_damage_is_told_in_a_short_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for words, told in (("a\n b  c", "a b c"), ("x" * 500, "x" * 120), ("", "ValueError")):

        def breaks(*_: Any, words: str = words, **__: Any) -> Any:
            raise ValueError(words)

        monkeypatch.setattr(np, "frombuffer", breaks)
        with pytest.raises(UnsoundFileError) as caught:
            read_npy(ONE, LIMITS)
        assert caught.value.message == f"it is damaged: {told}"


@pytest.mark.parametrize(
    ("array", "count", "first"),
    [([[1.0, np.nan], [np.inf, 2.0]], 2, "0, 1"), ([1.0, 2.0, -np.inf], 1, "2")],
)
def test_values_that_are_not_finite_are_counted(array: Any, count: int, first: str) -> None:
    with pytest.raises(UnsoundFileError) as caught:
        check_finite(np.array(array))
    assert caught.value.message == (
        f"it has {count} values that are not finite, the first at ({first})"
    )
    check_finite(np.array([[0.0, -1e308]]))


def test_numbers_that_float64_cannot_hold_are_infinite_without_a_warning() -> None:
    large = np.array([[np.longdouble("1e4000"), 1.0]])
    with pytest.raises(UnsoundFileError, match="it has 1 values that are not finite"):
        read_npy(files.npy(large), LIMITS)


def test_numbers_that_only_look_finite_in_float64_are_read() -> None:
    found = read_npy(files.npy(np.array([[65504.0]], np.float16)), LIMITS)
    assert found.tolist() == [[65504.0]]


def test_a_picture_has_16_million_pixels_at_most() -> None:
    assert png.MAX_PIXELS == 4096 * 4096
    sides = (2**13).to_bytes(4, "big") + (2**12).to_bytes(4, "big")
    head = picture()[:16] + sides + picture()[24:29]
    data = head + zlib.crc32(head[12:]).to_bytes(4, "big") + picture()[33:]
    with pytest.raises(UnsoundFileError, match="4096 x 8192; at most 16777216 numbers"):
        read_array(data, "x", ArrayLimits(2**30))
