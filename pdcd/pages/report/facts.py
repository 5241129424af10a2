"""The words and tables of a page: verdict, figures, request, plan, rig, versions, files.

Everything here is plain text; `pdcd.pages.render` escapes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pdcd.bench.tables import PanelConfig
from pdcd.pages.report.material import Material
from pdcd.pages.report.timeline import MOST_SHOTS
from pdcd.printable import to_percent
from pdcd.runs.record import Manifest
from pdcd.words import SIGMA_KINDS

_Rows = list[tuple[str, str]]
MOST_ROWS = 400
"""Most rows of a table; a page says how many more there are."""
_MOST_LETTERS = 4096


@dataclass(frozen=True)
class ReportTable:
    """Rows below a title; `heads` if rows have more than a name and a value. A `closed` table opens
    at a click."""

    title: str
    rows: Sequence[Sequence[str]]
    heads: Sequence[str] = ()
    closed: bool = False
    note: str = ""


def _in(form: str) -> Callable[[Any], str]:
    """A function that writes a value in a format; "-" for None."""
    return lambda value: "-" if value is None else form.format(value)


_Column = tuple[str, str, Callable[[Any], str]]
"""Head of a column, name of its value, and how to write it."""
_SUMMARY: tuple[_Column, ...] = (
    ("error of pixels against the known truth", "rms_error_quads", to_percent),
    ("error of means over cells", "rms_error_cells", to_percent),
    ("error expected (RMS sigma)", "rms_sigma", to_percent),
    ("error bars", "error_bars", str),
    ("absolute scale", "scale", str),
    ("error of the scale, common to all", "scale_sigma", to_percent),
    ("error foreseen by the plan", "predicted_error", to_percent),
    ("cells of which nothing is known", "blind_share", to_percent),
    ("field in the projector's picture", "field", str),
    ("codes", "codes", str),
    ("exposure", "exposure_s", _in("{:.3f} s")),
    ("refreshes", "refreshes", str),
    ("missed refreshes", "missed_refreshes", str),
    ("shots", "shots", str),
    ("wall time", "wall_s", _in("{:.2f} s")),
)
_BUDGET: tuple[_Column, ...] = (
    ("shot", "name", str),
    ("exposure", "exposure_s", _in("{:.3f} s")),
    ("ISO", "iso", str),
    ("f/", "f_number", _in("{:g}")),
    ("mask open", "open", to_percent),
    ("lit and seen", "lit", to_percent),
    ("other paths", "others", to_percent),
    ("mean electrons", "electrons", _in("{:.4g}")),
    ("brightest, of full", "full", to_percent),
    ("saturated", "saturated", to_percent),
)
_REALISED: tuple[_Column, ...] = (
    ("divided by", "weight_s", _in("{:.4g} s")),
    ("direct light off, mean", "diagonal_mean", to_percent),
    ("direct, worst", "diagonal_max", to_percent),
    ("other paths off, RMS", "off_rms", to_percent),
    ("worst cell", "off_rms_worst", to_percent),
    ("worst path", "off_max", to_percent),
)


def list_key_figures(manifest: Manifest, material: Material) -> _Rows:
    """The first lines: the picture's quality and its cost; unknown figures are left out."""
    told = {
        **manifest.summary,
        "error_bars": SIGMA_KINDS.get(material.kind, material.kind),
        "field": _field(manifest.run.projector),
    }
    rows = [(words, _known(told.get(key), write)) for words, key, write in _SUMMARY]
    return [(name, value) for name, value in rows if value]


def _field(projector: PanelConfig) -> str:
    """Where the field lies, in words, if that was measured."""
    if projector.field_px is None:
        return ""
    left, top, wide, high = projector.field_px
    return f"{wide} x {high} pixels from ({left}, {top}) on"


def list_tables(manifest: Manifest, material: Material) -> Iterator[ReportTable]:
    """All tables of a page, in order."""
    yield _budget(material)
    if material.errors:
        yield _errors(material)
    yield _realised(manifest)
    yield ReportTable("What was asked", _flat(_given(manifest.request)))
    yield ReportTable("The plan", _flat(_given(manifest.plan)), closed=True)
    yield ReportTable("The rig", _flat(manifest.drivers), closed=True)
    yield ReportTable("Configuration", _flat(_given(manifest.config)), closed=True)
    yield ReportTable("What the camera's files say", _flat(manifest.exif), closed=True)
    versions = {**manifest.versions, "commit": manifest.git_commit or "unknown"}
    yield ReportTable("Versions", _flat(versions))
    files = [(name, f"{one.size_bytes} bytes", one.sha256) for name, one in manifest.files.items()]
    yield ReportTable("Files", files, ("file", "size", "SHA-256"), closed=True)


def _budget(material: Material) -> ReportTable:
    note = (
        "Mask open, lit and seen, other paths: shares of the exposure, by the realised probing "
        "matrix, means over all cells. Lit and seen is what direct light gets, other paths what "
        "light between any two cells gets."
    )
    if len(material.layers.balance) > 1:
        note += " Electrons are those of green samples."
    if len(material.budget) == MOST_SHOTS < len(material.shots):
        note += f" These are the first {MOST_SHOTS} of {len(material.shots)} shots."
    rows = [[write(one[key]) for _, key, write in _BUDGET] for one in material.budget]
    return ReportTable("Light budget", rows, [head for head, _, _ in _BUDGET], note=note)


def _errors(material: Material) -> ReportTable:
    note = (
        f"What each cause contributes to the error of {material.answer}: standard deviations, over "
        "its RMS and in scene units, on pixels as this page shows them."
    )
    rows = [(row.name, *_share_and_rms(row.share, row.rms), row.source) for row in material.errors]
    return ReportTable("Error budget", rows, ("cause", "share", "RMS", "by"), note=note)


def _share_and_rms(share: float | None, rms: float | None) -> tuple[str, str]:
    if share is None or rms is None:
        return "not known", "not known"
    return to_percent(share), f"{rms:.3g}"


def _realised(manifest: Manifest) -> ReportTable:
    rows = [
        [photo, *(write(told.get(key)) for _, key, write in _REALISED)]
        for photo, told in manifest.realised.items()
    ]
    note = "Realised against wanted probing matrix; 100 % is the weight 1 of the wanted one."
    return ReportTable(
        "Probing matrices", rows, ["photo", *(head for head, _, _ in _REALISED)], note=note
    )


def _given(told: Mapping[str, Any]) -> dict[str, Any]:
    """The values without those that were left open."""
    return {name: value for name, value in told.items() if value not in (None, "", [], {}, ())}


def _flat(told: Mapping[str, Any], prefix: str = "") -> _Rows:
    """Nested tables as rows of dotted names."""
    rows: _Rows = []
    for name, value in told.items():
        if isinstance(value, Mapping):
            rows += _flat(value, f"{prefix}{name}.")
        elif value is not None:
            rows.append((f"{prefix}{name}", _words(value)))
    return rows


def _words(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        more = ", ..." if len(value) > 64 else ""
        return ", ".join(_words(one) for one in value[:64]) + more
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_words(one)}" for name, one in list(value.items())[:64])
    return str(value)[:_MOST_LETTERS]


def _known(value: object, write: Callable[[Any], str]) -> str:
    """A figure in words; "" where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    try:
        return str(write(value))
    except (TypeError, ValueError):
        return str(value)
