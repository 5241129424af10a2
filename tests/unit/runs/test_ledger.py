"""The ledger of a run: what is written comes back, and damage is noticed line by line."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from pdcd.errors import DecodeError
from pdcd.files.inside import open_folder
from pdcd.runs import ledger as module
from pdcd.runs.ledger import (
    ConvergenceEntry,
    RunLedger,
    RunStart,
    WarningEntry,
    read_ledger,
    read_run_start,
)
from pdcd.runs.record import FileRecord, MeterRecord, ShotRecord

BEGUN = RunStart(
    job="one", mock=True, owner={}, started_utc="2026", request={}, plan={}, versions={},
    git_commit=None, drivers={}, config={},
)  # fmt: skip
SHOT = ShotRecord(
    name="a", window="whole", raw="a.dng", sha256="0" * 64, size_bytes=1, iso=100, f_number=8.0,
    open_ns=0, close_ns=1, end_ns=(1, 1), refreshes=1, missed=0, source="mock", verified=True,
)  # fmt: skip


def written(folder: Path, descriptor: int) -> RunLedger:
    place: Any = SimpleNamespace(path=folder, fd=descriptor, where=folder)
    return RunLedger(place)


def record(data: bytes) -> FileRecord:
    return FileRecord(hashlib.sha256(data).hexdigest(), len(data))


def test_what_was_written_is_read_again(tmp_path: Path) -> None:
    (tmp_path / "m.dng").write_bytes(b"meter")
    meter = MeterRecord(raw="m.dng", f_number=8.0, peak=0.5)
    with open_folder(tmp_path) as folder:
        told = written(tmp_path, folder)
        told.begin(BEGUN)
        assert read_ledger(folder) == module.LedgerContents(begun=BEGUN)
        told.meter(meter)
        pieces = (b"head\nfirst\n", b"second\n")
        for number, piece in enumerate(pieces):
            with (tmp_path / "frames.csv").open("ab") as frames:
                frames.write(piece)
            told.take(msgspec.structs.replace(SHOT, name=str(number)))
        told.warn("it was dark")
        told.warn("it is late")
        told.enough()
        kept = read_ledger(folder)
        first, size = read_run_start(folder)
    assert kept.begun == first == BEGUN and size == (tmp_path / "ledger.jsonl").stat().st_size
    assert kept.metered == (module.MeterEntry(meter=meter, file=record(b"meter")),)
    assert [one.shot.name for one in kept.taken] == ["0", "1"]
    assert [one.frames for one in kept.taken] == [record(piece) for piece in pieces]
    assert kept.warnings == ("it was dark", "it is late") and kept.enough
    assert kept.planned is None and kept.run is None


def lines(*entries: module.LedgerEntry) -> list[bytes]:
    digest, found = "", []
    for entry in entries:
        said = msgspec.json.encode(entry)
        digest = hashlib.sha256(digest.encode() + said).hexdigest()
        found.append(b'{"said":%s,"sha256":"%s"}\n' % (said, digest.encode()))
    return found


SOUND = lines(BEGUN, WarningEntry(text="a"), WarningEntry(text="b"), ConvergenceEntry())


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "does not begin"),
        (SOUND[0][:-1], "does not begin"),  # not written to its end
        (b"".join(lines(ConvergenceEntry())), "does not begin"),
        (b"".join(lines(BEGUN, BEGUN)), "begins twice"),
        (SOUND[0] + SOUND[2], "line 2 does not follow"),
        (SOUND[0] + SOUND[2] + SOUND[1], "line 2 does not follow"),
        (SOUND[0] + SOUND[1] + SOUND[1], "line 3 does not follow"),
        (SOUND[0] + SOUND[1].replace(b'"a"', b'"x"'), "line 2 does not follow"),
        (SOUND[0] + b"\n" + SOUND[1], "line 2: "),
        (SOUND[0] + b'{"said":{"entry":"sung"},"sha256":"00"}\n', "line 2"),
        (b"".join(lines(BEGUN, {"entry": "sung"})), "line 2: "),  # type: ignore[arg-type]
    ],
)
def test_a_line_that_was_changed_lost_or_moved_is_damage(
    data: bytes, words: str, tmp_path: Path
) -> None:
    (tmp_path / "ledger.jsonl").write_bytes(data)
    with open_folder(tmp_path) as folder, pytest.raises(DecodeError, match=words):
        read_ledger(folder)


@pytest.mark.parametrize("cut_off", [1, 10, len(SOUND[3])])
def test_a_last_line_that_was_not_written_to_its_end_is_left_out(
    cut_off: int, tmp_path: Path
) -> None:
    (tmp_path / "ledger.jsonl").write_bytes(b"".join(SOUND)[:-cut_off])
    with open_folder(tmp_path) as folder:
        kept = read_ledger(folder)
    assert kept.warnings == ("a", "b") and not kept.enough


def test_of_a_long_ledger_only_the_beginning_is_read_where_that_is_wanted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ledger.jsonl").write_bytes(b"".join(SOUND))
    with open_folder(tmp_path) as folder:
        monkeypatch.setattr(module, "MAX_FIRST_BYTES", len(SOUND[0]))
        assert read_run_start(folder) == (BEGUN, len(SOUND[0]))
        monkeypatch.setattr(module, "MAX_FIRST_BYTES", len(SOUND[0]) - 1)
        with pytest.raises(DecodeError, match="does not begin"):
            read_run_start(folder)
        (tmp_path / "ledger.jsonl").write_bytes(b"".join(lines(ConvergenceEntry())))
        with pytest.raises(DecodeError, match="does not begin"):
            read_run_start(folder)


def test_no_ledger_or_an_endless_one_is_told_as_such(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_folder(tmp_path) as folder:
        with pytest.raises(DecodeError, match=r"no readable ledger\.jsonl: No such file"):
            read_ledger(folder)
        (tmp_path / "ledger.jsonl").write_bytes(b"".join(SOUND))
        monkeypatch.setattr(module, "MAX_LEDGER_BYTES", 10)
        with pytest.raises(DecodeError, match="more than the 10 allowed"):
            read_ledger(folder)


def test_the_disk_is_waited_for_now_and_then_and_all_of_it_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, synced = 0.0, []
    monkeypatch.setattr("pdcd.runs.ledger.time.monotonic", lambda: now_s)
    monkeypatch.setattr(
        "pdcd.runs.ledger.os.fsync",
        lambda fd: synced.append(Path(f"/proc/self/fd/{fd}").readlink().name),
    )
    for name in ("a.dng", "frames.csv", "codes.npz"):
        (tmp_path / name).write_bytes(b"x")
    with open_folder(tmp_path) as folder:
        told = written(tmp_path, folder)
        told.begin(BEGUN)
        told.take(SHOT)
        now_s = 0.999
        told.warn("not yet")
        assert synced == []
        now_s = 1.0
        told.warn("now")
        assert synced == ["a.dng", "frames.csv", "ledger.jsonl"]
        told.take(SHOT)
        now_s = 1.999
        told.enough()
        assert len(synced) == 3
        now_s = 2.0
        nothing: Any = None
        told.plan({}, nothing)
    assert synced[3:] == ["a.dng", "codes.npz", "frames.csv", "ledger.jsonl"]
    assert json.loads((tmp_path / "ledger.jsonl").read_text().splitlines()[-1])["said"][
        "codes"
    ] == msgspec.to_builtins(record(b"x"))
