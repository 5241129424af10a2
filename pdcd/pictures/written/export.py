"""Pictures of a finished run as files for other programs, with what is known of them inside.

The run is verified first, and left as it is. Values are scene units, as in linear/*.tif; files of
16 bits hold them between a black and a white that the file states.
"""

from __future__ import annotations

import io
import struct
import tempfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Singles
from pdcd.errors import DecodeError, DiskError, RequestError, disk_errors
from pdcd.files.images import encode_png
from pdcd.files.inside import find_name_fault
from pdcd.files.reading import hash_file, refuse_unsound
from pdcd.pictures.decode import convert_record_errors
from pdcd.pictures.upright import FieldSampler, FieldView, find_known_pixels
from pdcd.pictures.written.looks import WHITE_PICTURE, WhiteBalance, balance_by_patch
from pdcd.pictures.written.picture_files import read_tiff
from pdcd.pictures.written.previews import LEAST_PX, MOST_PREVIEW_PX
from pdcd.printable import to_one_line
from pdcd.protocol.result import Quality
from pdcd.runs.manifest import MANIFEST, MAX_MANIFEST_BYTES
from pdcd.runs.record import Manifest
from pdcd.runs.verify import read_whole_manifest
from pdcd.sensor.cells import CellMap
from pdcd.version import __version__

_Words = NDArray[np.uint16]
_Format = Literal["exr", "tiff16", "png16", "npz"]

_ENDINGS: dict[_Format, str] = {"exr": "exr", "tiff16": "tiff", "png16": "png", "npz": "npz"}
_PIXEL = {3: "Bayer quad", 1: "sample"}
"""What a pixel of the camera is, by the number of colours."""
_FULL = 65535
"""Largest value of 16 bits."""
_UNITS = "scene units: a white, fully lit, facing matte surface is 1"
_MOST_UPRIGHT_PX = 16384
"""Widest picture of the field."""
_WHITE_PERCENT = 99.9
"""The usual white is a power of two that so many values of every picture of the run stay below."""


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """What is to be exported, and how.

    pictures : names; () stands for all.
    upright : sampled on the field as the projector sees it, instead of as the camera does.
    white_patch : (x, y) on the field of something to be made grey; None leaves the colours.
    span : black and white of 16-bit files in scene units; None: 0 and what fits the run.
    """

    format: _Format
    pictures: tuple[str, ...] = ()
    upright: bool = False
    white_patch: tuple[float, float] | None = None
    span: tuple[float, float] | None = None


class ExportedFile(msgspec.Struct, frozen=True, kw_only=True):
    """One picture, ready to be written.

    values : numbers of the picture, three a pixel, or one without colours. below, above, unknown :
        those under black, over white, and such as are no number; the first two are 0 where nothing
        is clipped. quality : the verdict on the run; values alone do not show that the camera was
        saturated there.
    """

    picture: str
    name: str
    """Of the file."""
    size_px: tuple[int, int]
    span: tuple[float, float] | None
    values: int
    below: int
    above: int
    unknown: int
    quality: Quality
    data: bytes


def export_run_pictures(
    folder: Path, asked: ExportRequest, alive: Callable[[], None]
) -> tuple[ExportedFile, ...]:
    """The files of a run's pictures.

    Raises DecodeError when the run is not whole and unchanged, and RequestError for a picture that
    it does not have, a span that is none, or a patch where nothing white can be seen.
    """
    _check(asked)
    manifest = read_whole_manifest(folder, alive=alive)
    if "/" in manifest.job or find_name_fault(manifest.job) is not None:
        raise DecodeError(f"{folder}: its job cannot be part of a file's name")
    with refuse_unsound(folder):
        digest = hash_file(folder / MANIFEST, MAX_MANIFEST_BYTES)
    with convert_record_errors(folder):
        images = _images(folder, manifest, alive)
        chosen = _chosen(images, asked.pictures)
        record = manifest.run
        cells = record.cells or CellMap(grid=record.grid, frame=_frame(images))
        view = FieldView.of(record, cells)
        balance = _balance(images, view, asked)
        factors = np.array(balance.factors, np.float32)
        images = {name: image * factors for name, image in images.items()}
        span = (asked.span or (0.0, _usual_white(images))) if "16" in asked.format else None
        if asked.upright:
            images = _upright({name: images[name] for name in chosen}, view)
    told = _told(manifest, digest, asked, balance)
    quality = manifest.quality
    return tuple(
        _file(name, images[name], asked.format, told, span, quality, alive) for name in chosen
    )


def _check(asked: ExportRequest) -> None:
    if asked.span is None:
        return
    black, white = asked.span
    if not (np.isfinite(asked.span).all() and black < white):
        raise RequestError(
            f"a range from {black:g} to {white:g} is not one", hint="black comes first"
        )
    if "16" not in asked.format:
        raise RequestError(f"{asked.format} files need no range", hint="they hold every value")


def _images(folder: Path, manifest: Manifest, alive: Callable[[], None]) -> dict[str, Singles]:
    """All linear pictures of a run, the white one first."""
    names = [n for n in manifest.files if n.startswith("linear/") and n.endswith(".tif")]
    found = {}
    for name in sorted(names, key=lambda n: (n != f"linear/{WHITE_PICTURE}.tif", n)):
        found[Path(name).stem] = read_tiff(folder / name)
        alive()
    if not found:
        raise DecodeError(f"{folder} has no pictures", hint="is it a run of pdcd?")
    return found


def _chosen(images: dict[str, Singles], asked: Sequence[str]) -> tuple[str, ...]:
    for name in asked:
        if name not in images:
            raise RequestError(
                f"the run has no picture {name!r}", hint=f"it has {', '.join(sorted(images))}"
            )
    return tuple(dict.fromkeys(asked or images))


def _frame(images: dict[str, Singles]) -> tuple[int, int]:
    """Rows and columns of all pictures. Raises DecodeError where they differ."""
    shapes = {image.shape[:2] for image in images.values()}
    if len(shapes) != 1:
        raise DecodeError("its pictures differ in size", hint="it was not written by pdcd")
    rows, cols = shapes.pop()
    return rows, cols


def _balance(images: dict[str, Singles], view: FieldView, asked: ExportRequest) -> WhiteBalance:
    image = next(iter(images.values()))
    if asked.white_patch is None:
        return WhiteBalance.none(image)
    sampler = FieldSampler(view, view.size_px(LEAST_PX, MOST_PREVIEW_PX))
    shown, known = sampler(image, find_known_pixels(image))
    found = balance_by_patch(shown, known, asked.white_patch)
    if found is None:
        x, y = asked.white_patch
        raise RequestError(
            f"nothing white can be seen at {x:g} {y:g}", hint="look at preview/white.png"
        )
    return found


def _usual_white(images: dict[str, Singles]) -> float:
    tops = []
    for image in images.values():
        values = image[np.isfinite(image)]
        tops.append(float(np.percentile(values, _WHITE_PERCENT)) if values.size else 0.0)
    top = max(tops)
    return float(2.0 ** np.ceil(np.log2(top))) if top > 0.0 else 1.0


def _upright(images: dict[str, Singles], view: FieldView) -> dict[str, Singles]:
    """The pictures on the field; NaN where the camera does not see it."""
    sampler = FieldSampler(view, view.size_px(1, _MOST_UPRIGHT_PX))
    found = {}
    for name, image in images.items():
        shown, known = sampler(image, find_known_pixels(image))
        shown[~known] = np.nan
        found[name] = shown
    return found


def _told(
    manifest: Manifest, digest: str, asked: ExportRequest, balance: WhiteBalance
) -> dict[str, str]:
    """What every file says of itself, whatever its picture and format."""
    factors = " ".join(f"{factor:.6g}" for factor in balance.factors)
    if asked.white_patch is not None:
        factors += ", by a patch at {:g} {:g}".format(*asked.white_patch)
    told = {
        "job": manifest.job,
        "goal": manifest.run.goal.name,
        "units": _UNITS,
        "geometry": "the field, as the projector sees it"
        if asked.upright
        else f"the camera's own, a pixel for each {_PIXEL[len(balance.factors)]}",
        "white_balance": factors,
        "scene": "virtual" if manifest.mock else "real",
        "taken_utc": manifest.started_utc,
        "taken_by": f"pdcd {manifest.versions.get('pdcd', '?')}",
        "manifest_sha256": digest,
        "verdict": manifest.quality.verdict,
    }
    return {name: to_one_line(words) for name, words in told.items()}


def _file(
    picture: str,
    image: Singles,
    format_: _Format,
    told: dict[str, str],
    span: tuple[float, float] | None,
    quality: Quality,
    alive: Callable[[], None],
) -> ExportedFile:
    alive()
    told = {"picture": picture, **told}
    software = f"pdcd {__version__}"
    known = np.isfinite(image)
    below = above = 0
    if span is None:
        told = {**told, "scale": "1", "software": software}
        data = exr_bytes(image, told) if format_ == "exr" else _npz_bytes(image, told)
    else:
        black, white = span
        scaled = np.where(
            known, (image.astype(np.float64) - black) * (_FULL / (white - black)), 0.0
        )
        below, above = int((scaled < -0.5).sum()), int((scaled > _FULL + 0.5).sum())
        words = np.rint(np.clip(scaled, 0.0, _FULL)).astype(np.uint16)
        told = {
            **told,
            "black": f"0 is {black:.9g}",
            "white": f"{_FULL} is {white:.9g}",
            "scale": f"{_FULL / (white - black):.9g} steps for 1; linear",
        }
        data = (tiff_bytes if format_ == "tiff16" else png_bytes)(words, told, software)
    height, width, _ = image.shape
    return ExportedFile(
        picture=picture,
        name=f"{told['job']}-{picture}.{_ENDINGS[format_]}",
        size_px=(width, height),
        span=span,
        values=image.size,
        below=below,
        above=above,
        unknown=int(known.size - known.sum()),
        quality=quality,
        data=data,
    )


def _npz_bytes(image: Singles, told: dict[str, str]) -> bytes:
    """`image` (h, w, 3) float32, and a field of text for each line of `told`."""
    file = io.BytesIO()
    fields = {name: np.array(words) for name, words in told.items()}
    np.savez_compressed(file, allow_pickle=False, image=image, **fields)
    return file.getvalue()


def exr_bytes(image: Singles, told: Mapping[str, str]) -> bytes:
    """An OpenEXR file of a picture (h, w, 3) float32, linear RGB, or (h, w, 1), luminance;
    every bit of it comes back.

    told : attributes, names of up to 31 ASCII letters.
    """
    import OpenEXR

    channels = {"RGB": np.ascontiguousarray(image)}
    if image.shape[2] == 1:
        channels = {"Y": np.ascontiguousarray(image[..., 0])}
    head = {**told, "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    # The library writes to a name only, and tells of a full disk in an error of no kind.
    with (
        disk_errors(tempfile.gettempdir()),
        tempfile.NamedTemporaryFile(suffix=".exr") as file,
    ):
        try:
            with OpenEXR.File(head, channels) as made:
                made.write(file.name)
        except RuntimeError as err:
            raise DiskError(f"cannot write {file.name}: {err}", hint="is the disk full?") from err
        return Path(file.name).read_bytes()


def tiff_bytes(image: _Words, told: Mapping[str, str], software: str) -> bytes:
    """A picture (h, w, 3) or (h, w, 1) uint16 as an uncompressed TIFF file.

    Each line of `told` becomes one of the ImageDescription. All text is ASCII.
    """
    import tifffile

    photometric, shown = ("rgb", image) if image.shape[2] == 3 else ("minisblack", image[..., 0])
    lines = _ascii("\n".join(f"{name}: {words}" for name, words in told.items()))
    file = io.BytesIO()
    tifffile.imwrite(
        file,
        shown,
        photometric=photometric,
        description=lines,
        software=_ascii(software),
        metadata=None,
    )
    return file.getvalue()


def png_bytes(image: _Words, told: Mapping[str, str], software: str) -> bytes:
    """A picture (h, w, 3) or (h, w, 1) uint16 as a PNG file; a gAMA chunk says that it is linear.

    Each line of `told` becomes a tEXt chunk. All text is ASCII.
    """
    chunks = _chunk(b"gAMA", struct.pack(">I", 100_000))
    for name, words in {**told, "Software": software}.items():
        chunks += _chunk(b"tEXt", f"{name}\0{_ascii(words)}".encode("ascii"))
    data, after_header = encode_png(image), 8 + 12 + 13
    return data[:after_header] + chunks + data[after_header:]


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _ascii(words: str) -> str:
    return words.encode("ascii", "backslashreplace").decode("ascii")
