"""The folder readout: only a whole, single, new RAW file with the right settings comes home."""

from __future__ import annotations

import errno
import hashlib
import itertools
import os
import shutil
import tempfile
from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.folder import FolderReadout
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import CameraSettings, DriverContext
from pdcd.bench.tables import CameraConfig, Config
from pdcd.errors import ConfigError, DecodeError, DeviceLost, ExposureError, NoSpaceError
from pdcd.sensor.raw import read_raw
from tests.dng_file import write_dng

SETTINGS = CameraSettings(iso=100, f_number=None)


class Script(VirtualClock):
    """A clock that does things when it gets there: another program at work in the folder."""

    def __init__(self) -> None:
        super().__init__()
        self._plan: list[tuple[int, Callable[[], object]]] = []

    def at(self, seconds: float, do: Callable[[], object]) -> None:
        """Do that `seconds` from now."""
        self._plan.append((self.now_ns() + round(seconds * 1e9), do))

    def sleep_until_ns(self, t_ns: int) -> None:
        due = [entry for entry in self._plan if entry[0] <= t_ns]
        self._plan = [entry for entry in self._plan if entry[0] > t_ns]
        for _, do in sorted(due, key=lambda entry: entry[0]):
            do()
        super().sleep_until_ns(t_ns)


def dng(seed: int = 0, iso: int = 100, f_number: float | None = 8.0) -> bytes:
    """A small RAW file."""
    mosaic = np.random.default_rng(seed).integers(512, 16383, (48, 64)).astype(np.uint16)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.dng"
        write_dng(
            path,
            mosaic,
            black=512,
            white=16383,
            iso=iso,
            exposure_s=0.6,
            f_number=f_number,
            model="test camera",
            date=datetime(2024, 1, 1),
        )
        return path.read_bytes()


class Bench:
    """A folder that is watched, one for the run, and the driver between them."""

    def __init__(self, root: Path, **options: Any) -> None:
        self.card, self.run = root / "card", root / "run"
        self.card.mkdir()
        self.run.mkdir()
        self.clock = Script()
        camera = CameraConfig(
            f_number=8.0,
            responsivity_e=(1.0, 2.0, 3.0),
            options={"folder": str(self.card), **options},
        )
        context = DriverContext(config=Config(camera=camera), clock=self.clock)
        self.readout = FolderReadout.create(context)
        self.readout.connect()

    def put(self, name: str, data: bytes) -> None:
        (self.card / name).write_bytes(data)

    def fetch(self, timeout_s: float = 10.0) -> Path:
        raw = self.readout.fetch(self.run, "shot", timeout_s)
        data = raw.path.read_bytes()
        assert (raw.size_bytes, raw.sha256) == (len(data), hashlib.sha256(data).hexdigest())
        return raw.path

    def nothing_was_kept(self) -> bool:
        return not list(self.run.iterdir())


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    bench = Bench(tmp_path)
    bench.put("IMG_0001.DNG", dng(1))
    bench.readout.arm(SETTINGS)
    return bench


def test_the_new_file_comes_home_byte_for_byte(bench: Bench) -> None:
    bench.clock.at(1.5, lambda: bench.put("IMG_0002.DNG", dng(2)))
    path = bench.fetch()
    assert path == bench.run / "shot.dng"
    assert path.read_bytes() == dng(2)
    assert (bench.card / "IMG_0002.DNG").exists()


def test_moved_if_asked(tmp_path: Path) -> None:
    bench = Bench(tmp_path, take="move")
    bench.readout.arm(SETTINGS)
    bench.put("a.dng", dng())
    assert bench.fetch().read_bytes() == dng()
    assert not list(bench.card.iterdir())


def test_a_card_begins_a_new_folder(bench: Bench) -> None:
    (bench.card / "101CANON").mkdir()
    bench.put("101CANON/IMG_0001.DNG", dng(3))
    assert bench.fetch().read_bytes() == dng(3)


def test_a_file_that_grows_is_waited_for(bench: Bench) -> None:
    data = dng(2)
    target = bench.card / "b.dng"
    for step in range(11):
        part = data[: len(data) * step // 10]
        bench.clock.at(0.5 + 0.1 * step, partial(target.write_bytes, part))
    before = bench.clock.now_ns()
    assert bench.fetch().read_bytes() == data
    assert bench.clock.now_ns() - before >= 1.5e9


def test_a_pause_in_the_middle_does_not_make_it_whole(bench: Bench) -> None:
    data = dng(2)
    bench.put("b.dng", data[: len(data) // 2])
    bench.clock.at(5.0, lambda: bench.put("b.dng", data))
    assert bench.fetch().read_bytes() == data


def test_a_file_that_never_ends_is_refused(bench: Bench) -> None:
    bench.put("b.dng", dng(2)[:-1])
    with pytest.raises(ExposureError, match=r"not whole after 3 s: b\.dng \(\d+ bytes\)"):
        bench.fetch(3.0)
    assert bench.nothing_was_kept()


def test_a_file_that_changes_all_the_time_is_refused(bench: Bench) -> None:
    for step in range(100):
        bench.clock.at(0.1 * step, partial(bench.put, "b.dng", dng(2) + bytes(step)))
    with pytest.raises(ExposureError, match="not whole"):
        bench.fetch(5.0)


def test_names_that_are_not_final_and_sidecars_are_passed_over(bench: Bench) -> None:
    for name in ("b.dng.part", ".b.dng", "b.jpg", "b.xmp", "b.JPG"):
        bench.put(name, dng(5))
    bench.clock.at(2.0, lambda: (bench.card / "b.dng.part").rename(bench.card / "b.dng"))
    assert bench.fetch().read_bytes() == dng(5)


def test_a_file_renamed_while_it_is_looked_at(bench: Bench) -> None:
    bench.put("b.dng", dng(5))
    bench.clock.at(0.5, lambda: (bench.card / "b.dng").rename(bench.card / "2024-b.dng"))
    assert bench.fetch().read_bytes() == dng(5)


def test_only_a_jpeg_is_no_file(bench: Bench) -> None:
    bench.put("b.jpg", b"\xff\xd8")
    with pytest.raises(ExposureError, match=r"no RAW file came .* within 2 s .*set to RAW"):
        bench.fetch(2.0)


def test_nothing_comes(bench: Bench) -> None:
    before = bench.clock.now_ns()
    with pytest.raises(ExposureError, match="no RAW file"):
        bench.fetch(7.0)
    assert bench.clock.now_ns() - before == 7 * 10**9


def test_two_files_are_refused(bench: Bench) -> None:
    bench.put("b.dng", dng(2))
    bench.clock.at(0.3, lambda: bench.put("c.dng", dng(3)))
    with pytest.raises(ExposureError, match=r"2 RAW files .*b\.dng.*c\.dng|2 .*c\.dng.*b\.dng"):
        bench.fetch()
    assert bench.nothing_was_kept()


def test_of_two_files_the_one_that_is_not_whole_is_waited_for(bench: Bench) -> None:
    bench.put("b.dng", dng(2))
    bench.put("c.dng", dng(3)[:-1])
    with pytest.raises(ExposureError, match="not whole after 3 s"):
        bench.fetch(3.0)
    assert bench.nothing_was_kept()


def test_a_file_from_before_is_never_taken_even_if_it_changes(bench: Bench) -> None:
    bench.put("IMG_0001.DNG", dng(9))
    with pytest.raises(ExposureError, match="no RAW file"):
        bench.fetch(3.0)


def test_a_new_file_with_an_old_date_is_refused_unless_allowed(tmp_path: Path) -> None:
    for allowed in (False, True):
        root = tmp_path / str(allowed)
        root.mkdir()
        bench = Bench(root, check_date=not allowed)
        bench.readout.arm(SETTINGS)
        bench.put("b.dng", dng())
        os.utime(bench.card / "b.dng", (1.0e9, 1.0e9))
        if allowed:
            bench.fetch()
        else:
            with pytest.raises(ExposureError, match="before the exposure"):
                bench.fetch()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (dng(iso=400), "ISO 400, not 100"),
        (dng(f_number=5.6), "f/5.6, not f/8"),
        (b"not a RAW file" * 100, "cannot decode"),
    ],
)
def test_a_wrong_file_is_refused_and_not_kept(bench: Bench, data: bytes, message: str) -> None:
    bench.put("b.dng", data)
    with pytest.raises((ExposureError, DecodeError), match=message):
        bench.fetch()
    assert bench.nothing_was_kept()
    assert (bench.card / "b.dng").read_bytes() == data


def test_a_lens_that_tells_no_aperture_is_believed(bench: Bench) -> None:
    bench.put("b.dng", dng(f_number=None))
    bench.fetch()


def test_unreadable(bench: Bench) -> None:
    (bench.card / "b.dng").mkdir()  # root may read any file, but nobody a folder
    with pytest.raises(DecodeError, match=r"cannot copy .*b\.dng"):
        bench.fetch()
    assert bench.nothing_was_kept()


def test_a_file_of_the_run_is_never_written_over(bench: Bench) -> None:
    (bench.run / "shot.dng").write_bytes(b"precious")
    bench.put("b.dng", dng())
    with pytest.raises(DecodeError, match="exists"):
        bench.fetch()
    assert (bench.run / "shot.dng").read_bytes() == b"precious"


def test_a_full_disk(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.put("b.dng", dng())
    whole_open = Path.open

    class Full:
        """A file on a disk that is full."""

        def __init__(self, file: Any) -> None:
            self._file = file

        def __enter__(self) -> Full:
            return self

        def __exit__(self, *_: object) -> None:
            self._file.close()

        def write(self, data: bytes) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    def open_full(path: Path, mode: str = "r", *args: Any) -> Any:
        file = whole_open(path, mode, *args)
        return Full(file) if mode == "xb" else file

    monkeypatch.setattr(Path, "open", open_full)
    with pytest.raises(NoSpaceError, match=r"shot\.dng"):
        bench.fetch()
    assert bench.nothing_was_kept()


def test_the_folder_vanishes(bench: Bench) -> None:
    bench.clock.at(1.0, lambda: shutil.rmtree(bench.card))
    with pytest.raises(DeviceLost, match="is it mounted"):
        bench.fetch()
    with pytest.raises(DeviceLost):
        bench.readout.connect()
    with pytest.raises(DeviceLost):
        bench.readout.arm(SETTINGS)


def test_settings_are_needed_first_and_once(bench: Bench) -> None:
    bench.put("b.dng", dng())
    bench.fetch()
    with pytest.raises(ExposureError, match="arm"):
        bench.readout.fetch(bench.run, "again", 1.0)
    bench.readout.arm(SETTINGS)
    bench.readout.disconnect()
    with pytest.raises(ExposureError, match="arm"):
        bench.readout.fetch(bench.run, "again", 1.0)


def test_the_copy_decodes_to_the_same_photo(bench: Bench) -> None:
    bench.put("b.dng", dng(4))
    mosaic = np.random.default_rng(4).integers(512, 16383, (48, 64)).astype(np.uint16)
    assert np.array_equal(read_raw(bench.fetch()).planes[0] + 512, mosaic[0::2, 0::2])


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (CameraConfig(responsivity_e=(1.0, 1.0, 1.0)), "folder"),
        (CameraConfig(options={"folder": "/", "looks": 1}), "looks"),
        (CameraConfig(options={"folder": "/", "suffix": ".x"}), "suffix"),
    ],
)
def test_wrong_options_are_refused(camera: CameraConfig, message: str) -> None:
    context = DriverContext(config=Config(camera=camera), clock=VirtualClock())
    with pytest.raises(ConfigError, match=message):
        FolderReadout.create(context)


def test_who_waits_for_a_file_shows_that_he_lives(tmp_path: Path) -> None:
    clock, signs_ns = VirtualClock(), [VirtualClock().now_ns()]
    camera = CameraConfig(options={"folder": str(tmp_path), "poll_s": 2.0})
    context = DriverContext(
        config=Config(camera=camera),
        clock=clock,
        alive=lambda: signs_ns.append(clock.now_ns()),
    )
    readout = FolderReadout.create(context)
    readout.connect()
    readout.arm(SETTINGS)
    with pytest.raises(ExposureError, match="no RAW file"):
        readout.fetch(tmp_path, "shot", 60.0)
    assert signs_ns[-1] - signs_ns[0] >= 60e9 - 2e9
    assert max(b - a for a, b in itertools.pairwise(signs_ns)) < 3e9


@pytest.mark.parametrize("looks", [2, 3, 7])
def test_a_file_is_taken_when_so_many_looks_in_a_row_find_it_the_same(
    tmp_path: Path, looks: int
) -> None:
    bench = Bench(tmp_path, looks=looks, poll_s=0.5)
    bench.readout.arm(SETTINGS)
    bench.put("a.dng", dng())
    before_ns = bench.clock.now_ns()
    bench.fetch()
    assert bench.clock.now_ns() - before_ns == (looks - 1) * 500_000_000


def test_an_old_date_is_refused_where_nothing_is_said_of_dates(bench: Bench) -> None:
    bench.put("b.dng", dng())
    os.utime(bench.card / "b.dng", (1.0e9, 1.0e9))
    with pytest.raises(ExposureError, match=r"before the exposure \(set the camera's clock"):
        bench.fetch()


def test_a_file_that_cannot_be_removed_is_not_kept_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, take="move")
    bench.readout.arm(SETTINGS)
    bench.put("a.dng", dng())
    unlink = Path.unlink

    def refuse(path: Path, *args: Any, **kwargs: Any) -> None:
        if path.parent == bench.card:
            raise PermissionError(errno.EPERM, "Operation not permitted")
        unlink(path, *args, **kwargs)

    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(DeviceLost, match=r"cannot remove .*a\.dng: Operation not permitted"):
        bench.fetch()
    assert bench.nothing_was_kept() and (bench.card / "a.dng").exists()
