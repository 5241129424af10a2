"""The page of figures: one HTML file beside its pictures, which opens from the disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from pdcd.figures.figure import PRINTED, Mode
from pdcd.figures.store import Captured, Made, Shown, Stated
from pdcd.version import __version__

STYLE = """
:root { color-scheme: light dark; --ink: #1d2430; --paper: #fbfbf9; --faint: #68707d;
  --line: #d9dce1; --card: #fff; --good: #1f7a37; --bad: #b3261e; --link: #1b6ca8; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e6ea; --paper: #15181d; --faint: #98a1ae;
  --line: #343a44; --card: #1c2027; --good: #6fcf87; --bad: #ff8a80; --link: #7cb8ec; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.2rem 1.4rem 4rem; max-width: 82rem; color: var(--ink);
  background: var(--paper); font: 16px/1.5 system-ui, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; margin: 0.4rem 0; } h2 { font-size: 1.3rem; margin: 0 0 0.3rem; }
h3 { font-size: 0.95rem; margin: 1rem 0 0.3rem; font-weight: 600; }
a { color: var(--link); } .faint { color: var(--faint); } .held { color: var(--good); }
.not { color: var(--bad); font-weight: 700; }
nav { display: flex; flex-wrap: wrap; gap: 0.3rem 1rem; margin: 0.8rem 0 1.6rem; }
section { background: var(--card); border: 1px solid var(--line); border-radius: 10px;
  padding: 1.1rem 1.3rem 1.3rem; margin: 0 0 1.6rem; }
.see { font-size: 1.05rem; margin: 0.2rem 0 0.4rem; }
.row { display: grid; gap: 0.7rem; grid-template-columns: repeat(auto-fit, minmax(15rem, 1fr)); }
.row + .row { margin-top: 0.7rem; }
.row.few { grid-template-columns: repeat(auto-fit, minmax(20rem, 28rem)); }
.row.small { grid-template-columns: repeat(3, minmax(0, 17rem)); }
.row.many { grid-template-columns: repeat(auto-fit, minmax(10.5rem, 1fr)); }
figure { margin: 0; } figure img { width: 100%; display: block; border-radius: 4px; }
figcaption { font-size: 0.82rem; color: var(--faint); padding-top: 0.2rem; }
.plots { display: flex; flex-wrap: wrap; gap: 1rem; margin-top: 0.8rem; }
.plots figure { flex: 1 1 26rem; max-width: 44rem; } .plots figure.wide { max-width: none; }
.plots img { background: #fff; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.86rem; margin-top: 0.5rem; }
th, td { text-align: left; padding: 0.22rem 0.9rem 0.22rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; } td.n, th.n { text-align: right; white-space: nowrap;
  font-variant-numeric: tabular-nums; }
.banner { border: 2px solid var(--bad); border-radius: 8px; padding: 0.6rem 1rem; }
"""
FEW, MANY = 2, 5
"""Pictures of a row up to which, and from which, they are shown larger and smaller."""


def page(
    made: Sequence[Made], mode: Mode, failed: Mapping[str, str], waiting: Sequence[str]
) -> str:
    """The whole page. waiting : figures that are still being made; the page says so itself."""
    title = "The paper's figures, taken again"
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{title}</title><style>{STYLE}</style></head><body>",
        f"<h1>{title}</h1>",
        f"<p>{_introduction(mode)}</p>",
        *_banner(made, failed, waiting),
        _contents(made, failed),
        *(_section(one) for one in made),
        *(_lost(number, why) for number, why in failed.items()),
        f'<p class="faint">pdcd {escape(__version__)}, mode {escape(mode.name)}.</p>',
        "</body></html>",
    ]
    return "\n".join(parts) + "\n"


def _introduction(mode: Mode) -> str:
    rows, cols = mode.grid
    width, height = mode.quads
    less = ""
    if mode.thrift > 1:
        less = (
            f" This is the quick page: captures have up to {mode.thrift} times fewer codes than "
            "the paper's, and a coarser camera."
        )
    return (
        "O'Toole, Raskar, Kutulakos, <i>Primal-Dual Coding to Probe Light Transport</i> (2012), "
        f"on a virtual bench: codes of {cols} x {rows} cells, a camera of {2 * width} x "
        f"{2 * height} pixels that stands a little askew, panels that answer late and leak, full "
        "sensor noise, "
        "and a truth that differs from what the bench is believed to be. Each picture is one of a "
        "capture, from RAW files; errors are RMS errors against the scene's known light transport, "
        "over the RMS of the true picture." + less
    )


def _banner(made: Sequence[Made], failed: Mapping[str, str], waiting: Sequence[str]) -> list[str]:
    if waiting:
        names = ", ".join(_name(number) for number in waiting)
        return [f'<p class="banner not">Not finished: still to be made: {escape(names)}.</p>']
    numbers = sum(len(one.numbers) + sum(c.bound is not None for c in one.captures) for one in made)
    lost = sum(
        sum(not n.held for n in one.numbers) + sum(not c.held for c in one.captures) for one in made
    )
    told = []
    if failed:
        told.append(f'<p class="banner not">{len(failed)} figures could not be made.</p>')
    if lost:
        told.append(
            f'<p class="banner not">{lost} of {numbers} numbers are not within their bounds.</p>'
        )
    elif numbers:
        told.append(f'<p class="held">All {numbers} numbers are within their stated bounds.</p>')
    return told


def _contents(made: Sequence[Made], failed: Mapping[str, str]) -> str:
    links = [
        f'<a href="#fig-{escape(one.number)}">{_name(one.number)}</a>'
        + ("" if one.held else ' <span class="not">!</span>')
        for one in made
    ]
    links += [f'<span class="not">{_name(number)}</span>' for number in failed]
    return "<nav>" + "\n".join(f"<span>{link}</span>" for link in links) + "</nav>"


def _name(number: str) -> str:
    if number.startswith("table-"):
        return f"Table {number[6:]}"
    return f"Figure {number}" if number.isdigit() else number.capitalize()


def _section(one: Made) -> str:
    parts = [
        f'<section id="fig-{escape(one.number)}">',
        f"<h2>{_name(one.number)}: {escape(one.title)}</h2>",
        f'<p class="see">{escape(one.see)}</p>',
        f'<p class="faint">The paper: {escape(one.paper)}'
        + (f" Still unlike it: {escape(one.unlike)}" if one.unlike else "")
        + "</p>",
    ]
    for row in one.rows:
        parts += [f"<h3>{escape(row.title)}</h3>"] if row.title else []
        count = len(row.pictures)
        size = " few" if count <= FEW else " many" if count >= MANY else ""
        size = " small" if row.small else size
        parts += [
            f'<div class="row{size}">',
            *(_picture(p, caption=False) for p in row.pictures),
            "</div>",
        ]
    if one.plots:
        parts += ['<div class="plots">', *(_picture(p, caption=True) for p in one.plots), "</div>"]
    parts += [_numbers(one.numbers), _captures(one.captures), "</section>"]
    return "\n".join(part for part in parts if part)


def _picture(shown: Shown, *, caption: bool) -> str:
    kind = ' class="wide"' if shown.wide else ""
    file, words = escape(shown.file, quote=True), escape(shown.caption, quote=True)
    below = f"<figcaption>{words}</figcaption>" if caption else ""
    return (
        f'<figure{kind}><a href="{file}"><img src="{file}" alt="{words}" loading="lazy"></a>'
        f"{below}</figure>"
    )


def _numbers(numbers: Sequence[Stated]) -> str:
    if not numbers:
        return ""
    paper = any(number.paper for number in numbers)
    heads = ["number", "measured", "stated", *(["in the paper"] if paper else []), ""]
    rows = []
    for number in numbers:
        cells = [
            (number.what, ""),
            (_value(number.value, number.percent), "n"),
            (_bounds(number), "n"),
            *([(number.paper, "n")] if paper else []),
        ]
        rows.append((cells, number.held if _bounds(number) else None))
    return _table(heads, rows)


def _captures(captures: Sequence[Captured]) -> str:
    if not captures:
        return ""
    heads = ["capture", "", "goal", "codes", "as printed", "exposures", "time", "RMS error"]
    heads += ["stated", ""]
    rows = []
    for one in captures:
        codes = "" if one.codes is None else f"{one.codes} {one.family or ''}"
        printed = "" if one.codes is None else str(PRINTED * one.codes)
        time = "" if one.exposure_s is None else f"{one.exposure_s:.1f} s"
        cells = [
            (one.name, ""),
            (one.said, ""),
            (one.goal, ""),
            (codes, "n"),
            (printed, "n"),
            ("" if one.exposures is None else str(one.exposures), "n"),
            (time, "n"),
            (_value(one.error, True), "n"),
            ("" if one.bound is None else f"at most {_value(one.bound, True)}", "n"),
        ]
        rows.append((cells, None if one.bound is None else one.held))
    return _table(heads, rows)


def _table(
    heads: Sequence[str], rows: Sequence[tuple[Sequence[tuple[str, str]], bool | None]]
) -> str:
    lines = ['<div class="scroll"><table><tr>']
    lines += [f"<th>{escape(head)}</th>" for head in heads]
    lines.append("</tr>")
    for cells, held in rows:
        lines.append("<tr>")
        lines += [
            f'<td class="n">{escape(text)}</td>' if kind else f"<td>{escape(text)}</td>"
            for text, kind in cells
        ]
        word = "" if held is None else "held" if held else "NOT HELD"
        lines.append(f'<td class="{"held" if held else "not"}">{word}</td></tr>')
    lines.append("</table></div>")
    return "".join(lines)


def _value(value: float | None, percent: bool) -> str:
    if value is None:
        return "not known"
    return f"{100.0 * value:.3g} %" if percent else f"{value:.4g}"


def _bounds(number: Stated) -> str:
    least, most = (
        None if bound is None else _value(bound, number.percent)
        for bound in (number.least, number.most)
    )
    if least is not None and most is not None:
        return f"{least} to {most}"
    if least is not None:
        return f"at least {least}"
    return f"at most {most}" if most is not None else ""


def _lost(number: str, why: str) -> str:
    return (
        f'<section id="fig-{escape(number)}"><h2>{_name(number)}</h2>'
        f'<p class="not">Could not be made: {escape(why)}</p></section>'
    )
