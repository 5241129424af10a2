"""A watched folder that others write into: links, pipes, odd names, late data, and no end of it."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from pdcd.bench.patience import Patience
from pdcd.errors import Cancelled, DecodeError, ExposureError, PdcdError, to_error_fields
from pdcd.files.text import encode_json
from pdcd.sensor.whole import find_gap
from tests.form_dng import LONG, RATIONAL, DngFile, write_dng_form
from tests.watched_bench import DNG, Script, WatchedBench, dng

pytestmark = pytest.mark.timeout(60)  # a pipe that is opened to be read blocks for good
GOOD = dng(seed=7)
PHOTO = dng(seed=3, side=512)
"""Half a megabyte in one strip."""


@pytest.fixture
def bench(tmp_path: Path) -> WatchedBench:
    made = WatchedBench(tmp_path)
    (tmp_path / "private.dng").write_bytes(dng(seed=9))
    made.put("old.dng")
    made.arm()
    return made


def bound(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


def find_private(path: Path) -> Path:
    return next(p / "private.dng" for p in path.parents if (p / "private.dng").exists())


ODD: dict[str, tuple[Callable[[Path], object], str]] = {
    "FIFO": (os.mkfifo, "a FIFO"),
    "socket": (bound, "a socket"),
    "device": (lambda p: p.symlink_to("/dev/zero"), "a symbolic link"),
    "link out": (lambda p: p.symlink_to("../private.dng"), "a symbolic link"),
    "link in": (lambda p: p.symlink_to("old.dng"), "a symbolic link"),
    "loop": (lambda p: p.symlink_to(p.name), "a symbolic link"),
    "nowhere": (lambda p: p.symlink_to("none"), "a symbolic link"),
    "link to a folder": (lambda p: p.symlink_to(".."), "a symbolic link"),
    "folder": (Path.mkdir, "a folder"),
    "other name": (lambda p: p.hardlink_to(find_private(p)), "a hard link"),
}


@pytest.mark.parametrize("kind", ODD)
def test_what_is_no_file_of_its_own_is_never_opened(bench: WatchedBench, kind: str) -> None:
    make, words = ODD[kind]
    make(bench.card / "IMG_1.DNG")
    with pytest.raises(ExposureError, match=rf"no RAW file.*; passed over: IMG_1\.DNG \({words}\)"):
        bench.fetch(2.0)
    assert bench.nothing_was_kept()
    bench.arm()
    (bench.card / "deep").mkdir()
    make(bench.card / "deep" / "IMG_2.DNG")
    bench.put("IMG_3.DNG", GOOD)
    assert bench.fetch().read_bytes() == GOOD


@pytest.mark.parametrize(
    ("put", "words"),
    [
        ("old.dng", r"old\.dng \(its name was there before\)"),
        ("IMG_1.iiq", r"IMG_1\.iiq \(no RAW by its name\)"),
        ("\n\x1b[2Jx.jpg", r"\\n\\u001b\[2Jx\.jpg \(no RAW by its name\)"),
    ],
)
def test_what_came_and_was_passed_over_is_named(bench: WatchedBench, put: str, words: str) -> None:
    bench.put(put, dng(seed=4))
    with pytest.raises(ExposureError, match=rf"no RAW file .*; passed over: {words} \("):
        bench.fetch(2.0)


@pytest.mark.parametrize("place", [".trash", "@eaDir", "#recycle", "$RECYCLE.BIN"])
def test_what_a_nas_keeps_for_itself_is_no_photo(bench: WatchedBench, place: str) -> None:
    (bench.card / place / "IMG_1.DNG").mkdir(parents=True)
    (bench.card / place / "IMG_2.DNG").write_bytes(DNG)
    bench.put("IMG_1.DNG", GOOD)
    assert bench.fetch().read_bytes() == GOOD


@pytest.mark.parametrize("name", ["._IMG_1.DNG", "~tmp1.dng", "~$IMG_1.DNG", ".DS_Store", ".x.dng"])
def test_what_programs_write_beside_a_photo_is_none(bench: WatchedBench, name: str) -> None:
    """AppleDouble files, and those that are renamed once they are whole."""
    bench.put(name, DNG)
    bench.put("IMG_1 (1).DNG", GOOD)
    assert bench.fetch().read_bytes() == GOOD


def test_folders_that_lie_in_each_other_without_end_are_left_alone(bench: WatchedBench) -> None:
    deep = bench.card
    for _ in range(300):
        deep /= "d"
        deep.mkdir()
    (bench.card / "d" / "a.dng").write_bytes(GOOD)
    assert bench.fetch().read_bytes() == GOOD


@pytest.mark.parametrize("name", [b"IMG_\xe9.dng", b"a\nb.dng", b"\xff\xfe.DNG", "é.dng".encode()])
def test_a_photo_is_taken_whatever_its_name_and_told_as_text(
    bench: WatchedBench, name: bytes
) -> None:
    os.rename(bench.card / "old.dng", os.fsencode(bench.card) + b"/" + name)  # noqa: PTH104
    assert bench.fetch().read_bytes() == DNG
    with pytest.raises(PdcdError) as caught:  # a second one beside it
        bench.arm()
        for number in (1, 2):
            (bench.card / f"{os.fsdecode(name)[:-4]}{number}.dng").write_bytes(GOOD)
        bench.fetch()
    told = encode_json(to_error_fields(caught.value))
    assert "2 RAW files" in msgspec.json.decode(told)["message"]
    assert str(caught.value).isprintable()


def test_a_file_larger_than_a_photo_is_not_read(bench: WatchedBench) -> None:
    """A sparse one takes nothing of the disk, and would fill memory or another disk."""
    with (bench.card / "a.dng").open("wb") as file:
        file.write(DNG)
        file.truncate(60 * 2**30)
    with pytest.raises(DecodeError, match=r"a\.dng: it has 64424509440 bytes, more than the"):
        bench.fetch(2.0)
    assert bench.nothing_was_kept() and bench.signs < 1000


def test_more_samples_than_its_sensor_has_are_not_unpacked(tmp_path: Path) -> None:
    """Of deflated zeros: a few kilobytes are gigabytes of samples."""
    bench = WatchedBench(tmp_path, profile="450d")
    more = {257: (LONG, [9000]), 278: (LONG, [9000])}
    file = DngFile(bits=16, floating=True, packing=8, white=1, black=((0.0,),), more=more)
    data = write_dng_form(tmp_path / "huge", np.full((2, 9000), 0.5), file)
    bench.arm()
    bench.put("a.dng", data)
    with pytest.raises(DecodeError, match="9000 x 9000 samples, more than the"):
        bench.fetch(2.0)


def with_preview(data: bytes, packing: int, preview: bytes) -> bytes:
    """The same with one behind it, as a second directory tells."""
    (entries,) = struct.unpack_from("<H", data, 8)
    link, at = 8 + 2 + 12 * entries, len(data) + len(data) % 2
    tags = [(254, 1), (256, 160), (257, 120), (259, packing), (262, 2), (273, at + 200),
            (278, 120), (279, len(preview))]  # fmt: skip
    more = struct.pack("<H", len(tags)) + b"".join(
        struct.pack("<HHII", t, 4, 1, v) for t, v in tags
    )
    linked = data[:link] + struct.pack("<I", at) + data[link + 4 :]
    return linked.ljust(at, b"\0") + more.ljust(200, b"\0") + preview


def test_a_dark_photo_has_a_black_preview(bench: WatchedBench) -> None:
    """Of zeros alone, where it is not compressed, as in an NEF or many a DNG."""
    dark = np.random.default_rng(1).normal(256.0, 4.0, (64, 96)).round().astype(int)
    file = DngFile(more={33437: (RATIONAL, [8, 1])})
    plain = write_dng_form(bench.card / "old.dng", dark, file)
    photo = with_preview(plain, 1, bytes(160 * 120 * 3))
    bench.arm()
    bench.put("a.dng", photo)
    assert bench.fetch().read_bytes() == photo
    assert "end with zeros" in find_gap(with_preview(plain, 7, bytes(160 * 120 * 3)))


# Data that come late.


def write_late(bench: WatchedBench, name: str, pieces: list[slice], delay_s: float) -> None:
    """A file of full length, of which all but some pieces come later, and its date stays."""
    path, first = bench.card / name, bytearray(len(PHOTO))
    for piece in pieces:
        first[piece] = PHOTO[piece]
    path.write_bytes(bytes(first))
    date = path.stat().st_mtime_ns

    def fill() -> None:
        path.write_bytes(PHOTO)
        os.utime(path, ns=(date, date))

    bench.clock.at(delay_s, fill)


PIECES = {
    "nothing yet": [],
    "its head": [slice(0, 4096)],
    "two fifths": [slice(0, 2 * len(PHOTO) // 5)],
    "all but a page": [slice(0, len(PHOTO) - 2**13)],
    "a hole": [slice(0, 2**17), slice(2**18, None)],
    "its end alone": [slice(len(PHOTO) // 2, None)],
}


@pytest.mark.parametrize("delay_s", [0.1, 0.7, 0.9, 2.0, 5.0, 30.0])
@pytest.mark.parametrize("pieces", PIECES)
def test_data_that_come_late_are_waited_for(
    bench: WatchedBench, pieces: str, delay_s: float
) -> None:
    write_late(bench, "a.dng", PIECES[pieces], delay_s)
    before_ns = bench.clock.now_ns()
    assert bench.fetch(60.0).read_bytes() == PHOTO
    assert bench.clock.now_ns() - before_ns >= delay_s * 1e9


def test_data_that_never_come_are_told_in_time(bench: WatchedBench) -> None:
    write_late(bench, "a.dng", PIECES["two fifths"], 1000.0)
    with pytest.raises(ExposureError, match=r"not whole after 5 s: a\.dng .*zeros"):
        bench.fetch(5.0)
    assert bench.nothing_was_kept()


@pytest.mark.parametrize("share", range(1, 20))
def test_a_file_cut_anywhere_is_not_taken_until_it_is_whole(
    bench: WatchedBench, share: int
) -> None:
    cut = len(PHOTO) * share // 20
    bench.put("a.dng", PHOTO[:cut])
    bench.clock.at(3.0, lambda: bench.put("a.dng", PHOTO))
    assert bench.fetch(30.0).read_bytes() == PHOTO


# Once more at the end of the run.


def test_a_photo_is_looked_at_again_at_the_end_of_the_run(bench: WatchedBench) -> None:
    bench.put("a.dng", GOOD)
    raw = bench.readout.fetch(bench.run, "a", 5.0)
    bench.readout.recheck({raw.sha256})
    bench.arm()
    bench.put("b.dng", PHOTO)
    raw = bench.readout.fetch(bench.run, "b", 5.0)
    bench.put("a.dng", DNG)  # of a run before: nobody asks
    bench.readout.recheck({raw.sha256})
    bench.arm()
    bench.put("c.dng", PHOTO)
    raw = bench.readout.fetch(bench.run, "c", 5.0)
    bench.put("c.dng", PHOTO[:-1] + b"x")
    with pytest.raises(ExposureError, match=r"changed after it was taken: c\.dng"):
        bench.readout.recheck({raw.sha256})
    bench.readout.recheck({raw.sha256})  # it is told once


def test_two_photos_of_one_content_are_both_removed(tmp_path: Path) -> None:
    bench = WatchedBench(tmp_path, take="move")
    for name in ("a", "b"):
        bench.arm()
        bench.put(f"{name}.dng", GOOD)
        raw = bench.readout.fetch(bench.run, name, 5.0)
    bench.readout.recheck({raw.sha256})
    assert not list(bench.card.iterdir())


@pytest.mark.parametrize("take", ["copy", "move"])
def test_a_photo_that_was_tidied_up_meanwhile_is_good(tmp_path: Path, take: str) -> None:
    bench = WatchedBench(tmp_path, take=take)
    bench.arm()
    bench.put("a.dng", GOOD)
    raw = bench.readout.fetch(bench.run, "a", 5.0)
    (bench.card / "a.dng").unlink()
    bench.readout.recheck({raw.sha256})


# Nothing is waited for beyond its time.


class Slow(Script):
    """A clock that goes on while something is read."""

    step_ns = 0

    def now_ns(self) -> int:
        if self.step_ns:
            super().sleep_until_ns(super().now_ns() + self.step_ns)
        return super().now_ns()


@pytest.mark.parametrize("what", ["names", "content"])
def test_a_slow_folder_is_given_up_a_second_after_the_deadline(
    bench: WatchedBench, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    if what == "names":
        for number in range(1000):
            (bench.card / f"{number}.jpg").touch()
    else:
        bench.put("a.dng", PHOTO + os.urandom(5 * 2**20))
    slow = Slow()
    monkeypatch.setattr(bench.readout, "_clock", slow)
    monkeypatch.setattr(bench.readout, "_patience", Patience(slow))
    before_ns = slow.now_ns()
    slow.step_ns = 300_000_000
    with pytest.raises(ExposureError, match=r"cannot be read in time|not whole|no RAW file"):
        bench.fetch(1.0)
    slow.step_ns = 0
    # And the steps between two looks: each word of the time takes one.
    assert slow.now_ns() - before_ns <= 1.0e9 + 1.0e9 + 2 * 0.3e9
    assert bench.nothing_was_kept()


@pytest.mark.parametrize("sign", range(1, 12))
def test_a_cancel_is_heard_whatever_goes_on(bench: WatchedBench, sign: int) -> None:
    bench.put("a.dng", PHOTO + os.urandom(3 * 2**20))
    before = bench.signs

    def cancel() -> None:
        if bench.signs == before + sign:
            raise Cancelled("now")

    bench.on_sign = cancel
    with pytest.raises(Cancelled):
        bench.fetch()
    assert bench.nothing_was_kept() and bench.signs == before + sign
