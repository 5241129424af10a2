"""A plan and a run in words, for the terminal and the page: rows of a label and a text."""

from __future__ import annotations

from collections.abc import Callable

from pdcd.printable import to_percent
from pdcd.protocol.entry import RunEntry
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.words import SIGMA_KINDS

_Value = float | int | str
"""Values in the summary of a run, apart from the verdict."""
_PAPER_SHARE = 1.0 / 48.0
"""Share of the light that the paper's codes keep: half of all cells are lit, half of the others are
open, through quarter windows, in one of three refreshes."""

_GUARDS = {
    "none": "without guards",
    "both": "both panels black between codes",
    "lag": "mask black after each code",
    "lead": "mask black before each code",
    "tail": "mask black after each code, then both",
    "full": "with guards",
    "wide": "with longer guards",
}
"""Schedules of a code, in words."""


_SUMMARY: tuple[tuple[str, str, Callable[[_Value], str]], ...] = (
    ("taken", "taken", str),
    ("decided", "decided", str),
    ("codes", "codes", str),
    ("refreshes", "refreshes", str),
    ("exposure_s", "exposure", lambda s: f"{float(s):.3f} s"),
    ("missed_refreshes", "missed refreshes", str),
    ("rms_sigma", "RMS sigma", lambda e: f"{to_percent(e)} of the picture"),
    ("sigma_kind", "error bars", lambda kind: SIGMA_KINDS.get(str(kind), str(kind))),
    ("scale", "scale", str),
    ("scale_sigma", "scale, sigma", to_percent),
    (
        "rms_error_quads",
        "RMS error",
        lambda e: f"{to_percent(e)} of quads, against the known truth",
    ),
    ("rms_error_cells", "", lambda e: f"{to_percent(e)} of means over cells"),
    ("transport_sigma", "sigma of T", lambda e: f"{to_percent(e)} of its entries' RMS"),
    (
        "transport_error",
        "error of T",
        lambda e: f"{to_percent(e)} against the scene's known truth",
    ),
    ("predicted_error", "predicted", to_percent),
    ("wall_s", "wall time", lambda s: f"{float(s):.2f} s"),
)
"""Lines of the table after a capture: key of the summary, label, how to write the value."""


def _describe_guards(summary: PlanSummary) -> str:
    if summary.dark_s > 0.0:
        return f"both panels black for {1e6 * summary.dark_s:.3g} us after each code"
    return _GUARDS.get(summary.schedule, summary.schedule)


def plan_rows(summary: PlanSummary) -> list[list[str]]:
    """What a capture would do."""
    rows = [
        ["goal", summary.goal],
        ["codes", f"{summary.codes} {summary.family}, p = {summary.p:g}"],
        ["cells", f"{summary.grid[0]} x {summary.grid[1]}, window {summary.window}"],
        ["passes", f"{summary.passes}, {_describe_guards(summary)}"],
        [
            "light",
            f"{100.0 * summary.light_share:.3g} % of a floodlit exposure, "
            f"{summary.light_share / _PAPER_SHARE:.3g} times the paper's 1/48",
        ],
        ["total", f"{summary.refreshes} refreshes, {summary.seconds:.3f} s"],
        ["parts", str(summary.parts)],
        ["RAW files", f"{summary.raw_files}, and test exposures where the aperture is metered"],
    ]
    cost = summary.pilot_cost
    if cost is not None:
        rows += [
            ["pilot", f"{cost.raw_files} of the codes one by one, {cost.seconds:.3f} s, at most"],
            [
                "or",
                f"ends after {cost.scouts} without sharp paths: {cost.stopped_raw_files} RAW "
                f"files, {cost.stopped_seconds:.3f} s, {cost.stopped_codes} codes"
                + " at once"
                * (summary.parts == 1),
            ],
        ]
    if summary.prior is not None:
        rows.append(["codes by", summary.prior])
    rows += [["why" if not number else "", text] for number, text in enumerate(summary.reasons)]
    rows += [["split" if not number else "", text] for number, text in enumerate(summary.split)]
    foreseen = summary.prediction
    if foreseen is not None:
        rows += [
            ["RMS error", f"{to_percent(foreseen.error)} of the picture's RMS"],
            ["by codes", to_percent(foreseen.code)],
            ["by sensor", f"{to_percent(foreseen.sensor)} at ISO {foreseen.iso}"],
            ["at most", f"{to_percent(foreseen.bound)} with {100.0 * foreseen.confidence:g} %"],
            ["prior", foreseen.prior],
        ]
    return rows + [
        [
            f"shot {s.name}",
            f"{s.exposures} of " * (s.exposures > 1)
            + f"{s.codes} codes, {s.refreshes} refreshes, {s.exposure_s:.3f} s",
        ]
        for s in summary.shots
    ]


def summary_rows(figure: Callable[[str], _Value | None]) -> list[list[str]]:
    """Rows of the table of a run: the known figures; `figure` returns a figure by its name."""
    found = ((label, write, figure(key)) for key, label, write in _SUMMARY)
    return [[label, write(value)] for label, write, value in found if value is not None]


def describe_error(run: RunEntry) -> str:
    """The error against the truth where that is known, else the error that the run expects."""
    if run.rms_error_quads is not None:
        return to_percent(run.rms_error_quads)
    return "" if run.rms_sigma is None else f"+-{to_percent(run.rms_sigma)}"
