"""Arrays that somebody else wrote: what is read of them, and what is refused before it costs."""

from __future__ import annotations

import io
import random
import tracemalloc
import zipfile
from typing import Any

import cv2
import numpy as np
import pytest

from pdcd.files import arrays
from pdcd.files.arrays import list_members, read_array, read_npy, read_npz
from pdcd.files.opening import ArrayLimits, UnsoundFileError
from tests.hostile import files

LIMITS = ArrayLimits(1000)
ONE = files.npy(np.ones((2, 3)))


def npz(packing: int = zipfile.ZIP_STORED, **members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", packing) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return stream.getvalue()


def refused(data: bytes, limits: ArrayLimits = LIMITS, name: str = "kernel") -> str:
    with pytest.raises(UnsoundFileError) as caught:
        read_array(data, name, limits)
    assert caught.value.hint
    return caught.value.message


@pytest.mark.parametrize("dtype", ["f8", "f4", "f2", ">f8", ">i2", "u8", "i1", "?", "g"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_real_numbers_of_any_type_and_order_are_read(dtype: str, order: Any) -> None:
    array = np.array([[1, 0, 1], [0, 1, 1]], dtype=dtype, order=order)
    data = files.npy(array)
    packed = npz(zipfile.ZIP_DEFLATED, kernel=data, other=ONE)
    for stored in (data, packed, npz(only=data)):
        found = read_array(stored, "kernel", LIMITS)
        assert found.dtype == np.float64 and found.flags.c_contiguous
        np.testing.assert_array_equal(found, array.astype(float))


def test_headers_of_both_versions_and_any_order_are_read() -> None:
    numbers = np.arange(6.0).reshape(2, 3)
    flat, turned = numbers.tobytes(), numbers.tobytes("F")
    for version in (1, 2):
        for text, data in (
            ("{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3), }", flat),
            ("{'shape': (2,3), 'descr': '<f8', 'fortran_order': True}", turned),
            ('{"fortran_order":False,"shape":( 2 , 3 ),"descr":"float64"}', flat),
        ):
            made = files.raw_npy(text + "\n", data, version)
            np.testing.assert_array_equal(read_npy(made, LIMITS), numbers)


@pytest.mark.parametrize("dtype", ["c16", "c8", "O", "S4", "U4", "V8", "M8[s]", "m8[s]", "f4,i4"])
def test_what_is_no_real_number_is_refused(dtype: str) -> None:
    assert "real numbers" in refused(files.npy(np.zeros((3, 4), dtype=dtype)))


def test_a_pickle_is_never_loaded() -> None:
    class Armed:
        def __reduce__(self) -> tuple[Any, ...]:
            return (pytest.fail, ("the pickle was loaded",))

    assert "object" in refused(files.npy(np.array([[Armed()]], dtype=object)))


@pytest.mark.parametrize(
    ("array", "what"),
    [
        (np.float64(1.0), "0 dimensions"),
        (np.ones(12), "1 dimensions"),
        (np.ones((3, 4, 1)), "3 dimensions"),
        (np.full((3, 4), np.nan), "it has 12 values that are not finite, the first at (0, 0)"),
        (np.array([[0.0, -np.inf]]), "it has 1 values that are not finite, the first at (0, 1)"),
        (np.full((3, 4), np.longdouble("1e4000")), "not finite"),
    ],
)
def test_shapes_and_values_that_mean_nothing_are_refused(array: Any, what: str) -> None:
    assert what in refused(files.npy(array))


@pytest.mark.parametrize(
    ("shape", "count", "words"),
    [
        ((), 1, ""),
        ((1000,), 1000, ""),
        ((10, 100), 1000, ""),
        ((1001,), 0, "the shape 1001; at most 1000 numbers"),
        ((7, 143), 0, "7 x 143; at most"),
        ((0,), 0, "the shape 0, which holds no number"),
        ((5, 0), 0, "5 x 0, which holds no number"),
        ((10**12, 2), 0, "more than 10^12 x 2;"),
        ((2,) * 11, 0, "2 x 2 x 2 x 2 x 2 x 2 x 2 x 2 ...;"),
        ((4,) * 8, 0, "4 x 4 x 4 x 4 x 4 x 4 x 4 x 4;"),
    ],
)
def test_a_shape_has_numbers_and_not_too_many(
    shape: tuple[int, ...], count: int, words: str
) -> None:
    if count:
        assert LIMITS.check(shape) == count
        return
    with pytest.raises(UnsoundFileError) as caught:
        LIMITS.check(shape)
    assert words in caught.value.message


@pytest.mark.parametrize("shape", files.SHAPES)
def test_a_shape_that_the_file_does_not_hold_costs_nothing(shape: tuple[int, ...]) -> None:
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {files._text(shape)}, }}\n"
    data = files.raw_npy(text, bytes(40))
    tracemalloc.start()
    refused(data, ArrayLimits(2**30))
    assert tracemalloc.get_traced_memory()[1] < 2**21
    tracemalloc.stop()


@pytest.mark.parametrize(
    "header",
    [
        *files.HEADERS,
        "{'descr': '<f8', 'descr': '<f8', 'shape': (2, 3)}",
        "{'descr': 'xx', 'fortran_order': False, 'shape': (2, 3)}",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3)} 1",
    ],
)
@pytest.mark.parametrize("version", [1, 2, 3])
def test_a_damaged_header_is_refused(header: str, version: int) -> None:
    refused(files.raw_npy(header + "\n", bytes(96), version))


def test_a_header_is_of_so_many_letters_at_most() -> None:
    fits = "{'descr': '<f8', 'fortran_order': False, 'shape': (1, 1), }".ljust(2048)
    assert read_array(files.raw_npy(fits, bytes(8)), "x", LIMITS).shape == (1, 1)
    assert "2049 characters" in refused(files.raw_npy(fits + " ", bytes(8), 2))
    assert "version 1.0 or 2.0" in refused(b"\x93NUMPY\x01")


@pytest.mark.parametrize("filler", [" ", "1 ,", "1, ", "' ", '"', "''", "(", ": '", "9", "a "])
def test_the_time_of_a_header_grows_as_its_length_does(
    filler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of 300 kB: where it grew as the square, the six would take minutes."""
    monkeypatch.setattr(arrays, "_MAX_HEADER", 10**6)
    sound = "{'descr': '<f8', 'fortran_order': False, 'shape': (1, 1)"
    for end in (0, 1, 20, 45, 53, len(sound)):
        begun = sound[:end] + filler * (300_000 // len(filler))
        assert "not that of real" in refused(files.raw_npy(begun + "x", bytes(8), 2))


def test_an_array_ends_where_its_shape_says() -> None:
    assert "ends after 47 of 48 bytes" in refused(ONE[:-1])
    assert "more bytes follow" in refused(ONE + b"\0")
    for spoilt, words in ((ONE[:-1], "ends after 47"), (ONE[:-50], "ends after 0")):
        with pytest.raises(UnsoundFileError, match=words) as caught:
            read_npz(npz(a=spoilt), {"a": LIMITS})
        assert caught.value.message.startswith("`a`: it")


@pytest.mark.parametrize("packing", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_archives_of_one_to_64_arrays_are_read(packing: int) -> None:
    one = files.npy(np.ones((1, 1)))
    names = [f"a{n}" for n in range(64)]
    data = npz(packing, **dict.fromkeys(names, one))
    assert list_members(data) == tuple(names)
    assert [*read_npz(data, {"a63": LIMITS, "a0": LIMITS})] == ["a63", "a0"]
    with pytest.raises(UnsoundFileError, match="it holds no b and no c") as caught:
        read_npz(data, {"a0": LIMITS, "b": LIMITS, "c": LIMITS})
    assert caught.value.hint == "store a0, b, c with numpy.savez"
    with pytest.raises(UnsoundFileError, match="65 arrays"):
        list_members(npz(packing, **dict.fromkeys([*names, "b"], one)))
    with pytest.raises(UnsoundFileError, match="0 arrays"):
        list_members(npz())


def test_each_array_has_a_limit_of_its_own() -> None:
    data = npz(a=files.npy(np.ones((2, 2))), b=ONE)
    assert len(read_npz(data, {"a": ArrayLimits(4), "b": ArrayLimits(6)})) == 2
    with pytest.raises(UnsoundFileError, match="`b`: it has the shape 2 x 3; at most 5"):
        read_npz(data, {"a": ArrayLimits(4), "b": ArrayLimits(5)})


def test_of_several_arrays_that_of_the_field_is_taken() -> None:
    data = npz(kernel=files.npy(np.eye(3)), other=files.npy(np.ones((3, 3))))
    np.testing.assert_array_equal(read_array(data, "kernel", LIMITS), np.eye(3))
    assert "none of which is called warp" in refused(data, name="warp")


def test_what_no_archive_of_numpy_has_is_refused() -> None:
    good = npz(a=files.npy(np.ones((1, 1))))
    assert list_members(good) == ("a",)
    for spoilt in (good[:-1] + b"\x01", good + b"\0", good[-21:], b"PK\x03\x04", good[:-22]):
        with pytest.raises(UnsoundFileError, match=r"no \.npz file ends like that"):
            list_members(spoilt)
    locked = bytearray(good)
    locked[good.index(b"PK\x01\x02") + 8] |= 1
    with pytest.raises(UnsoundFileError, match="packed or locked"):
        list_members(bytes(locked))
    with pytest.raises(UnsoundFileError, match="it is damaged: "):
        list_members(good.replace(b"PK\x01\x02", b"PK\x01\x03"))
    behind = good[:-22] + b"PK\x06\x07" + bytes(16) + good[-22:]  # a larger directory
    assert "larger kind" in refused(behind)
    packed = bytearray(npz(zipfile.ZIP_DEFLATED, kernel=ONE))
    packed[len("PK..") + 26 + len("kernel.npy")] ^= 0xFF  # the first byte of what is packed
    assert "`kernel`: it is damaged: " in refused(bytes(packed))


def test_a_zip_bomb_is_refused_while_it_unpacks() -> None:
    data = files._bomb()
    tracemalloc.start()
    assert "more bytes follow" in refused(data, name="illumination")
    assert tracemalloc.get_traced_memory()[1] < 2**23
    tracemalloc.stop()


def test_a_directory_of_thousands_is_refused_unread() -> None:
    assert "too many" in refused(files._crowd())


@pytest.mark.parametrize("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_packings_that_cannot_be_bounded_are_refused(packing: int) -> None:
    assert "packed or locked" in refused(npz(packing, kernel=ONE))


@pytest.mark.parametrize(
    "data", [ONE, npz(kernel=ONE), cv2.imencode(".png", np.zeros((2, 3), np.uint8))[1].tobytes()]
)
def test_who_no_longer_waits_ends_any_reader(data: bytes) -> None:
    class NobodyWaitsError(LookupError):
        """Not the file's fault, though of a kind that damage raises."""

    def end() -> None:
        raise NobodyWaitsError

    with pytest.raises(NobodyWaitsError):
        read_array(data, "kernel", ArrayLimits(1000, end))
    assert read_array(data, "kernel", LIMITS).shape == (2, 3)


def test_whatever_the_bytes_are_an_array_or_a_refusal_comes_back() -> None:
    rng = random.Random(5)
    read = 0
    for _ in range(600):
        data = rng.choice([c for c in files.CONTENTS if c is not files.bomb])(rng, (3, 4))
        try:
            array = read_array(data, "illumination", LIMITS)
        except UnsoundFileError as err:
            assert err.hint and "\n" not in err.message and len(err.message) < 400
            continue
        assert array.ndim == 2 and array.dtype == np.float64 and np.isfinite(array).all()
        read += 1
    assert 50 < read < 500
