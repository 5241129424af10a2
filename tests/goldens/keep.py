"""Run folders and calibrations, as goldens."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from tests.goldens.case import Bench
from tests.goldens.masks import TIMED

AS_THEY_ARE = (".npz", ".npy", ".csv", ".tif", ".toml", ".exr")
RAW = (".dng", ".cr2", ".CR2")


def keep_run(bench: Bench, folder: Path, name: str = "run", *, page: bool = False) -> None:
    """Keep every file of a run or calibration: numbers as they are, records covered, pictures and
    photos by their digest. page : keep the text of report.html, too, to look at what differs."""
    files = {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    _learn(bench, files)
    for file, data in files.items():
        keep_file(bench, f"{name}/{file}", data, page=page)


def keep_file(bench: Bench, name: str, data: bytes, *, page: bool = False) -> None:
    """Keep one file of a run, under a name."""
    if name.endswith(".json"):
        bench.keep_json(name.removesuffix(".json"), json.loads(data))
    elif name.endswith(".jsonl"):
        lines = [json.loads(line) for line in data.decode().splitlines()]
        bench.keep_json(name.removesuffix(".jsonl"), lines)
    elif name.endswith((".html", ".sha256")):
        text = bench.masks.of_text(data.decode())
        bench.keep_sum(name, text.encode())
        if page or name.endswith(".sha256"):
            bench.keep_text(name + ".txt", text)
    elif name.endswith(RAW):
        bench.keep_sum(name, bench.masks.of_raw(data))
    elif name.endswith(AS_THEY_ARE):
        bench.keep_bytes(name, data)
    else:
        bench.keep_sum(name, data)


def _learn(bench: Bench, files: dict[str, bytes]) -> None:
    """Digests of files that hold times, by which other files name them."""
    for file, data in files.items():
        digest = hashlib.sha256(data).hexdigest()
        if file.endswith(RAW):
            rest = hashlib.sha256(bench.masks.of_raw(data)).hexdigest()
            bench.masks.learn_digest(digest, f"<without its time: {rest[:32]}>")
        elif TIMED.fullmatch(file):
            bench.masks.learn_digest(digest, f"<sha256 of {file}>")
