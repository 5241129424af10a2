"""The folder readout: only a whole, single, new RAW file with the right settings comes home."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import pytest

from drivers.folder import FolderOptions, FolderReadout
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import CameraConfig, Config
from pdcd.errors import (
    ConfigError,
    DecodeError,
    DeviceLost,
    DiskError,
    ExposureError,
    NoSpaceError,
)
from pdcd.sensor.profile import load_profile
from tests.watched_bench import DNG, Script, dng
from tests.watched_bench import WatchedBench as Bench

MS = 1_000_000


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    made = Bench(tmp_path)
    made.put("IMG_0001.DNG", dng(seed=1))
    made.arm()
    return made


def test_a_folder_says_what_its_sensor_is(bench: Bench) -> None:
    info = bench.readout.connect()
    profile = load_profile(CameraConfig().profile)
    assert (info.model, info.serial) == (f"files in {bench.card}", "")
    assert (info.profile, info.isos, info.f_numbers) == (CameraConfig().profile, profile.isos, ())
    assert info.frame_quads == profile.frame_quads
    assert tuple(info.responsivity_e) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("asked", "said", "taken"),
    [(8.0, 8.47, True), (8.0, 8.49, False), (8.0, 7.53, True), (8.0, 7.51, False),
     (3.5, 3.56, True), (16.0, 8.0, False), (8.0, None, True)],
)  # fmt: skip
def test_nominal_and_true_apertures_differ_by_six_hundredths(
    tmp_path: Path, asked: float, said: float | None, taken: bool
) -> None:
    """A lens that tells none is believed."""
    bench = Bench(tmp_path)
    bench.arm(asked)  # what was asked for, not what is configured
    bench.put("a.dng", dng(f_number=said))
    if taken:
        assert bench.fetch().exists()
    else:
        with pytest.raises(ExposureError, match=rf"at f/{said:g}, not f/{asked:g}"):
            bench.fetch()


# Waiting.


def test_a_folder_is_looked_at_every_poll_and_once_more_at_the_end(tmp_path: Path) -> None:
    bench = Bench(tmp_path, poll_s=0.3)
    bench.arm()
    before_ns = bench.clock.now_ns()
    with pytest.raises(ExposureError, match=r"no RAW file came into .* within 1 s \(is"):
        bench.fetch(1.0)
    assert bench.clock.now_ns() == before_ns + 1000 * MS
    assert bench.signs >= 5  # at 0, 0.3, 0.6, 0.9 and 1 s


# Faults.


def refusing(number: int) -> Callable[..., Any]:
    def refuse(*_: Any, **__: Any) -> Any:
        raise OSError(number, os.strerror(number))

    return refuse


@pytest.mark.parametrize(("number", "kind"), [(errno.ENOSPC, NoSpaceError), (errno.EIO, DiskError)])
def test_a_copy_that_fails_leaves_nothing(
    bench: Bench, refuse_writes: Callable[..., None], number: int, kind: type[Exception]
) -> None:
    bench.put("a.dng")
    refuse_writes(OSError(number, "full"))
    with pytest.raises(kind):
        bench.fetch()
    assert bench.nothing_was_kept() and (bench.card / "a.dng").exists()


def test_whatever_goes_wrong_while_it_is_checked_nothing_is_left(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("drivers.folder.read_raw", fail)
    bench.put("a.dng")
    with pytest.raises(KeyboardInterrupt):
        bench.fetch()
    assert bench.nothing_was_kept() and (bench.card / "a.dng").exists()


def test_a_folder_that_may_not_be_read_is_lost(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "scandir", refusing(errno.EACCES))
    with pytest.raises(DeviceLost, match=r"cannot read the folder .*card: Permission denied"):
        bench.readout.connect()


def test_a_file_that_goes_while_it_is_looked_at_is_passed_over(bench: Bench) -> None:
    bench.put("a.dng")
    (bench.card / "gone.dng").symlink_to(bench.card / "nowhere")
    assert bench.fetch().exists()


# Its options.


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [("poll_s", [0.01, 10.0], [0.009, 10.001]), ("looks", [2, 100], [1, 101]),
     ("suffixes", [[".x"]], [[]]), ("take", ["copy", "move"], ["steal"]), ("folder", ["/"], [1])],
)  # fmt: skip
def test_options_have_their_bounds(name: str, good: list[Any], bad: list[Any]) -> None:
    for value in good:
        msgspec.convert({"folder": "/x", name: value}, FolderOptions)
    for value in bad:
        with pytest.raises(msgspec.ValidationError, match=name):
            msgspec.convert({"folder": "/x", name: value}, FolderOptions)


def test_the_new_file_comes_home_byte_for_byte(bench: Bench) -> None:
    bench.clock.at(1.5, lambda: bench.put("IMG_0002.DNG", dng(seed=2)))
    path = bench.fetch()
    assert path == bench.run / "shot.dng"
    assert path.read_bytes() == dng(seed=2)
    assert (bench.card / "IMG_0002.DNG").exists()


def test_moved_if_asked(tmp_path: Path) -> None:
    bench = Bench(tmp_path, take="move")
    bench.arm()
    bench.put("a.dng")
    assert bench.fetch().read_bytes() == DNG
    assert (bench.card / "a.dng").exists()  # until it was looked at once more
    bench.arm()
    assert not list(bench.card.iterdir())
    bench.put("b.dng", dng(seed=2))
    raw = bench.readout.fetch(bench.run, "other", 5.0)
    bench.readout.recheck({raw.sha256})
    assert not list(bench.card.iterdir())


def test_a_card_begins_a_new_folder(bench: Bench) -> None:
    (bench.card / "101CANON").mkdir()
    bench.put("101CANON/IMG_0001.DNG", dng(seed=3))
    assert bench.fetch().read_bytes() == dng(seed=3)


@pytest.mark.parametrize("data", [DNG[:-1], b""])
def test_a_file_that_never_ends_is_refused(bench: Bench, data: bytes) -> None:
    bench.put("b.dng", data)
    with pytest.raises(ExposureError, match=rf"not whole after 3 s: b\.dng \({len(data)} bytes\)"):
        bench.fetch(3.0)
    assert bench.nothing_was_kept()


def test_names_that_are_not_final_and_sidecars_are_passed_over(bench: Bench) -> None:
    for name in ("b.dng.part", ".b.dng", "b.jpg", "b.xmp", "b.JPG"):
        bench.put(name, dng(seed=5))
    bench.clock.at(2.0, lambda: (bench.card / "b.dng.part").rename(bench.card / "b.dng"))
    bench.clock.at(2.5, lambda: (bench.card / "b.dng").rename(bench.card / "2024-b.dng"))
    assert bench.fetch().read_bytes() == dng(seed=5)


def test_two_files_are_refused(bench: Bench) -> None:
    bench.put("b.dng", dng(seed=2))
    bench.clock.at(0.3, lambda: bench.put("c.dng", dng(seed=3)))
    with pytest.raises(ExposureError, match=r"2 RAW files .*b\.dng.*c\.dng|2 .*c\.dng.*b\.dng"):
        bench.fetch()
    assert bench.nothing_was_kept()


def test_a_file_from_before_is_never_taken_even_if_it_changes(bench: Bench) -> None:
    bench.put("IMG_0001.DNG", dng(seed=9))
    with pytest.raises(ExposureError, match="no RAW file"):
        bench.fetch(3.0)


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


def test_a_file_of_the_run_is_never_written_over(bench: Bench) -> None:
    (bench.run / "shot.dng").write_bytes(b"precious")
    bench.put("b.dng")
    with pytest.raises(DiskError, match="exists"):
        bench.fetch()
    assert (bench.run / "shot.dng").read_bytes() == b"precious"


def test_the_folder_vanishes(bench: Bench) -> None:
    bench.clock.at(1.0, lambda: shutil.rmtree(bench.card))
    with pytest.raises(DeviceLost, match="is it mounted"):
        bench.fetch()
    with pytest.raises(DeviceLost):
        bench.readout.connect()
    with pytest.raises(DeviceLost):
        bench.arm()


@pytest.mark.parametrize("options", [{}, {"folder": "/", "suffix": ".x"}])
def test_wrong_options_are_refused(options: dict[str, Any]) -> None:
    context = DriverContext(config=Config(camera=CameraConfig(options=options)), clock=Script())
    with pytest.raises(ConfigError, match="suffix" if options else "folder"):
        FolderReadout.create(context)


def test_a_home_folder_that_is_none_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a user without a name, as containers have them."""
    monkeypatch.delenv("HOME")
    monkeypatch.setattr("os.getuid", lambda: 2**31 - 7)
    config = Config(camera=CameraConfig(options={"folder": "~/card"}))
    with pytest.raises(ConfigError, match=r"'~/card': there is no such home folder") as caught:
        FolderReadout.create(DriverContext(config=config, clock=Script()))
    assert caught.value.hint == "write the whole path"


@pytest.mark.parametrize(("looks", "wait_s", "taken"), [(2, 5.0, 0.5), (7, 5.0, 3.0),
                                                        (3, 1.0, 1.0), (3, 0.5, None)])  # fmt: skip
def test_a_file_is_taken_when_so_many_looks_in_a_row_find_it_the_same(
    tmp_path: Path, looks: int, wait_s: float, taken: float | None
) -> None:
    bench = Bench(tmp_path, looks=looks, poll_s=0.5)
    bench.arm()
    bench.put("a.dng")
    before_ns = bench.clock.now_ns()
    if taken is None:
        with pytest.raises(ExposureError, match=r"not whole after 0\.5 s: a\.dng"):
            bench.fetch(wait_s)
    else:
        bench.fetch(wait_s)
        assert bench.clock.now_ns() - before_ns == round(taken * 1e9)


def test_a_file_that_cannot_be_removed_is_told_before_the_next_photo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, take="move")
    bench.arm()
    bench.put("a.dng")
    bench.fetch()
    monkeypatch.setattr(os, "unlink", refusing(errno.EPERM))
    with pytest.raises(DeviceLost, match=r"cannot remove .*a\.dng: Operation not permitted"):
        bench.arm()
    assert (bench.card / "a.dng").exists()


def test_where_no_aperture_is_asked_for_any_will_do_and_an_untold_iso(tmp_path: Path) -> None:
    bench = Bench(tmp_path, f_number="auto")
    bench.arm()
    bench.put("a.dng", dng(f_number=22.0, iso=0))
    assert bench.fetch().exists()


@pytest.mark.parametrize(
    ("before_s", "check", "taken"),
    [(1.9, True, True), (2.1, True, False), (-100.0, True, True), (2.1, False, True)],
)
def test_dates_may_be_two_seconds_off_and_any_where_that_is_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before_s: float, check: bool, taken: bool
) -> None:
    monkeypatch.setattr("time.time_ns", lambda: 1_700_000_000 * 10**9)
    options: dict[str, Any] = {} if check else {"check_date": False}
    bench = Bench(tmp_path, **options)
    bench.arm()
    bench.put("a.dng")
    at_ns = 1_700_000_000 * 10**9 - round(before_s * 1e9)
    os.utime(bench.card / "a.dng", ns=(at_ns, at_ns))
    if taken:
        assert bench.fetch().exists()
    else:
        with pytest.raises(ExposureError, match=r"a\.dng is new but dated 2 s before"):
            bench.fetch()


def test_a_file_that_grows_or_pauses_is_waited_for(bench: Bench) -> None:
    data = dng(seed=2)
    for step in range(11):
        part = data[: len(data) * step // 10]
        bench.clock.at(0.5 + 0.1 * step, partial(bench.put, "b.dng", part))
    before = bench.clock.now_ns()
    assert bench.fetch().read_bytes() == data
    assert bench.clock.now_ns() - before >= 1.5e9
