"""Arrays that came with a request: which they are, how they are read, and what is noted of them."""

from __future__ import annotations

import base64
import hashlib
import io
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.errors import Cancelled, RequestError
from pdcd.files.opening import ArrayLimits, UnsoundFileError
from pdcd.planning.given import (
    KEPT_NUMBERS,
    FileSource,
    find_long_fields,
    list_file_fields,
    make_descriptor_source,
    make_text_source,
    read_request_arrays,
)
from pdcd.planning.prior import PRIOR_GRID
from pdcd.protocol.request import CaptureRequest
from tests.bench_rig import from_path

LIMITS = ArrayLimits(100)


def npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, np.asarray(array))
    return file.getvalue()


@pytest.mark.parametrize(
    ("fields", "files"),
    [
        ({}, {}),
        ({"prior": "decay:3"}, {}),
        ({"prior": "scene:wax-disk"}, {}),
        ({"prior": "t.npz"}, {"prior": "t.npz"}),
        ({"illumination": "a.npy", "kernel": ((1.0,),)}, {"illumination": "a.npy"}),
    ],
)
def test_what_comes_as_a_file_is_told_from_words_and_rows(
    fields: dict[str, Any], files: dict[str, str]
) -> None:
    assert list_file_fields(CaptureRequest(goal="white", **fields)) == files


def test_long_rows_become_an_array_at_once() -> None:
    most = ((1.0,) * 64,) * (KEPT_NUMBERS // 64)
    assert find_long_fields(CaptureRequest(goal="relit", matrix=most)) == {}
    more = (*most[:-1], (1.0,) * 65)
    request = CaptureRequest(goal="relit", matrix=more)
    assert find_long_fields(request) == {"matrix": KEPT_NUMBERS + 1}
    assert find_long_fields(CaptureRequest(goal="relit", matrix="a.npy")) == {}
    square = tuple((0.5,) * 65 for _ in range(65))
    read, arrays = read_request_arrays(CaptureRequest(goal="relit", matrix=square), {}, (5, 13))
    assert np.array_equal(arrays["matrix"], square)
    noted: Any = read.matrix
    assert noted.sha256 == hashlib.sha256(arrays["matrix"].tobytes()).hexdigest()
    assert noted.file is None


def test_a_file_is_read_from_wherever_it_is_and_noted_by_its_digest(tmp_path: Path) -> None:
    plane = np.arange(6.0).reshape(2, 3)
    data = npy(plane)
    (tmp_path / "a.npy").write_bytes(data)
    descriptor = os.open(tmp_path / "a.npy", os.O_RDONLY)
    try:
        for source, name in (
            (make_descriptor_source(descriptor, "x.npy"), "x.npy"),
            (from_path(tmp_path / "a.npy"), "a.npy"),
            (make_text_source(base64.b64encode(data).decode(), "t"), "t"),
            (make_text_source(base64.b64encode(data).decode()), None),
        ):
            request = CaptureRequest(goal="illuminated", seed=5)
            read, arrays = read_request_arrays(request, {"illumination": source}, (2, 3))
            assert np.array_equal(arrays["illumination"], plane) and read.seed == 5
            noted: Any = read.illumination
            assert (noted.file, noted.sha256) == (name, hashlib.sha256(data).hexdigest())
    finally:
        os.close(descriptor)


def test_a_prior_comes_with_the_grid_of_its_own() -> None:
    matrix = np.random.default_rng(0).random((6, 6))
    file = io.BytesIO()
    np.savez(file, transport=matrix, grid=np.array((2, 3)))
    source = FileSource(lambda limits: file.getvalue(), "t.npz")
    read, arrays = read_request_arrays(CaptureRequest(goal="indirect"), {"prior": source}, (2, 3))
    assert arrays[PRIOR_GRID].tolist() == [[2.0, 3.0]] and arrays["prior"].size >= 36
    assert read.prior is not None and not isinstance(read.prior, str)


def test_what_is_wrong_with_a_file_is_told_with_its_name() -> None:
    with pytest.raises(UnsoundFileError, match="not base64"):
        make_text_source("é?").content(LIMITS)
    with pytest.raises(UnsoundFileError, match="not base64"):
        make_text_source("YWJj\n").content(LIMITS)  # it is all or nothing
    for name, words in (("a.npy", r"kernel \(a\.npy\): it is"), (None, "kernel: it is")):
        source = FileSource(lambda limits: b"nothing", name)
        with pytest.raises(RequestError, match=words) as caught:
            read_request_arrays(CaptureRequest(goal="filtered"), {"kernel": source}, (2, 3))
        assert caught.value.hint


def test_whoever_waits_may_end_the_reading_and_files_are_closed(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(npy(np.ones((2, 3))))
    fds = len(list(Path("/proc/self/fd").iterdir()))

    def unwanted() -> None:
        raise Cancelled("nobody waits")

    with pytest.raises(Cancelled):
        read_request_arrays(
            CaptureRequest(goal="illuminated"),
            {"illumination": from_path(tmp_path / "a.npy")},
            (2, 3),
            unwanted,
        )
    assert len(list(Path("/proc/self/fd").iterdir())) == fds
