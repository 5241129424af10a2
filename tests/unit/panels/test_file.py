"""Files and tables of maps: what is written comes back, what is not a map is refused in a line."""

from __future__ import annotations

import io
import os
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.reading import format_toml
from pdcd.errors import ConfigError
from pdcd.panels.map import Map
from pdcd.panels.map_file import from_map_table, load_map, load_maps, save_maps, to_map_table
from tests.unit.panels.test_map import bent


def arrays(**more: Any) -> dict[str, Any]:
    """What a sound file holds, with something else put in; None takes it out."""
    held = {
        "mask.size_px": np.array([64, 48]),
        "mask.homography": np.diag([1 / 64, 1 / 48, 1.0]),
        "mask.radial": np.array([0.01, 0.0]),
        "mask.residual": np.zeros((3, 4, 2)),
    }
    held |= {f"mask.{key}": value for key, value in more.items()}
    return {key: value for key, value in held.items() if value is not None}


def packed(**more: Any) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays(**more))
    return stream.getvalue()


def test_maps_come_back_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "maps.npz"
    maps = {"projector": bent(1), "mask": bent(2), "camera": Map.filling((21, 14))}
    save_maps(path, maps)
    assert load_maps(path) == maps
    assert load_map(path, "mask") == maps["mask"]
    save_maps(path, {"mask": bent(3)})  # replaced, and nothing left beside it
    assert load_maps(path) == {"mask": bent(3)}
    assert os.listdir(tmp_path) == ["maps.npz"]  # noqa: PTH208 - every name, also a hidden one


@pytest.mark.parametrize("seed", [0, 1])
def test_tables_come_back_through_toml(seed: int) -> None:
    map_ = bent(seed)
    text = format_toml({"mask": to_map_table(map_)})
    assert from_map_table(tomllib.loads(text)["mask"], "mask") == map_


def huge() -> bytes:
    """A header that speaks of 2^40 numbers, and a few bytes."""
    header = "{'descr': '<f8', 'fortran_order': False, 'shape': (1048576, 1048576), }\n"
    data = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(64)
    stream = io.BytesIO(packed(residual=None))
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr("mask.residual.npy", data)
    return stream.getvalue()


def bomb() -> bytes:
    """Zeros that unpack to far more than is read."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays(residual=np.zeros((2000, 2000, 2))))
    return stream.getvalue()


def pickled() -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays(radial=np.array([1, "a"], dtype=object)))
    return stream.getvalue()


def many() -> bytes:
    stream = io.BytesIO()
    named: dict[str, Any] = {f"d{n}.size_px": np.ones(2) for n in range(13)}
    np.savez(stream, **named)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (lambda: b"", "empty"),
        (lambda: b"\x93NUMPY", "damaged"),
        (lambda: packed()[:-30], "damaged"),
        (lambda: packed().replace(b"\x93NUMPY", b"\x93NUMPI"), "damaged"),
        (lambda: bytes(4_000_000), "bytes; at most"),
        (huge, "at most 2048 numbers"),
        (bomb, "at most 2048 numbers"),
        (pickled, "not real numbers"),
        (lambda: packed(radial=np.array([0.0, np.nan])), "not finite"),
        (lambda: packed(residual=np.full((2, 2, 2), np.inf)), "not finite"),
        (lambda: packed(homography=None), "no homography"),
        (lambda: packed(size_px=None), "no size_px"),
        (lambda: packed(homography=np.eye(3).ravel()), r"shape \(9,\), not \(3, 3\)"),
        (lambda: packed(residual=np.zeros((4, 4))), "shape"),
        (lambda: packed(residual=np.zeros((1, 4, 2))), "no grid"),
        (lambda: packed(size_px=np.array([64.5, 48])), "not whole pixels"),
        (lambda: packed(size_px=np.array([-64, 48])), "-64 x 48 pixels"),
        (lambda: packed(homography=np.ones((3, 3))), "singular"),
        (lambda: packed(radial=np.array([-0.9, 0.0])), "folds"),
        (lambda: packed(surprise=np.ones(2)), "not of a map"),
        (lambda: packed(**{"a\nb.radial": np.ones(2)}), "not of a map"),
        (many, "13 maps"),
    ],
)
def test_what_is_no_file_of_maps_is_refused_in_a_line(
    tmp_path: Path, data: Callable[[], bytes], says: str
) -> None:
    path = tmp_path / "maps.npz"
    path.write_bytes(data())
    with pytest.raises(ConfigError, match=says) as caught:
        load_maps(path)
    assert str(path) in caught.value.message
    assert caught.value.message.isprintable()


def test_what_is_no_file_at_all(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    for name, says in (("none", "No such file"), ("fifo", "a FIFO"), ("", "a folder")):
        with pytest.raises(ConfigError, match=says):
            load_maps(tmp_path / name)
