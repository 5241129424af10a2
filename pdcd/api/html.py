"""How a run looks in a notebook: its previews, small, and its figures; all texts escaped."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pdcd.errors import DecodeError
from pdcd.printable import as_html
from pdcd.protocol.result import Figure, Quality

WIDTH_PX = 320
"""Width of a preview in a notebook; larger ones are drawn smaller."""
QUALITY = 85
"""Of JPEG: a page of a notebook holds many pictures."""

FIGURES = (
    ("codes", "codes", "{:.0f}"),
    ("parts", "parts", "{:.0f}"),
    ("exposure_s", "exposure", "{:.3g} s"),
    ("missed_refreshes", "missed refreshes", "{:.0f}"),
)
SHARES = (
    ("rms_sigma", "RMS sigma"),
    ("rms_error_quads", "RMS error of quads"),
    ("rms_error_cells", "RMS error of cells"),
)


@dataclass(frozen=True)
class RunCard:
    """What a notebook shows of a run; `pdcd.api.run.Run` fills it in.

    previews : pictures by name with the bytes of their PNG files, the first to be shown first.
    """

    job: str
    goal: str
    folder: Path
    summary: Mapping[str, Figure]
    quality: Quality
    warnings: Sequence[str]
    previews: Iterable[tuple[str, bytes]]


def run_html(run: RunCard) -> str:
    """A run as HTML without script, style sheet or network."""
    return (
        f"<div><p><b>{as_html(run.goal)}</b> <code>{as_html(run.job)}</code></p>"
        f"{_previews(run.previews)}{_table(run)}{_notes(run)}</div>"
    )


def table_html(heads: list[str], rows: list[list[str]]) -> str:
    """A table of texts."""
    head = "".join(f"<th>{as_html(name)}</th>" for name in heads)
    body = "".join(
        f"<tr>{''.join(f'<td>{as_html(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _table(run: RunCard) -> str:
    summary = run.summary
    rows = [[name, form.format(v)] for key, name, form in FIGURES if (v := summary.get(key))]
    for key, name in SHARES:
        share = summary.get(key)
        if isinstance(share, float):
            rows.append([name, f"{100.0 * share:.3g} %"])
    rows.append(["folder", os.path.relpath(run.folder) if _near(run.folder) else str(run.folder)])
    return table_html(["verdict", run.quality.verdict], rows)


def _near(folder: Path) -> bool:
    return folder.is_relative_to(Path.cwd())


def _notes(run: RunCard) -> str:
    told = (*run.quality.reasons, *run.quality.remarks, *run.warnings)
    items = "".join(f"<li>{as_html(note)}</li>" for note in told)
    return f"<ul>{items}</ul>" if items else ""


def _previews(previews: Iterable[tuple[str, bytes]]) -> str:
    figures = []
    for name, content in previews:
        try:
            data = _small(name, content)
        except DecodeError:
            continue  # a view for eyes; whoever asks for the numbers is told
        source = "data:image/jpeg;base64," + base64.b64encode(data).decode("ascii")
        figures.append(
            f'<img src="{source}" alt="{as_html(name)}" title="{as_html(name)}" width="{WIDTH_PX}">'
        )
    return f"<p>{' '.join(figures)}</p>" if figures else ""


def _small(name: str, content: bytes) -> bytes:
    """A picture as a JPEG file of at most the width wanted. Raises DecodeError."""
    import cv2

    try:
        image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise DecodeError(f"{name} is no picture")
        height = max(1, round(image.shape[0] * WIDTH_PX / image.shape[1]))
        if image.shape[1] > WIDTH_PX:
            image = cv2.resize(image, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)
        return bytes(cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, QUALITY))[1])
    except cv2.error as err:
        raise DecodeError(f"{name} is damaged: {err.err}") from err
