"""Runs that were interrupted, by doing so: what they tell, and what is made of what they left."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import pdcd
from pdcd.bench.tables import CameraConfig
from pdcd.capture import salvage
from pdcd.capture.engine import Engine
from pdcd.capture.salvage import decode_partial
from pdcd.cli.main import main
from pdcd.codes.pilot.codes import SCOUTS
from pdcd.errors import BusyError, DecodeError, RequestError
from pdcd.files.inside import open_folder
from pdcd.pictures.decode import decode_folder
from pdcd.protocol.events import DecodingStarted, Event, ShotArmed
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import RunFolder, read_manifest
from pdcd.runs.ledger import read_ledger
from pdcd.runs.place import HeldFolder
from pdcd.runs.verify import verify_run
from tests import bench_rig

BLACKS = {"goal": "indirect", "codes": 8, "black_level": "both"}


def run(folder: Path, after: int, **fields: Any) -> CaptureResult:
    """A run that is cancelled when its shot after so many is armed, or after them all, when they
    are to be decoded; with more than that not at all."""
    folder.mkdir(exist_ok=True)
    config = bench_rig.config(folder, camera=CameraConfig(noise="none", f_number=8.0))
    engine = Engine.from_config(config)
    armed = []

    def emit(event: Event) -> None:
        if isinstance(event, ShotArmed | DecodingStarted):
            armed.append(event)

    request = msgspec.convert({**BLACKS, "out": str(folder), **fields}, CaptureRequest)
    engine.start()
    try:
        return engine.capture(request, job="job", emit=emit, cancelled=lambda: len(armed) > after)
    finally:
        engine.stop()


def left(folder: Path, after: int, **fields: Any) -> Path:
    """The `.partial` of such a run."""
    result = run(folder, after, **fields)
    assert result.state == "cancelled" and result.folder is not None
    return Path(result.folder)


KILLS = """
import os, signal, sys
from pathlib import Path
import pdcd.capture.salvage as salvage
import tests.e2e.capture.test_partial as t
from pdcd.capture.job import Journal
from pdcd.protocol.events import DecodingStarted

def die():
    os.kill(os.getpid(), signal.SIGKILL)

def capture(folder):
    notify = Journal.notify
    def told(self, event):
        notify(self, event)
        if isinstance(event, DecodingStarted):
            die()
    Journal.notify = told
    t.run(folder, 99)

def decode(folder):
    write = salvage.write_pictures
    def written(folder, decoded):
        write(folder, decoded)
        die()
    salvage.write_pictures = written
    salvage.decode_partial(folder / "job.partial")

for work in (capture, decode):
    pid = os.fork()
    if not pid:
        try:
            work(Path(sys.argv[1]))
        finally:
            os._exit(1)
    assert os.waitpid(pid, 0)[1] == signal.SIGKILL, work
"""


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def taken(path: Path) -> list[str]:
    with open_folder(path) as descriptor:
        return [entry.shot.name for entry in read_ledger(descriptor).taken]


def test_a_run_that_is_cut_says_which_shots_it_lacks(tmp_path: Path) -> None:
    whole = run(tmp_path / "whole", 99)
    assert whole.state == "done" and whole.folder is not None and "taken" not in whole.summary
    names = [shot.name for shot in read_manifest(Path(whole.folder)).run.shots]
    assert len(names) >= 4
    cut = run(tmp_path / "cut", 2)
    expected = f"2 of {len(names)} shots, missing: {', '.join(names[2:])}"
    assert cut.summary == {"taken": expected} and cut.folder is not None
    last = json.loads((Path(cut.folder) / "log.jsonl").read_text().splitlines()[-1])
    assert last["event"] == "cancelled" and last["taken"] == expected
    assert taken(Path(cut.folder)) == names[:2]


@pytest.mark.long
def test_after_a_kill_the_run_is_finished_as_if_nothing_had_been(tmp_path: Path) -> None:
    """The daemon is killed when all photos are there, then the first attempt to decode them."""
    killed = tmp_path / "killed"
    subprocess.run([sys.executable, "-c", KILLS, str(killed)], timeout=150, check=True)
    partial = killed / "job.partial"
    (broken,) = [p for p in killed.iterdir() if "decoded" in p.name]
    assert broken.name.endswith(".partial") and (broken / "probe.npz").exists()
    assert not (broken / "capture.json").exists() and not verify_run(broken).whole
    before = contents(partial)
    found = decode_partial(partial)
    assert found.state == "done" and not found.missing and not found.lost
    assert contents(partial) == before
    made = Path(found.folder)
    assert made == killed / "job" and verify_run(made).whole
    wanted = run(tmp_path / "whole", 99)
    assert wanted.folder is not None
    kept, again = contents(Path(wanted.folder)), contents(made)
    pictures = {n for n in kept if n.startswith(("linear/", "preview/")) or n == "probe.npz"}
    assert len(pictures) >= 3
    for name in pictures - {"probe.npz"}:
        assert again[name] == kept[name], name
    with np.load(Path(wanted.folder) / "probe.npz") as a, np.load(made / "probe.npz") as b:
        np.testing.assert_array_equal(a["image"], b["image"])
    assert main(["decode", str(made)]) == 0
    with pytest.raises(Exception, match="is there already"):
        decode_partial(partial)


def test_pictures_of_what_is_there_go_into_a_folder_that_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    partial = left(tmp_path / "cut", 2)
    before = contents(partial)
    out = tmp_path / "out"
    assert main(["decode", str(partial), "--partial", "--out", str(out)]) == 5
    printed = capsys.readouterr().out
    assert "missing: " in printed and "2 of " in printed
    assert contents(partial) == before
    made = out / "job-partial"
    manifest = read_manifest(made)
    assert manifest.state == "partial" and manifest.missing
    assert len(manifest.run.shots) == 2
    looked = verify_run(made)
    assert not looked.whole
    assert [finding.what for finding in looked.findings] == ["partial"]
    assert all(name in looked.findings[0].detail for name in manifest.missing)
    assert main(["verify", str(made)]) == 5
    assert "PARTIAL" in capsys.readouterr().out
    assert any("white is made of 1 of 4 shots" in text for text in manifest.warnings)
    with pytest.raises(DecodeError, match="not all shots"):
        decode_folder(made)


def test_a_run_of_which_only_the_pictures_were_missing_warns_as_any_other(tmp_path: Path) -> None:
    fields = {"black_level": "none", "white": False, "exposure_s": 20.0}
    whole = run(tmp_path / "whole", 99, **fields)
    assert whole.state == "done" and any("saturated" in text for text in whole.warnings)
    found = decode_partial(left(tmp_path / "cut", 1, **fields))
    assert found.state == "done"
    *warnings, last = read_manifest(Path(found.folder)).warnings
    assert tuple(warnings) == whole.warnings and last.startswith("decoded after")


def test_complete_parts_and_repetitions_make_the_answer(tmp_path: Path) -> None:
    fields = {"black_level": "none", "codes": 16, "white": False}
    parts = decode_partial(left(tmp_path / "parts", 3, parts=4, **fields))
    assert parts.taken == "3 of 4 shots, missing: coded-4"
    manifest = read_manifest(Path(parts.folder))
    assert manifest.summary["parts"] == 3 and manifest.realised["coded"]["diagonal_max"] == 0.0
    copies = decode_partial(left(tmp_path / "copies", 2, repeat=3, **fields))
    assert copies.missing == ("coded-3",)
    with np.load(Path(copies.folder) / "probe.npz") as found:
        assert np.isfinite(found["image"]).all() and found["image"].max() > 0.0


def test_a_pilot_that_was_cut_is_no_coded_photo(tmp_path: Path) -> None:
    fields = {"pilot": 32, "codes": 48, "black_level": "none"}
    found = decode_partial(left(tmp_path / "scouts", SCOUTS - 1, **fields))
    assert found.state == "partial" and found.missing[-1] == "coded"
    assert re.search(r" and \d+ more$", found.taken)
    manifest = read_manifest(Path(found.folder))
    assert "the answer is missing; white stands in its place" in manifest.warnings
    assert manifest.quality.verdict == "bad"
    assert manifest.quality.reasons[0].startswith("the picture indirect that was asked for is")
    # The scouts saw nothing: the plan was changed, and by it only the coded photo is missing.
    stopped = decode_partial(left(tmp_path / "stopped", SCOUTS + 1, **fields))
    assert stopped.missing == ("coded",)
    assert any(
        text.startswith("the pilot ended") for text in read_manifest(Path(stopped.folder)).warnings
    )
    with pytest.raises(DecodeError, match="no picture can be made of what is there: 0 of"):
        decode_partial(left(tmp_path / "none", 0))


ENOUGH = {"codes": 64, "parts": 8, "until_error": 0.9, "white": False}


def test_parts_beyond_what_was_good_enough_are_not_missing(tmp_path: Path) -> None:
    partial = left(tmp_path / "cut", 5, black_level="auto", **ENOUGH)
    names = taken(partial)
    assert names == ["coded-1", "coded-2", "coded-3", "coded-4"]
    (partial / "raw" / "look-dark.dng").unlink()
    found = decode_partial(partial, tmp_path / "whole")
    assert found.state == "done" and not found.missing and len(found.lost) == 1
    assert verify_run(Path(found.folder)).whole
    (partial / "raw" / "coded-2.dng").unlink()
    found = decode_partial(partial, tmp_path / "partial")
    assert found.state == "partial" and found.missing == ("coded-2",)
    assert read_manifest(Path(found.folder)).summary["parts"] == 3


def flip(path: Path, at: int = -1) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.chmod(0o600)
    path.write_bytes(bytes(data))


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("codes.npz", "codes.npz"),
        ("frames.csv", "frames.csv: it is not as it was written"),
        ("ledger.jsonl", "ledger.jsonl is damaged"),
    ],
)
def test_what_decoding_rests_on_must_be_as_it_was(tmp_path: Path, file: str, words: str) -> None:
    partial = left(tmp_path / "cut", 3)
    flip(partial / file, at=len((partial / file).read_bytes()) // 2)
    with pytest.raises(DecodeError, match=words):
        decode_partial(partial)
    assert sorted(p.name for p in (tmp_path / "cut").iterdir() if p.is_dir()) == ["job.partial"]
    (partial / file).unlink()
    with pytest.raises(DecodeError):
        decode_partial(partial)


@pytest.mark.parametrize("attack", ["flip", "remove", "link", "cut"])
def test_a_photo_that_is_not_as_it_came_is_missing(tmp_path: Path, attack: str) -> None:
    partial = left(tmp_path / "cut", 3)
    photo = partial / "raw" / f"{taken(partial)[-1]}.dng"
    if attack == "flip":
        flip(photo)
    elif attack == "cut":
        os.truncate(photo, photo.stat().st_size - 1)
    else:
        photo.rename(tmp_path / "elsewhere.dng")
        if attack == "link":
            photo.symlink_to(tmp_path / "elsewhere.dng")
    found = decode_partial(partial)
    assert found.state == "partial" and found.missing[0] == photo.stem
    assert len(found.lost) == 1 and photo.name in found.lost[0]
    assert not (Path(found.folder) / "raw" / photo.name).exists()


@pytest.mark.parametrize("photo", ["look-room", "pilot-0003"])
def test_photos_that_all_others_rest_on_must_be_there(tmp_path: Path, photo: str) -> None:
    """In a run that was killed once all of them had been taken."""
    size = {"size_px": [64, 48]}
    tables = {"projector": size, "mask": size, "camera": {"frame_quads": [64, 48]}}
    with pdcd.local({**tables, "scene": {"grid": [6, 8]}}, folder=tmp_path) as bench:
        done = bench.capture("indirect", codes=128, progress=False).folder
    partial = done.rename(done.with_name(f"{done.name}.partial"))
    for name in ("capture.json", "capture.json.sha256", f"raw/{photo}.dng"):
        (partial / name).unlink()
    with pytest.raises(DecodeError) as told:
        decode_partial(partial)
    assert told.value.message == f"no picture can be made without raw/{photo}.dng: it is missing"
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == [partial.name]


def test_a_log_without_end_is_not_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = left(tmp_path, 5)
    monkeypatch.setattr(salvage, "_MOST_LOG_BYTES", 1000)
    os.truncate(folder / "log.jsonl", 2**32)
    made = Path(decode_partial(folder).folder)
    assert (made / "log.jsonl").stat().st_size == 1000
    text = "left out: all but the first 1000 of 4294967296 bytes of log.jsonl"
    assert text in read_manifest(made).warnings


def test_a_line_that_was_half_written_is_left_out(tmp_path: Path) -> None:
    """As a cut of the power leaves it: the shot whose line it is does not count."""
    partial = left(tmp_path / "cut", 3)
    names = taken(partial)
    ledger = partial / "ledger.jsonl"
    data = ledger.read_bytes().rstrip(b"\n")
    cut = data[: -len(data.splitlines()[-1]) // 2]
    ledger.write_bytes(cut)
    with (partial / "frames.csv").open("a") as file:
        file.write("coded,0,1,0")
    assert taken(partial) == names[:2]
    assert decode_partial(partial).missing[0] == names[2]
    # A line amid the others cannot be taken out: what follows speaks of it.
    lines = data.splitlines()
    ledger.write_bytes(b"\n".join([*lines[:2], *lines[3:], b""]))
    with pytest.raises(DecodeError, match="does not follow"):
        decode_partial(partial)


def test_a_disk_without_locks_is_no_hindrance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    partial = left(tmp_path / "cut", 3)

    def refuse(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    assert decode_partial(partial).state == "partial"


def test_what_was_decoded_already_is_said_before_it_is_decoded_again(tmp_path: Path) -> None:
    partial = left(tmp_path / "cut", 3)
    made = Path(decode_partial(partial).folder)
    before = contents(tmp_path)
    with pytest.raises(RequestError, match=rf"{made} is there already \(.*--out"):
        decode_partial(partial)
    assert contents(tmp_path) == before
    assert decode_partial(partial, tmp_path / "out").state == "partial"


def test_a_run_that_goes_on_is_left_alone(tmp_path: Path) -> None:
    with HeldFolder.at(tmp_path) as place, RunFolder(place, "job") as folder:
        folder.create(min_free_bytes=0)
        with pytest.raises(BusyError, match="still being filled"):
            decode_partial(tmp_path / "job.partial")
    with pytest.raises(DecodeError, match="ledger"):
        decode_partial(tmp_path / "job.partial")
    (tmp_path / "done").mkdir()
    (tmp_path / "circle").symlink_to("circle")
    for name in ("done", "circle"):
        with pytest.raises(RequestError, match="not an unfinished run"):
            decode_partial(tmp_path / name)
