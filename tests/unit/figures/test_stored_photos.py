"""What lies in the folder of figures: names that say what made it, and files that are not whole."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.errors import DiskError
from pdcd.figures.figure import QUICK, TINY, Drawn, Figure, Mode, Photo, Take
from pdcd.figures.photo import packed, unpacked
from pdcd.figures.store import Store, digest, told

LIGHT = np.linspace(0.0, 1.0, 36, dtype=np.float32).reshape(3, 4, 3)
PHOTO = Photo(
    {"direct": LIGHT, "white": 2.0 * LIGHT}, {"direct": 0.5 * LIGHT}, {"direct": 0.25},
    LIGHT + 1.0, LIGHT + 2.0, {"codes": 16}, (3, 4),
)  # fmt: skip
TAKE = Take("still-life", "indirect", {"codes": 64}, {"seed": 1}, bound=0.5)


def test_a_photo_comes_back_with_all_that_it_has(tmp_path: Path) -> None:
    path = tmp_path / "photo"
    path.write_bytes(packed(PHOTO))
    back = unpacked(path)
    assert list(back.pictures) == ["direct", "white"] and list(back.truths) == ["direct"]
    for found, wanted in (
        (back.pictures["white"], 2.0 * LIGHT), (back.truth, 0.5 * LIGHT),
        (back.transport, LIGHT + 1.0), (back.transport_truth, LIGHT + 2.0),
    ):  # fmt: skip
        assert found is not None
        np.testing.assert_array_equal(found, wanted)
    assert (back.errors, back.summary, back.grid) == ({"direct": 0.25}, {"codes": 16}, (3, 4))
    assert (back.answer, back.error) == ("direct", 0.25)


def npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


@pytest.mark.parametrize(
    "data",
    [None, b"", b"no zip", packed(PHOTO)[:200], npz(x=np.ones(3)), npz(said=np.ones(3, np.uint8))],
    ids=["gone", "empty", "text", "cut", "other arrays", "other words"],
)
def test_a_photo_that_is_not_whole_is_none(tmp_path: Path, data: bytes | None) -> None:
    store = Store(tmp_path, TINY)
    name = store.photo_name(TAKE)
    if data is not None:
        store.write(name, data)
    assert store.has(name) == (data is not None)
    assert store.photo(name) is None


def test_any_change_of_a_capture_gives_its_photo_another_name(tmp_path: Path) -> None:
    store = Store(tmp_path, TINY)
    changes: list[dict[str, Any]] = [
        {}, {"scene": "open-book"}, {"goal": "direct"}, {"asked": {"codes": 65}},
        {"options": {"seed": 2}}, {"off_axis": True}, {"perfect": True}, {"f_number": 4.0},
        {"all_codes": True}, {"grid": (3, 4)},
        {"asked": {"codes": 64, "illumination": np.ones(3)}},
        {"asked": {"codes": 64, "illumination": np.zeros(3)}},
    ]  # fmt: skip
    names = [store.photo_name(dataclasses.replace(TAKE, **change)) for change in changes]
    names.append(Store(tmp_path, QUICK).photo_name(TAKE))
    assert len(set(names)) == len(names)
    assert all(name.startswith("data/photos/") and name.endswith(".npz") for name in names)
    assert len(Path(names[0]).stem) == 24
    assert store.photo_name(dataclasses.replace(TAKE)) == names[0]


def test_arrays_are_told_by_their_numbers_whatever_their_kind() -> None:
    singles = dataclasses.replace(TAKE, asked={"a": np.ones(3, np.float32)})
    doubles = dataclasses.replace(TAKE, asked={"a": np.ones(3)})
    assert told(singles) == told(doubles)
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1}) != digest({"a": 2, "b": 1})


def test_photos_are_forgotten_once_or_again(tmp_path: Path) -> None:
    store = Store(tmp_path, TINY)
    for name in ("data/photos/a", "data/photos/b"):
        store.write(name, b"x")
    store.forget(["data/photos/a", "data/photos/gone"])
    assert not store.has("data/photos/a") and store.has("data/photos/b")
    with pytest.raises(DiskError):
        store.forget(["data/photos/b/c"])


def test_a_figure_is_told_by_its_captures_its_mode_and_its_plots(tmp_path: Path) -> None:
    def figure(**takes: Take) -> Figure:
        def drawn(mode: Mode, photos: Mapping[str, Photo]) -> Drawn:
            return Drawn()

        return Figure("1", "t", "s", "p", "u", takes=lambda mode: takes, drawn=drawn)

    one, same, more = figure(a=TAKE), figure(a=TAKE), figure(a=TAKE, b=TAKE)
    store = Store(tmp_path, TINY)
    assert store.fingerprint(one) == store.fingerprint(one) == store.fingerprint(same)
    others = {
        store.fingerprint(more), store.fingerprint(figure(b=TAKE)),
        Store(tmp_path, QUICK).fingerprint(one),
        Store(tmp_path, TINY, plots=False).fingerprint(one),
    }  # fmt: skip
    assert len(others) == 4 and store.fingerprint(one) not in others
