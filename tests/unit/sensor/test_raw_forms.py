"""Forms of DNG against the specification's sums, in plain loops, and against other programs."""

from __future__ import annotations

import itertools
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from pdcd.sensor.mosaic import open_raw, read_mosaic
from pdcd.sensor.raw import read_raw
from tests.form_dng import DngFile, write_dng_form
from tests.tools import needs, program

SHAPE = 56, 72
_RNG = np.random.default_rng(38)
FOUR = ((233.0, 277.0, 268.0, 263.0), (277.0, 244.0, 281.0, 250.0), (288.0, 249.0, 251.0, 253.0),
        (249.0, 278.0, 241.0, 235.0))  # fmt: skip
QUAD = (248.0, 255.0), (262.0, 271.0)
FRACTIONS = (255.25, 256.5), (258.75, 257.1)
DOWN = tuple(float(n % 24) for n in range(SHAPE[0]))
ACROSS = tuple(-0.5 * (n % 7) for n in range(SHAPE[1]))
EVEN, ODD, ODD_ROWS = (4, 16, 52, 72), (3, 17, 51, 71), (3, 16, 51, 70)
GREEN_FIRST = 1, 0, 2, 1


def of(area: tuple[int, int, int, int], **said: Any) -> DngFile:
    """With differences for the rows and columns of a picture that is not the whole sensor."""
    down, across = DOWN[: area[2] - area[0]], ACROSS[: area[3] - area[1]]
    return DngFile(active=area, down=down, across=across, **said)


BLACKS = {
    "one": DngFile(),
    "2x2": DngFile(black=QUAD),
    "4x4": DngFile(black=FOUR),
    "1x4": DngFile(black=((244.0, 251.0, 266.0, 283.0),)),
    "3x1": DngFile(black=((244.0,), (251.0,), (266.0,))),
    "2x1": DngFile(black=((244.0,), (266.0,))),
    "1x2": DngFile(black=((244.0, 266.0),)),
    "3x3": DngFile(black=tuple(row[:3] for row in FOUR[:3])),
    "3x4, odd area": of(ODD, black=FOUR[:3], cfa=GREEN_FIRST),
    "8x2": DngFile(black=FOUR[0:4] + FOUR[0:4]),
    "fractions": DngFile(black=FRACTIONS),
    "down": DngFile(down=DOWN),
    "across": DngFile(across=ACROSS),
    "all": DngFile(black=FOUR, down=DOWN, across=ACROSS),
    "even area": of(EVEN, black=QUAD),
    "odd area": DngFile(black=QUAD, active=ODD),
    "odd rows": DngFile(black=QUAD, active=ODD_ROWS),
    "odd area, all": of(ODD, black=FOUR),
    "odd area, fractions": of(ODD, black=FRACTIONS, cfa=GREEN_FIRST),
    "no black": DngFile(black=((0.0,),)),
}
SAMPLES = {
    "8 bits": DngFile(bits=8, black=((16.0,),), white=255),
    "10 bits": DngFile(bits=10, black=((64.0,),), white=1023),
    "12 bits": DngFile(bits=12, black=QUAD),
    "14 bits": DngFile(bits=14, black=FOUR, active=ODD),
    "12 bits, tiles": DngFile(bits=12, tile=(16, 32)),
    "14 bits, strips": DngFile(bits=14, strip_rows=9),
    "16 bits, strips": DngFile(strip_rows=16, active=EVEN),
    "16 bits, tiles": DngFile(tile=(16, 16), black=FRACTIONS),
    "9 bits": DngFile(bits=9, black=((30.0,),), white=511, strip_rows=5),
    "16 bits, strips, odd area": DngFile(strip_rows=7, active=ODD, black=FOUR),
    "table": DngFile(bits=12, table=tuple(range(0, 3 * 1400, 3)), white=4196),
    "lossless JPEG": DngFile(packing=7, white=16383, active=ODD, black=QUAD),
    "lossless JPEG, tiles": DngFile(packing=7, white=16383, tile=(16, 32), black=FOUR),
}
FLOATS = {
    "16-bit real": DngFile(bits=16),
    "24-bit real": DngFile(bits=24, strip_rows=16),
    "32-bit real": DngFile(bits=32, tile=(16, 32)),
    "16-bit real, deflated": DngFile(bits=16, packing=8, predictor=34894, tile=(16, 32)),
    "24-bit real, deflated": DngFile(bits=24, packing=8, predictor=34894, tile=(16, 48)),
    "32-bit real, deflated": DngFile(bits=32, packing=8, predictor=3, tile=(32, 32)),
    "32-bit real, X4": DngFile(bits=32, packing=8, predictor=34895, strip_rows=20),
    "32-bit real, plain deflate": DngFile(bits=32, packing=8, active=ODD),
}
FORMS: dict[str, tuple[DngFile, NDArray[Any]]] = {}
for _name, _file in (BLACKS | SAMPLES).items():
    _low = int(max(map(max, _file.black))) + 30
    _high = 1390 if _file.table else _file.white - 20
    _values = _RNG.integers(_low if not _file.table else 130, _high, SHAPE)
    FORMS[_name] = _file, _values
for _name, _file in FLOATS.items():
    _real = _RNG.uniform(0.01, 0.9, SHAPE).astype(np.float16).astype(np.float64)
    _real[20, 30] = 4.0  # nothing may be scaled by it
    _black = ((0.0,),) if _file.active is None else ((0.125, 0.25), (0.0625, 0.5))
    FORMS[_name] = DngFile(**(vars(_file) | {"floating": True, "white": 1, "black": _black})), _real
TIFFFILE_READS = "16-bit real", "32-bit real", "32-bit real, plain deflate"
ORDERS = pytest.mark.parametrize("order", ["<", ">"])


def sums(file: DngFile, stored: NDArray[Any]) -> NDArray[np.float64]:
    """(4, h, w) samples minus black, one by one as chapter 5 of the specification has them, of
    those quads of R, G, G and B that lie whole in the ActiveArea."""
    top, left, bottom, right = file.active or (0, 0, *stored.shape)
    rows, columns = (bottom - top) // 2, (right - left) // 2
    red = next(n for n in range(4) if file.cfa[n] == 0)
    blue = 3 - red
    wanted = np.empty((4, rows, columns))
    for row, column in itertools.product(range(2 * rows), range(2 * columns)):
        value = float(stored[row + top, column + left])
        if file.table:
            value = float(file.table[int(value)])
        black = file.black[row % len(file.black)][column % len(file.black[0])]
        black += file.down[row] if file.down else 0.0
        black += file.across[column] if file.across else 0.0
        place = 2 * (row % 2) + column % 2
        same_row = place // 2 == red // 2
        plane = 0 if place == red else 3 if place == blue else 1 if same_row else 2
        wanted[plane, row // 2, column // 2] = value - black
    return wanted


@ORDERS
@pytest.mark.parametrize("name", FORMS)
def test_samples_less_the_black_of_their_place(tmp_path: Path, name: str, order: str) -> None:
    file, stored = FORMS[name]
    file = DngFile(**(vars(file) | {"order": order}))
    write_dng_form(tmp_path / "a.dng", stored, file)
    frame = read_raw(tmp_path / "a.dng")
    np.testing.assert_allclose(frame.planes, sums(file, stored), atol=2e-3 if not file.floating
                               else 0.0, rtol=0.0)  # fmt: skip
    assert frame.white == file.white and frame.doubts == ()
    assert frame.saturated.sum() == int(file.floating)  # the spot of 4.0
    assert frame.f_number == 2.8


@needs("dcraw")
@ORDERS
@pytest.mark.parametrize(
    "name",
    # dcraw reads no real numbers, and of tiles only compressed ones
    [n for n, (f, _) in FORMS.items() if not f.floating and not (f.tile and f.packing == 1)],
)
def test_dcraw_finds_the_samples_that_were_written(tmp_path: Path, name: str, order: str) -> None:
    """Those of the picture, black included."""
    file, stored = FORMS[name]
    write_dng_form(tmp_path / "a.dng", stored, DngFile(**(vars(file) | {"order": order})))
    command = [program("dcraw"), "-4", "-D", "-t", "0", "-c", str(tmp_path / "a.dng")]
    pgm = subprocess.run(command, capture_output=True, check=True).stdout
    _, size, _, samples = pgm.split(b"\n", 3)
    columns, rows = map(int, size.split())
    top, left, bottom, right = file.active or (0, 0, *SHAPE)
    wanted = (np.array(file.table)[stored] if file.table else stored)[top:bottom, left:right]
    theirs = np.frombuffer(samples, ">u2").reshape(rows, columns)
    np.testing.assert_array_equal(theirs, wanted)


@ORDERS
@pytest.mark.parametrize("name", ["16 bits, tiles", *TIFFFILE_READS])
def test_tifffile_finds_the_samples_that_were_written(
    tmp_path: Path, name: str, order: str
) -> None:
    """Of those that dcraw does not read, as far as it has the codecs."""
    file, stored = FORMS[name]
    write_dng_form(tmp_path / "a.dng", stored, DngFile(**(vars(file) | {"order": order})))
    with tifffile.TiffFile(tmp_path / "a.dng") as opened:
        theirs = opened.pages[0].asarray()
    top, left, bottom, right = file.active or (0, 0, *SHAPE)
    with open_raw((tmp_path / "a.dng").read_bytes(), "a.dng") as raw:
        ours = np.array(read_mosaic(raw).sensor)
    np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(theirs[top:bottom, left:right], stored[top:bottom, left:right])


@needs("exiftool")
def test_the_levels_are_those_that_exiftool_reads(tmp_path: Path) -> None:
    """And the planes what the sums make of them. In one call: it takes long to begin."""
    for number, (file, stored) in enumerate(FORMS.values()):
        for order, end in (("<", "le"), (">", "be")):
            path = tmp_path / f"{number}-{end}.dng"
            write_dng_form(path, stored, DngFile(**(vars(file) | {"order": order})))
    tags = ["BlackLevel", "BlackLevelRepeatDim", "BlackLevelDeltaH", "BlackLevelDeltaV",
            "WhiteLevel", "ActiveArea", "FNumber", "CFAPattern2", "LinearizationTable"]  # fmt: skip
    command = [program("exiftool"), "-j", "-n", "-b", *(f"-{tag}" for tag in tags), str(tmp_path)]
    found = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    assert len(found) == 2 * len(FORMS)
    for said in found:
        path = Path(said["SourceFile"])
        file, stored = list(FORMS.values())[int(path.stem.split("-")[0])]
        frame = read_raw(path)
        assert (frame.white, frame.f_number) == (said["WhiteLevel"], said["FNumber"])

        def of(tag: str, said: dict[str, Any] = said) -> list[float]:
            return [float(word) for word in str(said.get(tag, "")).split()]

        rows, columns = map(int, of("BlackLevelRepeatDim"))
        area = tuple(map(int, of("ActiveArea"))) or None
        theirs = DngFile(
            black=np.reshape(of("BlackLevel"), (rows, columns)).tolist(),
            down=of("BlackLevelDeltaV"),
            across=of("BlackLevelDeltaH"),
            active=area,  # type: ignore[arg-type]
            cfa=[int(colour) for colour in of("CFAPattern2")],
            table=[int(level) for level in of("LinearizationTable")],
        )
        np.testing.assert_allclose(frame.planes, sums(theirs, stored), atol=2e-3, rtol=0.0)
        assert theirs.active == file.active
