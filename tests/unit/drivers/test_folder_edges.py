"""The folder readout at its edges: bounds of what is taken, faults, and what is left behind."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.folder import FolderOptions, FolderReadout
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import CameraSettings, DriverContext
from pdcd.bench.tables import CameraConfig, Config
from pdcd.errors import ConfigError, DecodeError, DeviceLost, ExposureError, NoSpaceError
from pdcd.sensor.dng import encode_dng
from pdcd.sensor.profile import load_profile

MS = 1_000_000


def dng(iso: int = 100, f_number: float | None = 8.0) -> bytes:
    mosaic = np.full((24, 24), 700, np.uint16)
    return encode_dng(
        mosaic, black=512, white=16383, iso=iso, exposure_s=0.5, f_number=f_number, model="m",
        date=datetime(2024, 1, 1),
    )  # fmt: skip


DNG = dng()


class Bench:
    """A folder that is watched, one for the run, and the readout between them."""

    def __init__(self, root: Path, f_number: float | str = 8.0, **options: Any) -> None:
        self.card, self.run = root / "card", root / "run"
        self.card.mkdir()
        self.run.mkdir()
        self.clock, self.signs = VirtualClock(), 0
        camera = CameraConfig(
            f_number=f_number,  # type: ignore[arg-type]
            responsivity_e=(1.0, 2.0, 3.0),
            options={"folder": str(self.card), **options},
        )
        context = DriverContext(config=Config(camera=camera), clock=self.clock, alive=self._alive)
        self.readout = FolderReadout.create(context)

    def _alive(self) -> None:
        self.signs += 1

    def arm(self, f_number: float | None = None) -> None:
        self.readout.arm(CameraSettings(iso=100, f_number=f_number))

    def fetch(self, timeout_s: float = 5.0) -> Path:
        return self.readout.fetch(self.run, "shot", timeout_s).path


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    made = Bench(tmp_path)
    made.arm()
    return made


def test_a_folder_says_what_its_sensor_is(bench: Bench) -> None:
    info = bench.readout.connect()
    profile = load_profile(CameraConfig().profile)
    assert (info.model, info.serial) == (f"files in {bench.card}", "")
    assert (info.profile, info.isos, info.f_numbers) == (CameraConfig().profile, profile.isos, ())
    assert info.frame_quads == profile.frame_quads
    assert tuple(info.responsivity_e) == (1.0, 2.0, 3.0)


def test_an_iso_that_the_sensor_lacks_is_refused_and_nothing_is_armed(bench: Bench) -> None:
    with pytest.raises(ConfigError, match=r"no ISO 77 \(take one of 100"):
        bench.readout.arm(CameraSettings(iso=77, f_number=None))
    (bench.card / "a.dng").write_bytes(DNG)
    bench.fetch()


@pytest.mark.parametrize(
    ("asked", "said", "taken"),
    [
        (8.0, 8.47, True),
        (8.0, 8.49, False),
        (8.0, 7.53, True),
        (8.0, 7.51, False),
        (5.6, 5.66, True),
        (3.5, 3.56, True),
        (16.0, 8.0, False),
    ],
)
def test_nominal_and_true_apertures_differ_by_six_hundredths(
    tmp_path: Path, asked: float, said: float, taken: bool
) -> None:
    bench = Bench(tmp_path)
    bench.arm(asked)  # what was asked for, not what is configured
    (bench.card / "a.dng").write_bytes(dng(f_number=said))
    if taken:
        assert bench.fetch().exists()
    else:
        with pytest.raises(ExposureError, match=rf"at f/{said:g}, not f/{asked:g}"):
            bench.fetch()


def test_where_no_aperture_is_asked_for_any_will_do(tmp_path: Path) -> None:
    bench = Bench(tmp_path, f_number="auto")
    bench.arm()
    (bench.card / "a.dng").write_bytes(dng(f_number=22.0))
    assert bench.fetch().exists()


def test_a_file_that_tells_no_iso_is_believed(bench: Bench) -> None:
    (bench.card / "a.dng").write_bytes(dng(iso=0))
    assert bench.fetch().exists()


@pytest.mark.parametrize(("before_s", "taken"), [(1.9, True), (2.1, False), (-100.0, True)])
def test_dates_may_be_two_seconds_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before_s: float, taken: bool
) -> None:
    monkeypatch.setattr("time.time_ns", lambda: 1_700_000_000 * 10**9)
    bench = Bench(tmp_path)
    bench.arm()
    path = bench.card / "a.dng"
    path.write_bytes(DNG)
    at_ns = 1_700_000_000 * 10**9 - round(before_s * 1e9)
    os.utime(path, ns=(at_ns, at_ns))
    if taken:
        assert bench.fetch().exists()
    else:
        with pytest.raises(ExposureError, match=r"a\.dng is new but dated 2 s before"):
            bench.fetch()


# Waiting.


def test_a_folder_is_looked_at_every_poll_and_once_more_at_the_end(tmp_path: Path) -> None:
    bench = Bench(tmp_path, poll_s=0.3)
    bench.arm()
    before_ns = bench.clock.now_ns()
    with pytest.raises(ExposureError, match=r"no RAW file came into .* within 1 s \(is"):
        bench.fetch(1.0)
    assert bench.clock.now_ns() == before_ns + 1000 * MS
    assert bench.signs == 5  # at 0, 0.3, 0.6, 0.9 and 1 s


def test_a_file_that_is_there_at_the_last_look_is_taken(tmp_path: Path) -> None:
    bench = Bench(tmp_path, poll_s=0.5, looks=3)
    bench.arm()
    (bench.card / "a.dng").write_bytes(DNG)
    assert bench.fetch(1.0).exists()


def test_a_file_that_needs_one_more_look_is_not(tmp_path: Path) -> None:
    bench = Bench(tmp_path, poll_s=0.5, looks=3)
    bench.arm()
    (bench.card / "a.dng").write_bytes(DNG)
    with pytest.raises(ExposureError, match=r"not whole after 0\.5 s: a\.dng"):
        bench.fetch(0.5)


def test_only_new_files_of_the_suffixes_count(tmp_path: Path) -> None:
    bench = Bench(tmp_path, suffixes=[".xyz"])
    bench.arm()
    (bench.card / "a.dng").write_bytes(DNG)
    (bench.card / "b.XYZ").write_bytes(DNG)
    assert bench.fetch().name == "shot.xyz"


# Faults.


def refusing(number: int) -> Callable[..., Any]:
    def refuse(*_: Any, **__: Any) -> Any:
        raise OSError(number, os.strerror(number))

    return refuse


@pytest.mark.parametrize(
    ("number", "kind", "words"),
    [
        (errno.ENOSPC, NoSpaceError, r"no space left for shot\.dng"),
        (errno.EDQUOT, NoSpaceError, r"no space left for shot\.dng"),
        (errno.EIO, DecodeError, r"cannot copy .*a\.dng to .*shot\.dng: Input/output error"),
    ],
)
def test_a_copy_that_fails_leaves_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, number: int, kind: type[Exception], words: str
) -> None:
    (bench.card / "a.dng").write_bytes(DNG)
    whole = Path.open

    class Copy:
        def __init__(self, file: Any) -> None:
            self.file = file

        def __enter__(self) -> Copy:
            return self

        def __exit__(self, *_: object) -> None:
            self.file.close()

        write = staticmethod(refusing(number))

    def opened(path: Path, mode: str = "r", *more: Any) -> Any:
        file = whole(path, mode, *more)
        return Copy(file) if mode == "xb" else file

    monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(kind, match=words):
        bench.fetch()
    assert not list(bench.run.iterdir())


def test_a_copy_that_is_broken_off_leaves_nothing(bench: Bench) -> None:
    def alive() -> None:
        if any(bench.run.iterdir()):
            raise KeyboardInterrupt

    bench.readout._alive = alive
    (bench.card / "a.dng").write_bytes(DNG)
    with pytest.raises(KeyboardInterrupt):
        bench.fetch()
    assert not list(bench.run.iterdir()) and (bench.card / "a.dng").exists()


def test_a_file_that_changes_while_it_is_copied_is_refused(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = bench.card / "a.dng"
    source.write_bytes(DNG)
    whole = Path.open

    def opened(path: Path, mode: str = "r", *more: Any) -> Any:
        if path == source and mode == "rb" and bench.signs >= 4:
            source.write_bytes(DNG + b"more")
        return whole(path, mode, *more)

    monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(ExposureError, match=r"a\.dng changed while it was copied \(raise looks"):
        bench.fetch()
    assert not list(bench.run.iterdir())


def test_a_long_copy_shows_that_it_lives(bench: Bench) -> None:
    blocks = 3
    (bench.card / "a.dng").write_bytes(DNG + bytes(blocks * (1 << 20) - len(DNG)))
    raw = bench.readout.fetch(bench.run, "shot", 5.0)
    assert raw.size_bytes == blocks << 20
    assert bench.signs == 4 + blocks  # four looks, and each block of a MiB


@pytest.mark.parametrize("error", [RuntimeError("a bug"), KeyboardInterrupt()])
def test_whatever_goes_wrong_while_it_is_checked_nothing_is_left(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise error

    monkeypatch.setattr("drivers.folder.read_raw", fail)
    (bench.card / "a.dng").write_bytes(DNG)
    with pytest.raises(type(error)):
        bench.fetch()
    assert not list(bench.run.iterdir())
    assert (bench.card / "a.dng").exists()


def test_a_folder_that_may_not_be_read_is_lost(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "scandir", refusing(errno.EACCES))
    with pytest.raises(DeviceLost, match=r"cannot read the folder .*card: Permission denied"):
        bench.readout.connect()

    def fail(*_: Any) -> Any:
        raise RuntimeError("a bug")

    monkeypatch.setattr(os, "scandir", fail)
    with pytest.raises(RuntimeError, match="a bug"):
        bench.readout.connect()


def test_a_file_that_goes_while_it_is_looked_at_is_passed_over(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    (bench.card / "a.dng").write_bytes(DNG)
    (bench.card / "gone.dng").symlink_to(bench.card / "nowhere")
    assert bench.fetch().exists()


def test_a_file_that_cannot_be_read_is_said_to_be_so_by_the_copy(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    (bench.card / "a.dng").write_bytes(DNG)
    monkeypatch.setattr(Path, "read_bytes", refusing(errno.EACCES))
    real, denied = Path.open, refusing(errno.EACCES)
    monkeypatch.setattr(
        Path, "open", lambda path, *how: denied() if path.parent == bench.card else real(path, *how)
    )
    with pytest.raises(DecodeError, match=r"Permission denied \(may the daemon read"):
        bench.fetch()
    assert not list(bench.run.iterdir())


def test_an_empty_file_is_not_whole(bench: Bench) -> None:
    (bench.card / "a.dng").touch()
    with pytest.raises(ExposureError, match=r"not whole after 5 s: a\.dng \(0 bytes\)"):
        bench.fetch()


# Its options.


def test_what_is_not_said_is_a_copy_of_what_stays_the_same_for_four_looks() -> None:
    made = msgspec.convert({"folder": "/x"}, FolderOptions)
    assert (made.take, made.poll_s, made.looks, made.check_date) == ("copy", 0.2, 4, True)
    assert ".dng" in made.suffixes and ".cr2" in made.suffixes
    with pytest.raises(AttributeError):
        made.looks = 2  # type: ignore[misc]
    with pytest.raises(TypeError):
        FolderOptions("/x")  # type: ignore[call-arg]
    with pytest.raises(msgspec.ValidationError, match="folders"):
        msgspec.convert({"folder": "/x", "folders": "/y"}, FolderOptions)


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("poll_s", [0.01, 10.0], [0.009, 10.001]),
        ("looks", [2, 100], [1, 101]),
        ("suffixes", [[".x"]], [[]]),
        ("take", ["copy", "move"], ["steal"]),
    ],
)
def test_options_have_their_bounds(name: str, good: list[Any], bad: list[Any]) -> None:
    for value in good:
        msgspec.convert({"folder": "/x", name: value}, FolderOptions)
    for value in bad:
        with pytest.raises(msgspec.ValidationError, match=name):
            msgspec.convert({"folder": "/x", name: value}, FolderOptions)
