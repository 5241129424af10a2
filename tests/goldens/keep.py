"""Run folders and calibrations, as goldens."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR

from tests.goldens.case import Bench
from tests.goldens.masks import TIMED

AS_THEY_ARE = (".npz", ".npy", ".csv", ".tif", ".toml", ".exr")
PRINTED = re.compile(rb"[ -~]{12,}")
"""What of a picture's file is text, most likely."""
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


def keep_export(bench: Bench, name: str, path: Path) -> None:
    """Keep a picture that was exported: its pixels, and what it says of itself. Its bytes as a
    whole hold the name of a job and times."""
    data = path.read_bytes()
    bench.masks.learn_digest(hashlib.sha256(data).hexdigest(), f"<sha256 of {path.suffix}>")
    pixels: dict[str, Any]
    if path.suffix == ".npz":
        with np.load(path) as found:
            pixels = {key: one for key in found.files if (one := found[key]).dtype.kind != "U"}
            words = [f"{key}: {found[key]}" for key in found.files if key not in pixels]
    elif path.suffix == ".exr":
        file = OpenEXR.File(str(path))
        pixels = {key: one.pixels for key, one in file.channels().items()}
        words = [f"{key}: {said}" for key, said in file.header().items() if key != "channels"]
    else:
        pixels = {"image": cv2.imread(str(path), cv2.IMREAD_UNCHANGED)}
        found_words = _png_words(data) if path.suffix == ".png" else PRINTED.findall(data)
        words = [word.decode("latin-1") for word in found_words]
    bench.keep_arrays(f"{name}-pixels", pixels)
    bench.keep_text(f"{name}-words.txt", "\n".join(words))


def _png_words(data: bytes) -> Iterator[bytes]:
    """What a PNG says beside its pixels."""
    at = 8
    while at + 8 <= len(data):
        size, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        if kind != b"IDAT":
            yield kind + b" " + data[at + 8 : at + 8 + size].replace(b"\0", b" ")
        at += 12 + size


def _learn(bench: Bench, files: dict[str, bytes]) -> None:
    """Digests of files that hold times, by which other files name them."""
    for file, data in files.items():
        digest = hashlib.sha256(data).hexdigest()
        if file.endswith(RAW):
            rest = hashlib.sha256(bench.masks.of_raw(data)).hexdigest()
            bench.masks.learn_digest(digest, f"<without its time: {rest[:32]}>")
        elif TIMED.fullmatch(file):
            bench.masks.learn_digest(digest, f"<sha256 of {file}>")
