"""Dense, sparse, low rank, stencil, Fourier: accuracy and time of every form of an effect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.bench import forms, plots
from tests.bench.measure import alone
from tests.bench.tables import Section, Table, seconds

FLOOR = 1e-17
"""Where forms without any error are drawn."""
SPAN_S = (5e-5, 0.2)
"""Times drawn, alike for all effects."""


def run(*, quick: bool, folder: Path) -> Section:
    """Measure all forms of each effect in a process of its own."""
    subjects = ("corner", "spots") if quick else tuple(forms.SUBJECTS)
    found = {subject: alone("forms:measure_form", subject=subject) for subject in subjects}
    _plot(found, folder / "representations.png")
    gains = {
        subject: runs[0]["time_s"] / min(r["time_s"] for r in runs if r["error"] < 1e-6)
        for subject, runs in found.items()
    }
    best = ", ".join(f"{subject} {gain:.3g}" for subject, gain in gains.items())
    return Section(
        title="What modelling costs and what it buys",
        text=(
            f"The photo of {forms.COUNT} codes by one effect of a scene, kept in different forms: "
            "the whole matrix, its entries above a share of the largest, its singular values above "
            "a share of the largest, a kernel by Fourier transform or as a stencil cut where its "
            "weights fall below that share, and the scene's own form. The path-traced corner "
            "has 32x24 cells, all others 64x48. Errors are those of the photo, against the "
            "dense form. How many times faster than dense the fastest form with an error below "
            f"1e-6 was: {best}."
        ),
        tables=[_table(found)],
        plots=[
            ("representations.png", "Error over time; dense at the far right is the reference.")
        ],
    )


def _table(found: dict[str, list[dict[str, Any]]]) -> Table:
    table = Table(
        "Forms of one effect",
        ("effect", "form", "time", "of dense", "kept", "error"),
        note="`kept` counts the arrays that the form needs.",
    )
    for subject, runs in found.items():
        for one in runs:
            table.add(
                subject,
                one["form"],
                seconds(one["time_s"]),
                f"1/{runs[0]['time_s'] / one['time_s']:.3g}",
                f"{one['kept_mib']:.2g} MiB",
                "reference" if one is runs[0] else f"{one['error']:.1e}",
            )
    return table


def _plot(found: dict[str, list[dict[str, Any]]], path: Path) -> None:
    across = min(len(found), 3)
    figure, axes = plots.panels(across, -(-len(found) // across), scale=0.8, same_y=True)
    kinds = ("dense", "its own", "sparse", "rank", "Fourier", "stencil")
    for (subject, runs), one in zip(found.items(), axes, strict=False):
        for index, kind in enumerate(kinds):
            chosen = [r for r in runs if r["form"].startswith(kind)]
            times = [r["time_s"] for r in chosen]
            errors = [max(r["error"], FLOOR) for r in chosen]
            one.plot(times, errors, "o-", color=plots.colour(index), label=kind, markersize=5)
        plots.finish(one, subject, "time in s", "RMS error of the photo", base=10)
        one.set_xlim(SPAN_S)
    for empty in axes[len(found) :]:
        empty.set_axis_off()
    plots.legend(axes[across - 1])
    plots.save(figure, path)
