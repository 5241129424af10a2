"""RAW files that are damaged, unfinished or odd, put to what reads photos and to a watched folder.

What is taken is judged by what was written, or by a second decoder of the same bytes.
"""

from __future__ import annotations

import os
import random
import subprocess
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import rawpy
import tifffile
from numpy.typing import NDArray

from pdcd.errors import DecodeError, ExposureError
from pdcd.sensor.mosaic import open_raw, read_mosaic
from pdcd.sensor.raw import RAW_SUFFIXES, read_raw
from tests.cr2 import write_cr2
from tests.form_dng import DngFile, write_dng_form
from tests.tools import program
from tests.watched_bench import WatchedBench

SHAPE = 192, 256
CUTS = 20
FOLDER_S, DELAYS_S = 5.0, (0.1, 0.3, 0.7, 0.9, 1.3, 2.0, 5.0, 12.0, 30.0)
Samples = NDArray[np.generic]


@dataclass
class Outcome:
    """What became of the files.

    kinds : by kind of damage, taken or refused. wrong : a taken photo with samples that the file
    does not have, or an error that is none of a photo. over_s : longest wait beyond a deadline.
    judges : who judged those that were taken.
    """

    kinds: Counter[str] = field(default_factory=Counter)
    judges: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    over_s: float = 0.0

    def told(self) -> str:
        """The figures in words."""
        kinds = ", ".join(f"{n} {kind}" for kind, n in sorted(self.kinds.items()))
        judges = ", ".join(f"{n} by {judge}" for judge, n in sorted(self.judges.items()))
        return (
            f"{kinds}\njudged: {judges}\n"
            f"longest wait beyond a deadline {self.over_s:.2f} s; {len(self.wrong)} wrong"
        )


def make_formats(folder: Path, seed: int) -> dict[str, bytes]:
    """Whole files of eleven forms by a name that ends like theirs."""
    rng = np.random.default_rng(seed)
    light = rng.normal(1500.0, 30.0, SHAPE).round().astype(np.uint16)
    real = rng.uniform(0.01, 0.9, SHAPE)
    bright = DngFile(floating=True, bits=32, white=1, black=((0.0,),))
    forms = {
        "one strip": DngFile(),
        "12 bits, big-endian": DngFile(bits=12, order=">"),
        "strips": DngFile(strip_rows=16),
        "tiles": DngFile(tile=(64, 64), order=">"),
        "black of zero": DngFile(black=((0.0,),), strip_rows=32),
        "lossless JPEG": DngFile(packing=7, white=16383),
        "JPEG tiles": DngFile(packing=7, white=16383, tile=(64, 64)),
        "real numbers": replace(bright, tile=(64, 64)),
        "deflated": replace(bright, packing=8, strip_rows=24),
    }
    path = folder / "made"
    made = {
        f"{name}.dng": write_dng_form(path, real if form.floating else light, form)
        for name, form in forms.items()
    }
    write_cr2(path, rng.integers(1100, 14000, SHAPE).astype(np.uint16))
    made["canon.cr2"] = path.read_bytes()
    made["panasonic.rw2"] = _make_rw2(rng)
    return made


def _make_rw2(rng: np.random.Generator) -> bytes:
    from tests.unit.sensor.test_raw_absent import rw2

    return rw2(rng.integers(0, 256, 11 * 0x4000, np.uint8).tobytes(), 12)


def read_samples(path: Path) -> Samples:
    """All samples of a sensor, by the program. Raises DecodeError for a file that is refused."""
    read_raw(path)
    with open_raw(path.read_bytes(), path.name) as raw:
        return np.array(read_mosaic(raw).sensor)


def list_damage(data: bytes) -> Iterator[tuple[str, bytes]]:
    """The same file cut, with a tail of zeros and with holes, at twenty places each."""
    size = len(data)
    for number in range(CUTS):
        there = size * number // CUTS
        yield "cut", data[:there]
        yield "zeroed tail", data[:there] + bytes(size - there)
        hole = max(size // 10, 4096)
        yield "hole", (data[:there] + bytes(hole) + data[there + hole :])[:size]


def mutate(data: bytes, rng: random.Random) -> bytes:
    """The same file with some bytes changed, moved, lost or more than there were; mostly heads."""
    made = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        reach = min(len(made), rng.choice((64, 500, 1200, len(made)))) or 1
        at, count = rng.randrange(reach), rng.choice((1, 2, 4, 4, 64, 2000))
        how = rng.randrange(6)
        if how == 0:
            made[at : at + count] = rng.randbytes(count)
        elif how == 1:
            made[at : at + 1] = bytes([made[at] ^ 1 << rng.randrange(8)]) if at < len(made) else b""
        elif how == 2:
            made[at : at + count] = rng.choice((b"\0", b"\xff")) * count
        elif how == 3:
            other = rng.randrange(len(made) or 1)
            made[at : at + count] = made[other : other + count]
        elif how == 4:
            del made[at : at + count]
        else:
            made[at:at] = rng.randbytes(count)
    return bytes(made)


def judge_samples(path: Path, mine: Samples) -> tuple[str, bool]:
    """Who else decodes a file, and whether to the same samples; "nobody" where none can."""
    found: dict[str, Callable[[Path], Samples]] = {
        "dcraw": _read_by_dcraw, "tifffile": _read_by_tifffile, "rawpy": _read_by_rawpy
    }  # fmt: skip
    if mine.dtype.kind == "f":
        del found["rawpy"]  # LibRaw scales real numbers by their maximum
    said = "nobody"
    for judge, read in found.items():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                theirs = read(path)
        except Exception:
            continue
        if theirs.shape == mine.shape and np.array_equal(theirs, mine.astype(theirs.dtype)):
            return judge, True
        said = judge
    return said, said == "nobody"


def _read_by_dcraw(path: Path) -> Samples:
    command = [program("dcraw"), "-E", "-4", "-t", "0", "-c", str(path)]
    pgm = subprocess.run(command, capture_output=True, check=True, timeout=20.0).stdout
    _, size, _, samples = pgm.split(b"\n", 3)
    columns, rows = map(int, size.split())
    return np.frombuffer(samples, ">u2").reshape(rows, columns)


def _read_by_tifffile(path: Path) -> Samples:
    with tifffile.TiffFile(path) as file:
        return np.asarray(max(file.pages, key=lambda page: page.size).asarray())


def _read_by_rawpy(path: Path) -> Samples:
    with rawpy.imread(str(path)) as raw:
        return np.array(raw.raw_image)


def trial(folder: Path, seed: int, mutated: int) -> Outcome:
    """Every damage of every form, and so many mutated files."""
    outcome = Outcome()
    rng = random.Random(seed)
    made = make_formats(folder, seed)
    whole: dict[str, Samples] = {}
    for name, data in made.items():
        (folder / name).write_bytes(data)
        whole[name] = read_samples(folder / name)
        for kind, damaged in list_damage(data):
            _read(folder / name, damaged, kind, outcome, whole[name])
    for _ in range(mutated):
        name = rng.choice(sorted(made))
        _read(folder / name, mutate(made[name], rng), "mutated", outcome, None)
    _watch(folder, made, rng, outcome)
    return outcome


def _read(path: Path, data: bytes, kind: str, outcome: Outcome, whole: Samples | None) -> None:
    """One file, whose samples must be the whole one's, or those of a second decoder."""
    path.write_bytes(data)
    try:
        mine = read_samples(path)
    except DecodeError:
        outcome.kinds[f"{kind}, refused"] += 1
        return
    except Exception as err:
        outcome.wrong.append(f"{kind} {path.name}: {err!r}")
        _keep(path, outcome)
        return
    outcome.kinds[f"{kind}, taken"] += 1
    if whole is None:
        judge, same = judge_samples(path, mine)
    else:
        judge, same = "what was written", np.array_equal(mine, whole)
    outcome.judges[judge] += 1
    if not same:
        outcome.wrong.append(f"{kind} {path.name}: {judge} finds other samples")
        _keep(path, outcome)


def _keep(path: Path, outcome: Outcome) -> None:
    if kept := os.environ.get("PDCD_KEEP"):
        number = len(outcome.wrong)
        Path(kept, f"{number}-{path.name}").write_bytes(path.read_bytes())


def _watch(folder: Path, made: dict[str, bytes], rng: random.Random, outcome: Outcome) -> None:
    """Every damage in a watched folder: waited for until it is whole, or given up in time."""
    bench = WatchedBench(folder, f_number="auto")
    for number, (name, data) in enumerate(made.items()):
        suffix = Path(name).suffix
        assert suffix in RAW_SUFFIXES
        for place, (kind, damaged) in enumerate(list_damage(data)):
            late_s = rng.choice((*DELAYS_S, None))
            _fetch(bench, f"{number}-{place}{suffix}", damaged, data, late_s, kind, outcome)


def _fetch(
    bench: WatchedBench, name: str, first: bytes, whole: bytes, late_s: float | None, kind: str,
    outcome: Outcome,
) -> None:  # fmt: skip
    """A file that is whole after so long, or never; what is taken is the whole one."""
    bench.arm()
    bench.put(name, first)
    if late_s is not None:
        bench.clock.at(late_s, lambda: bench.put(name, whole))
    timeout_s = FOLDER_S if late_s is None else late_s + FOLDER_S
    begun_ns = bench.clock.now_ns()
    try:
        data = bench.fetch(timeout_s).read_bytes()
    except (ExposureError, DecodeError) as err:
        outcome.kinds["in the folder, refused"] += 1
        if late_s is not None:
            outcome.wrong.append(f"{kind} {name}: whole at {late_s} s, and {err}")
    else:
        outcome.kinds["in the folder, taken"] += 1
        outcome.judges["what was written"] += 1
        if data != whole:
            outcome.wrong.append(f"{kind} {name}: taken before it was whole")
    over_s: float = (bench.clock.now_ns() - begun_ns) * 1e-9 - timeout_s
    outcome.over_s = max(outcome.over_s, over_s)
    for path in (*bench.run.iterdir(), *bench.card.iterdir()):
        path.unlink()
