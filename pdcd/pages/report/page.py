"""The page itself: a template, the texts of the run escaped, its numbers as data.

Clients, operators and devices wrote much of what a run tells: notes, tags, file names, models. None
of it may do anything. So every text is escaped twice over: what cannot be seen is spelled out
(`pdcd.printable`), then comes HTML's own escaping; and the page's policy lets no script run but the
one whose digest it names, and nothing be fetched from anywhere.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import json
import math
import re
from importlib.resources import files
from typing import Any

from pdcd.pages.report.facts import MOST_ROWS, Table, figures, tables
from pdcd.pages.report.material import Material
from pdcd.printable import as_html, one_line
from pdcd.runs.record import Manifest
from pdcd.version import __version__

SCRIPTS = ("unpack.js", "draw.js", "pictures.js", "matrix.js", "timeline.js", "start.js")
"""Parts of the one script, in order."""


def page(manifest: Manifest, material: Material) -> str:
    """The whole page."""
    script, style = _script(), _asset("page.css")
    parts = {
        "policy": (
            f"default-src 'none'; script-src '{_digest(script)}'; style-src '{_digest(style)}'; "
            "img-src data:; base-uri 'none'; form-action 'none'"
        ),
        "title": as_html(f"{manifest.run.goal.name}, {manifest.job}"),
        "style": style,
        "head": _head(manifest, material),
        "pictures_note": _pictures_note(manifest, material),
        "slice": _slice(material.slice_png),
        "tables": "".join(_table(one) for one in tables(manifest, material)),
        "made": as_html(f"made by pdcd {__version__}"),
        "data": _data(_told(manifest, material)),
        "script": script,
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], _asset("page.html"))


def _told(manifest: Manifest, material: Material) -> dict[str, Any]:
    """What the page's script works with."""
    pictures = material.layers
    return {
        "job": one_line(manifest.job),
        "goal": manifest.run.goal.name,
        "size": pictures.size_px,
        "quads": pictures.quads,
        "scale": pictures.scale,
        "balance": pictures.balance,
        "pictures": pictures.data,
        "answer": material.answer,
        "photos": material.matrices,
        "shots": material.shots,
        "grid": manifest.run.grid,
    }


def _head(manifest: Manifest, material: Material) -> str:
    request, scene = manifest.request, manifest.drivers.get("scene")
    where = f"virtual scene {scene}" if manifest.mock else "a real scene"
    lines = [
        f"<h1>{as_html(manifest.run.goal.name)}</h1>",
        f'<p class="quiet">{as_html(manifest.job)}: {as_html(where)}, '
        f"{as_html(_when(manifest.started_utc))}, "
        f"rig {as_html(manifest.drivers.get('name', '?'))}</p>",
    ]
    for name in ("name", "tags", "note"):
        if request.get(name):
            said = "<br>".join(as_html(line) for line in _listed(request[name]).split("\n"))
            lines.append(f'<p class="said">{name}: {said}</p>')
    rows = "".join(
        f"<div><dt>{as_html(name)}</dt><dd>{as_html(value)}</dd></div>"
        for name, value in figures(manifest, material)
    )
    lines += [_verdict(manifest), f'<dl class="figures">{rows}</dl>']
    return "".join(lines)


def _verdict(manifest: Manifest) -> str:
    found = manifest.quality
    sides = [("reason", r) for r in found.reasons]
    told = manifest.summary
    sides += [(name, str(told[name])) for name in ("decided", "taken") if told.get(name)]
    sides += [("remark", r) for r in found.remarks]
    sides += [("warning", w) for w in manifest.warnings[:MOST_ROWS]]
    if manifest.state == "partial":
        sides.insert(0, ("partial", f"missing shots: {', '.join(manifest.missing)}"))
    items = "".join(f'<li class="{kind}"><b>{kind}</b> {as_html(w)}</li>' for kind, w in sides)
    more = len(manifest.warnings) - MOST_ROWS
    tail = f"<p>and {more} more warnings, see capture.json</p>" if more > 0 else ""
    return (
        f'<p id="verdict" class="verdict {found.verdict}">{found.verdict}</p>'
        f'<ul class="reasons">{items}</ul>{tail}'
    )


def _slice(png: bytes) -> str:
    if not png:
        return ""
    data = base64.b64encode(png).decode("ascii")
    title = "Entries of the transport matrix"
    return (
        f"<section><h2>{title}</h2>"
        f'<img class="slice" alt="{title}" src="data:image/png;base64,{data}"></section>'
    )


def _pictures_note(manifest: Manifest, material: Material) -> str:
    pictures = material.layers
    words = ["Scene units: a white, fully lit, facing matte surface is 1."]
    if pictures.quads > 1.0:
        words.append(
            f"A pixel is the mean of {pictures.quads:.3g} Bayer quads; all of them are in linear/."
        )
    else:
        words.append("A pixel is about one Bayer quad.")
    words.append("Colours have the white balance of the previews; values have none.")
    words.append(
        "Sigma: image \u00b1 1.96 sigma is meant to hold the truth for 95 % of all values."
    )
    if material.kind == "sensor":
        words.append("What the codes err is not in it: fewer than four parts were taken.")
    if manifest.mock and not any(one["kind"] == "truth" for one in pictures.data):
        words.append("The truth of the virtual scene was not kept, or is not known.")
    if pictures.left_out:
        words.append(f"Left out for room: {', '.join(pictures.left_out[:64])}.")
    return as_html(" ".join(words))


def _table(one: Table) -> str:
    heads = "".join(f"<th>{as_html(head)}</th>" for head in one.heads)
    rows = "".join(
        "<tr>" + "".join(f"<td>{as_html(cell)}</td>" for cell in row) + "</tr>"
        for row in one.rows[:MOST_ROWS]
    )
    more = len(one.rows) - MOST_ROWS
    tail = f'<p class="quiet">and {more} more, see capture.json</p>' if more > 0 else ""
    note = f'<p class="quiet">{as_html(one.note)}</p>' if one.note else ""
    kind = "wide" if one.heads else "pairs"
    head = f"<thead><tr>{heads}</tr></thead>" if heads else ""
    body = f'<div class="scroll"><table class="{kind}">{head}<tbody>{rows}</tbody></table></div>'
    if not one.rows:
        body = '<p class="quiet">nothing</p>'
    opened = "" if one.closed else " open"
    return (
        f"<details{opened}><summary><h2>{as_html(one.title)}</h2></summary>{note}{body}{tail}"
        "</details>"
    )


def _data(told: dict[str, Any]) -> str:
    """JSON that ends no element and begins none."""
    data = json.dumps(_finite(told), allow_nan=False, separators=(",", ":"))
    return data.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _finite(value: Any) -> Any:
    """The same with null for what is no number."""
    if isinstance(value, dict):
        return {name: _finite(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _when(utc: str) -> str:
    """2026-01-01T12:03:01.2Z -> 2026-01-01 12:03:01 UTC."""
    found = re.match(r"(\d{4}-\d\d-\d\d)T(\d\d:\d\d:\d\d)", utc)
    return f"{found[1]} {found[2]} UTC" if found else utc


def _listed(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


@functools.cache
def _asset(name: str) -> str:
    return (files("pdcd.pages.report") / "assets" / name).read_text(encoding="utf-8")


@functools.cache
def _script() -> str:
    inner = "\n".join(_asset(name) for name in SCRIPTS)
    return f'(() => {{\n"use strict";\n{inner}\n}})();\n'


def _digest(words: str) -> str:
    """As the page's policy names a script or a style."""
    return "sha256-" + base64.b64encode(hashlib.sha256(words.encode("utf-8")).digest()).decode()
