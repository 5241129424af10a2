"""What a page says in words and tables: verdict, figures, request, plan, rig, versions, files.

Everything here is plain text; `pdcd.pages.report.page` escapes it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pdcd.bench.tables import PanelConfig
from pdcd.pages.report.material import Material
from pdcd.pages.report.timeline import MOST_SHOTS
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


def percent(share: object) -> str:
    """A share as a percentage of three digits or more; "-" for none."""
    if not isinstance(share, float | int):
        return "-"
    return f"{100.0 * share:.0f} %" if abs(share) >= 10.0 else f"{100.0 * share:.3g} %"


def figures(manifest: Manifest, material: Material) -> Rows:
    """The first lines: what the picture is worth, and what it cost."""
    summary = manifest.summary
    rows = [
        ("error of quads against the known truth", _known(summary.get("rms_error_quads"), percent)),
        ("error of means over cells", _known(summary.get("rms_error_cells"), percent)),
        ("error expected (RMS sigma)", _known(summary.get("rms_sigma"), percent)),
        ("error bars", SIGMA_KINDS.get(material.kind, material.kind)),
        ("absolute scale", _known(summary.get("scale"))),
        ("error of the scale, common to all", _known(summary.get("scale_sigma"), percent)),
        ("error foreseen by the plan", _known(summary.get("predicted_error"), percent)),
        ("cells of which nothing is known", _known(summary.get("blind_share"), percent)),
        ("field in the projector's picture", _field(manifest.run.projector)),
        ("codes", _known(summary.get("codes"))),
        ("exposure", _known(summary.get("exposure_s"), lambda s: f"{s:.3f} s")),
        ("refreshes", _known(summary.get("refreshes"))),
        ("missed refreshes", _known(summary.get("missed_refreshes"))),
        ("shots", _known(summary.get("shots"))),
        ("wall time", _known(summary.get("wall_s"), lambda s: f"{s:.2f} s")),
    ]
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
    heads = (
        "shot", "exposure", "ISO", "f/", "mask open", "lit and seen", "other paths",
        "mean electrons (green)", "brightest, of full", "saturated",
    )  # fmt: skip
    rows = [
        (
            one["name"],
            f"{one['exposure_s']:.3f} s",
            str(one["iso"]),
            f"{one['f_number']:g}",
            percent(one["open"]),
            percent(one["lit"]),
            percent(one["others"]),
            f"{one['electrons']:.4g}",
            percent(one["full"]),
            percent(one["saturated"]),
        )
        for one in material.budget
    ]
    note = (
        "Mask open, lit and seen, other paths: shares of the exposure, by the realised probing "
        "matrix, means over all cells. Lit and seen is what direct light gets, other paths what "
        "light between any two cells gets."
    )
    if len(rows) == MOST_SHOTS < len(material.shots):
        note += f" These are the first {MOST_SHOTS} of {len(material.shots)} shots."
    return Table("Light budget", rows, heads, note=note)


def _realised(manifest: Manifest) -> Table:
    names = ("weight_s", "diagonal_mean", "diagonal_max", "off_rms", "off_rms_worst", "off_max")
    heads = (
        "photo", "divided by", "direct light off, mean", "direct, worst", "other paths off, RMS",
        "worst cell", "worst path",
    )  # fmt: skip
    rows = [
        (photo, *(_deviation(name, told.get(name)) for name in names))
        for photo, told in manifest.realised.items()
    ]
    note = "Realised against wanted probing matrix; 100 % is the weight 1 of the wanted one."
    return Table("Probing matrices", rows, heads, note=note)


def _deviation(name: str, value: float | None) -> str:
    if name == "weight_s" and value is not None:
        return f"{value:.4g} s"
    return percent(value)


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


def _known(value: object, write: Any = str) -> str:
    """A figure in words; "" where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    try:
        return str(write(value))
    except (TypeError, ValueError):
        return str(value)
