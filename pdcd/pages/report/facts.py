"""What a page says in words and tables: verdict, figures, request, plan, rig, versions, files.

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
from pdcd.printable import percent
from pdcd.runs.record import Manifest
from pdcd.words import SIGMA_KINDS

Rows = list[tuple[str, str]]
MOST_ROWS = 400
"""Rows of a table; a page says how many more there are."""
MOST_LETTERS = 4096


@dataclass(frozen=True)
class Table:
    """Rows below a title; `heads` where they have more than a name and a value. `closed` tables are
    opened by a click."""

    title: str
    rows: Sequence[Sequence[str]]
    heads: Sequence[str] = ()
    closed: bool = False
    note: str = ""


def _in(form: str) -> Callable[[Any], str]:
    """A value in a format; "-" for none."""
    return lambda value: "-" if value is None else form.format(value)


Column = tuple[str, str, Callable[[Any], str]]
"""Words, the name of a value, and how it is written."""
SUMMARY: tuple[Column, ...] = (
    ("error of quads against the known truth", "rms_error_quads", percent),
    ("error of means over cells", "rms_error_cells", percent),
    ("error expected (RMS sigma)", "rms_sigma", percent),
    ("error bars", "error_bars", str),
    ("absolute scale", "scale", str),
    ("error of the scale, common to all", "scale_sigma", percent),
    ("error foreseen by the plan", "predicted_error", percent),
    ("cells of which nothing is known", "blind_share", percent),
    ("field in the projector's picture", "field", str),
    ("codes", "codes", str),
    ("exposure", "exposure_s", _in("{:.3f} s")),
    ("refreshes", "refreshes", str),
    ("missed refreshes", "missed_refreshes", str),
    ("shots", "shots", str),
    ("wall time", "wall_s", _in("{:.2f} s")),
)
BUDGET: tuple[Column, ...] = (
    ("shot", "name", str),
    ("exposure", "exposure_s", _in("{:.3f} s")),
    ("ISO", "iso", str),
    ("f/", "f_number", _in("{:g}")),
    ("mask open", "open", percent),
    ("lit and seen", "lit", percent),
    ("other paths", "others", percent),
    ("mean electrons (green)", "electrons", _in("{:.4g}")),
    ("brightest, of full", "full", percent),
    ("saturated", "saturated", percent),
)
REALISED: tuple[Column, ...] = (
    ("divided by", "weight_s", _in("{:.4g} s")),
    ("direct light off, mean", "diagonal_mean", percent),
    ("direct, worst", "diagonal_max", percent),
    ("other paths off, RMS", "off_rms", percent),
    ("worst cell", "off_rms_worst", percent),
    ("worst path", "off_max", percent),
)


def figures(manifest: Manifest, material: Material) -> Rows:
    """The first lines: what the picture is worth, and what it cost; what is not known has none."""
    told = {
        **manifest.summary,
        "error_bars": SIGMA_KINDS.get(material.kind, material.kind),
        "field": _field(manifest.run.projector),
    }
    rows = [(words, _known(told.get(key), write)) for words, key, write in SUMMARY]
    return [(name, value) for name, value in rows if value]


def _field(projector: PanelConfig) -> str:
    """Where the field lies, if that was measured."""
    if projector.field_px is None:
        return ""
    left, top, wide, high = projector.field_px
    return f"{wide} x {high} pixels from ({left}, {top}) on"


def tables(manifest: Manifest, material: Material) -> Iterator[Table]:
    """All tables of a page, in order."""
    yield _budget(material)
    yield _realised(manifest)
    yield Table("What was asked", _flat(_given(manifest.request)))
    yield Table("The plan", _flat(_given(manifest.plan)), closed=True)
    yield Table("The rig", _flat(manifest.drivers), closed=True)
    yield Table("Configuration", _flat(_given(manifest.config)), closed=True)
    yield Table("What the camera's files say", _flat(manifest.exif), closed=True)
    versions = {**manifest.versions, "commit": manifest.git_commit or "unknown"}
    yield Table("Versions", _flat(versions))
    files = [(name, f"{one.size_bytes} bytes", one.sha256) for name, one in manifest.files.items()]
    yield Table("Files", files, ("file", "size", "SHA-256"), closed=True)


def _budget(material: Material) -> Table:
    note = (
        "Mask open, lit and seen, other paths: shares of the exposure, by the realised probing "
        "matrix, means over all cells. Lit and seen is what direct light gets, other paths what "
        "light between any two cells gets."
    )
    if len(material.budget) == MOST_SHOTS < len(material.shots):
        note += f" These are the first {MOST_SHOTS} of {len(material.shots)} shots."
    rows = [[write(one[key]) for _, key, write in BUDGET] for one in material.budget]
    return Table("Light budget", rows, [head for head, _, _ in BUDGET], note=note)


def _realised(manifest: Manifest) -> Table:
    rows = [
        [photo, *(write(told.get(key)) for _, key, write in REALISED)]
        for photo, told in manifest.realised.items()
    ]
    note = "Realised against wanted probing matrix; 100 % is the weight 1 of the wanted one."
    return Table("Probing matrices", rows, ["photo", *(head for head, _, _ in REALISED)], note=note)


def _given(told: Mapping[str, Any]) -> dict[str, Any]:
    """Without what was left open."""
    return {name: value for name, value in told.items() if value not in (None, "", [], {}, ())}


def _flat(told: Mapping[str, Any], prefix: str = "") -> Rows:
    """Nested tables as rows of dotted names."""
    rows: Rows = []
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
    return str(value)[:MOST_LETTERS]


def _known(value: object, write: Callable[[Any], str]) -> str:
    """A figure in words; "" where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    try:
        return str(write(value))
    except (TypeError, ValueError):
        return str(value)
