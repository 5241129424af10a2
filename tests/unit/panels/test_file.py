"""Files and tables of maps: what is written comes back, what is no map is refused in a line."""

from __future__ import annotations

import errno
import io
import os
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.reading import format_toml
from pdcd.errors import ConfigError, DiskError, NoSpaceError
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
    with pytest.raises(ConfigError, match="holds no map of the camera, but of mask"):
        load_map(path, "camera")
    assert os.listdir(tmp_path) == ["maps.npz"]  # noqa: PTH208 - every name, also a hidden one


@pytest.mark.parametrize("seed", [0, 1])
def test_tables_come_back_through_toml(seed: int) -> None:
    map_ = bent(seed)
    text = format_toml({"mask": to_map_table(map_)})
    assert from_map_table(tomllib.loads(text)["mask"], "mask") == map_


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
        (lambda: packed(radial=np.array([0.0, np.nan])), "not finite"),
        (lambda: packed(residual=np.full((2, 2, 2), np.inf)), "not finite"),
        (lambda: packed(radial=np.array([-0.9, 0.0])), "folds"),
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


GOOD = Map.filling((64, 48))
NODES = tuple(tuple((1e-6 * row, 1e-6 * col) for col in range(32)) for row in range(32))
BENT = msgspec.structs.replace(GOOD, radial=(0.01, 0.0), tangential=(0.0, 0.001), residual=NODES)


def stored(path: Path) -> dict[str, tuple[int, ...]]:
    with np.load(path) as held:
        return {name: held[name].shape for name in held.files}


def test_twelve_maps_fit_a_file(tmp_path: Path) -> None:
    maps = {f"camera-{n}": GOOD for n in range(11)} | {"bent": BENT}
    save_maps(tmp_path / "m.npz", maps)
    assert load_maps(tmp_path / "m.npz") == maps
    for count in (0, 13):
        some = {f"camera-{n}": GOOD for n in range(count)}
        with pytest.raises(ConfigError, match=f"^{count} maps for one file; it holds 1 to 12"):
            save_maps(tmp_path / "none.npz", some)
    assert [path.name for path in tmp_path.iterdir()] == ["m.npz"]


def test_what_is_zero_throughout_is_left_out(tmp_path: Path) -> None:
    save_maps(tmp_path / "m.npz", {"mask": GOOD, "camera": BENT})
    assert stored(tmp_path / "m.npz") == {
        "mask.size_px": (2,), "mask.homography": (3, 3),
        "camera.size_px": (2,), "camera.homography": (3, 3), "camera.radial": (2,),
        "camera.tangential": (2,), "camera.residual": (32, 32, 2),
    }  # fmt: skip


@pytest.mark.parametrize("name", ["", "A", "9a", "_a", "a" * 33, "a.b", "a/b", "a\nb", "mask "])
def test_names_that_cannot(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="is no name of a device") as caught:
        save_maps(tmp_path / "m.npz", {"mask": GOOD, name: GOOD})
    assert caught.value.message.isprintable()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"size_px": np.array([64, 48, 1])}, "`mask.size_px`: it has .* at most 2 numbers"),
        ({"radial": np.zeros((2, 1))}, r"`mask\.radial` has the shape \(2, 1\), not \(2,\)"),
        ({"tangential": np.zeros(1)}, r"`mask\.tangential` has the shape \(1,\), not \(2,\)"),
        ({"residual": np.zeros((3, 4, 3))}, r"has the shape \(3, 4, 3\), not \(3, 4, 2\)"),
        ({"residual": np.zeros((3, 4, 2, 1))}, r"\(3, 4, 2, 1\), not \(3, 4, 2\)"),
        ({"residual": np.zeros(8)}, r"has the shape \(8,\), not \(8, 2\)"),
        ({"residual": np.zeros((1, 1025, 2))}, "at most 2048 numbers"),
        ({"radial": np.zeros(3)}, "at most 2 numbers"),
        ({"homography": np.zeros((2, 5))}, "at most 9 numbers"),
        ({"homography": np.eye(3).ravel()}, r"the shape \(9,\), not \(3, 3\)"),
        ({"size_px": np.array([64.0, 48.5])}, r"is 64\.0 x 48\.5: not whole pixels"),
        ({"size_px": np.array([63.5, 48.0])}, r"is 63\.5 x 48\.0: not whole pixels"),
        ({"size_px": None}, "the mask has no size_px$"),
        ({"homography": None}, "the mask has no homography$"),
        ({"size_px": None, "homography": None}, "the mask has no size_px and no homography$"),
        ({"mask.radial": np.zeros(2)}, r"'mask\.mask\.radial' is not of a map$"),
    ],
)  # fmt: skip
def test_arrays_of_another_form_are_refused(
    tmp_path: Path, arrays: dict[str, Any], says: str
) -> None:
    (tmp_path / "m.npz").write_bytes(packed(**arrays))
    with pytest.raises(ConfigError) as caught:
        load_maps(tmp_path / "m.npz")
    assert re.search(says, caught.value.message)
    assert caught.value.hint and "calibration" in caught.value.hint


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    """12 maps of 2 + 9 + 2 + 2 + 2 x 32 x 32 numbers, of 8 bytes each, and 1 MiB."""
    most = 12 * 2063 * 8 + 2**20
    for size, says in ((most, "damaged"), (most + 1, f"more than the {most} allowed")):
        (tmp_path / "m").write_bytes(bytes(size))
        with pytest.raises(ConfigError, match=says):
            load_maps(tmp_path / "m")


@pytest.mark.parametrize(
    ("number", "error"),
    [(errno.ENOSPC, NoSpaceError), (errno.EDQUOT, NoSpaceError), (errno.EIO, DiskError)],
)
def test_a_disk_that_refuses_leaves_the_old_file_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, error: type[Exception]
) -> None:
    path = tmp_path / "m.npz"
    save_maps(path, {"mask": GOOD})

    def refuses(_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", refuses)
    with pytest.raises(error) as caught:
        save_maps(path, {"mask": BENT})
    assert caught.value.device == str(path)  # type: ignore[attr-defined]
    assert [found.name for found in tmp_path.iterdir()] == ["m.npz"]
    assert load_maps(path) == {"mask": GOOD}


def test_a_table_that_is_no_map_names_the_device() -> None:
    assert from_map_table(to_map_table(BENT), "mask") == BENT
    wrong: list[dict[str, Any]] = [
        {}, {**to_map_table(GOOD), "radial": [1.0]}, {**to_map_table(GOOD), "more": 1.0},
        {**to_map_table(GOOD), "size_px": [6.5, 4]}, {**to_map_table(GOOD),
        "homography": [0.0] * 9},
    ]  # fmt: skip
    for given in wrong:
        with pytest.raises(ConfigError) as caught:
            from_map_table(given, "mask")
        assert caught.value.device == "mask"
