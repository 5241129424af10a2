"""How a run and a table look in a notebook: HTML without script, style sheet or network."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from pdcd.errors import DecodeError
from pdcd.pages.render import render
from pdcd.printable import to_percent
from pdcd.protocol.result import Quality, SummaryValue

_TEMPLATE = "notebook.html"
_WIDTH_PX = 320
"""Width of a preview in a notebook; larger ones are drawn smaller."""
_QUALITY = 85
"""JPEG quality; a page of a notebook holds many pictures."""

_FIGURES = (
    ("codes", "codes", "{:.0f}"),
    ("parts", "parts", "{:.0f}"),
    ("exposure_s", "exposure", "{:.3g} s"),
    ("missed_refreshes", "missed refreshes", "{:.0f}"),
)
_SHARES = (
    ("rms_sigma", "RMS sigma"),
    ("rms_error_quads", "RMS error of pixels"),
    ("rms_error_cells", "RMS error of cells"),
)


def format_run_html(
    job: str,
    goal: str,
    folder: Path,
    summary: Mapping[str, SummaryValue],
    quality: Quality,
    warnings: Sequence[str],
    previews: Iterable[tuple[str, bytes]],
) -> str:
    """A run: previews, a line for each known figure, and the verdict with reasons and warnings.

    previews : names of pictures with the bytes of their PNG files, in the order to show them.
    """
    rows = [(name, form.format(v)) for key, name, form in _FIGURES if (v := summary.get(key))]
    shares = ((name, summary.get(key)) for key, name in _SHARES)
    rows += [(name, to_percent(v)) for name, v in shares if isinstance(v, float)]
    near = folder.is_relative_to(Path.cwd())
    rows.append(("folder", os.path.relpath(folder) if near else str(folder)))
    return render(
        _TEMPLATE,
        title=(goal, job),
        previews=list(_shown(previews)),
        width_px=_WIDTH_PX,
        heads=("verdict", quality.verdict),
        rows=rows,
        notes=(*quality.reasons, *quality.remarks, *warnings),
    )


def format_table_html(heads: Sequence[str], rows: Sequence[Sequence[str]], note: str = "") -> str:
    """A table of texts, and a note below it."""
    notes = (note,) if note else ()
    return render(_TEMPLATE, previews=(), heads=heads, rows=rows, notes=notes)


def _shown(previews: Iterable[tuple[str, bytes]]) -> Iterator[tuple[str, str]]:
    """Names and data of pictures. A picture that cannot be read is left out, as previews are only
    to look at: reading its numbers raises an error."""
    for name, content in previews:
        try:
            yield name, base64.b64encode(_small(name, content)).decode("ascii")
        except DecodeError:
            continue


def _small(name: str, content: bytes) -> bytes:
    """A picture as a JPEG file, at most `_WIDTH_PX` wide. Raises DecodeError."""
    import cv2

    try:
        image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise DecodeError(f"{name} is no picture")
        height = max(1, round(image.shape[0] * _WIDTH_PX / image.shape[1]))
        if image.shape[1] > _WIDTH_PX:
            image = cv2.resize(image, (_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
        return bytes(cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, _QUALITY))[1])
    except cv2.error as err:
        raise DecodeError(f"{name} is damaged: {err.err}") from err
