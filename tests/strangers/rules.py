"""What must hold on every bench of a stranger, and a table that shows where it does not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

Entry = dict[str, Any]

GOALS = ("indirect", "direct")
OVER_TRUTH = 1.3
"""An error may be so many times that with the truth typed in,"""
SMALL = 0.003
"""or this share of the picture."""
ONE_SCALE = 0.005
"""By how much the factors of a run's pictures may differ, or by `OVER_TRUTH` times as much as with
the truth typed in: what windows lose of indirect light, and add to direct, is no scale, but it is
part of these factors."""
NEVER_GOOD, NEVER_BAD = 0.10, 0.03
"""Error, one common factor apart, above which no photo is good, and below which none is bad."""
COVERAGE = 0.95
MOST_SIGMAS = 5.0
"""By how much the figures of two calibrations may differ; some fifty of them are compared."""

HEAD = (
    "seed scene   room  calibrate        goal      verdict   error  scaled   scale"
    "   truth  near   sigma  covered unknown\n"
)


def broken(entry: Entry) -> list[str]:
    """The rules that a bench broke, a sentence each."""
    return list(_broken(entry))


def _broken(entry: Entry) -> Iterator[str]:
    calibrated = entry["calibrate"]
    if not calibrated.get("passed"):
        yield f"calibrate: {calibrated['state']}: {calibrated['cause'][:110]}"
    again = entry.get("again")
    if again is not None:
        far = {k: v for k, v in again.get("off_sigmas", {}).items() if v > MOST_SIGMAS}
        for key, sigmas in far.items():
            yield f"calibrate again: {key} differs by {sigmas:.1f} sigma"
    for name in GOALS:
        taken, true = entry[name], entry[f"true {name}"]
        if taken["state"] != "done":
            yield f"{name}: {taken['cause'][:110]}"
            continue
        if true["state"] != "done":
            yield f"{name} with the truth: {true['cause'][:110]}"
        elif not taken["error"] <= max(OVER_TRUTH * true["error"], SMALL):
            yield f"{name}: error {taken['error']:.2%}, with the truth typed in {true['error']:.2%}"
        spread, known = _spread(taken["scales"]), _spread(true.get("scales", {}))
        if not spread <= max(ONE_SCALE, OVER_TRUTH * known if math.isfinite(known) else 0.0):
            yield f"{name}: scales of the run's pictures differ by {spread:.2%}"
    for name, taken in _photos(entry):
        if taken["state"] == "done":
            yield from (f"{name}: {text}" for text in _misjudged(taken))


def _misjudged(taken: Entry) -> Iterator[str]:
    error, verdict = taken["error_scaled"], taken["verdict"]
    if verdict == "good" and not error <= NEVER_GOOD:
        yield f"good, and off by {error:.1%} (sigma {taken['sigma']:.1%})"
    if verdict == "bad" and error < NEVER_BAD:
        yield f"bad, and off by {error:.1%} only: {'; '.join(taken['reasons'])[:90]}"
    if verdict == "good" and not taken["covered"] >= COVERAGE - 0.005:
        yield f"good, and {taken['covered']:.1%} are covered by 1.96 sigma"


def _photos(entry: Entry) -> Iterator[tuple[str, Entry]]:
    for name in GOALS:
        yield name, entry[name]
    for key, taken in entry.items():
        if key.startswith("spoilt "):
            yield f"{taken['how']} {taken['goal']}", taken


def _spread(scales: dict[str, float]) -> float:
    values = [value for value in scales.values() if math.isfinite(value)]
    return max(values) / min(values) - 1.0 if values and min(values) > 0.0 else math.inf


def line(entry: Entry) -> str:
    """The lines of a bench in the table."""
    calibrated = entry["calibrate"]
    word = calibrated.get("verdict") or calibrated["state"]
    begin = f"{entry['seed']:4} {entry['scene']:7} {entry['room']:5.1%} {word:9}"
    begin += f"{calibrated.get('cpu_s', 0):4.0f} s "
    rows = []
    for name, taken in _photos(entry):
        cells = f"{name:19} "
        if taken["state"] != "done":
            cells += f"{taken['state']}: {taken['cause'][:100]}"
        else:
            true = entry.get(f"true {name}", {}).get("error")
            cells += (
                f"{taken['verdict']:9}{taken['error']:7.2%} {taken['error_scaled']:7.2%} "
                f"{taken['scale']:7.4f} {'' if true is None else format(true, '.2%'):>7} "
                f"{taken['near']:6.1%} {taken['sigma']:6.2%} {taken['covered']:7.1%} "
                f"{taken['unknown']:7.1%}"
            )
        rows.append(f"{begin}{cells}\n")
        begin = " " * len(begin)
    rows += [f"{begin}! {text}\n" for text in broken(entry)]
    rows.append(f"{begin}({entry['wall_s']:.0f} s)\n")
    return "".join(rows)


def summary(entries: list[Entry]) -> str:
    """How many benches broke which rule."""
    counts: dict[str, int] = {}
    for entry in entries:
        for text in broken(entry):
            kind = text.split(":")[0]
            counts[kind] = counts.get(kind, 0) + 1
    whole = sum(not broken(entry) for entry in entries)
    rows = [f"\n{whole} of {len(entries)} benches broke no rule\n"]
    rows += [f"  {count:3} times {kind}\n" for kind, count in sorted(counts.items())]
    return "".join(rows)
