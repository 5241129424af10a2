"""The closed form beside time steps and dense evaluation: error against time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.bench import plots
from tests.bench.measure import alone
from tests.bench.tables import Section, Table, grid_name, seconds

Setup = tuple[tuple[int, int], int, str]
"""Grid, number of codes K, window."""

SETUPS: tuple[Setup, ...] = (
    ((12, 16), 8, "whole"),
    ((12, 16), 128, "whole"),
    ((24, 32), 32, "whole"),
    ((48, 64), 8, "whole"),
    ((12, 16), 8, "quarter"),
)
WAYS = ("closed form", "dense", "time steps")
LIMIT_S = 0.4
"""Time steps are halved until one run takes this long."""


def run(*, quick: bool, folder: Path) -> Section:
    """Measure each way in a process of its own."""
    setups = (SETUPS[0], SETUPS[-1]) if quick else SETUPS
    found: dict[Setup, dict[str, list[dict[str, Any]]]] = {}
    for setup in setups:
        grid, count, window = setup
        found[setup] = {
            way: alone(
                "rivals:measure_way",
                way=way,
                grid=grid,
                count=count,
                window=window,
                limit_s=LIMIT_S / 2 if quick else LIMIT_S,
            )
            for way in WAYS
        }
    _plot(found, folder / "alternatives.png")
    base_s = {setup: ways["closed form"][0]["time_s"] for setup, ways in found.items()}
    dense = [ways["dense"][0]["time_s"] / base_s[setup] for setup, ways in found.items()]
    finest = {setup: ways["time steps"][-1] for setup, ways in found.items()}
    steps = [values["time_s"] / base_s[setup] for setup, values in finest.items()]
    errors = [values["error"] for values in finest.values()]
    return Section(
        title="Closed form, dense evaluation and time steps",
        text=(
            "The same matrix three ways, for panels with unequal rise and fall, leak, skew and "
            "jitter (without misregistration, which would need finer pixels). The error is the "
            "largest one of all entries between twelve cells, over the largest entry, against "
            "matrix exponentials of the panels' equations. Dense evaluation integrates every pair "
            "of panel pixels exactly from one change to the next; time steps use the midpoint "
            "rule, which is of second order. Both gather their outer products into large matrix "
            "products, and are given the pixels' targets for nothing, while the closed form's time "
            "includes that. The ratio is the time of a way over that of the closed form; time "
            "steps are never more exact than the closed form, so theirs is a lower bound of the "
            f"ratio at equal error. In this run dense evaluation, at equal error, took "
            f"{min(dense):.3g} to {max(dense):.3g} times as long as the closed form; the finest "
            f"time steps still had errors of {min(errors):.1e} to {max(errors):.1e} and took "
            f"{min(steps):.3g} to {max(steps):.3g} times as long."
        ),
        tables=[_table(found)],
        plots=[
            ("alternatives.png", "Error against time; each line halves its steps to the right.")
        ],
    )


def _table(found: dict[Setup, dict[str, list[dict[str, Any]]]]) -> Table:
    table = Table(
        "Error, time and peak memory of three ways to one matrix",
        ("cells, K, window", "way", "error", "time", "time ratio", "peak memory"),
    )
    for setup, ways in found.items():
        base_s = ways["closed form"][0]["time_s"]
        for way, runs in ways.items():
            for values in runs:
                steps = f", {values['steps']} a refresh" if "steps" in values else ""
                table.add(
                    _name(setup),
                    f"{way}{steps}",
                    f"{values['error']:.1e}",
                    seconds(values["time_s"]),
                    f"{values['time_s'] / base_s:.3g}",
                    f"{values['peak_mib']:.0f} MiB",
                )
    return table


def _name(setup: Setup) -> str:
    grid, count, window = setup
    return f"{grid_name(grid)}, {count}, {window}"


def _plot(found: dict[Setup, dict[str, list[dict[str, Any]]]], path: Path) -> None:
    figure, (axes,) = plots.panels(1)
    for index, (setup, ways) in enumerate(found.items()):
        colour = plots.colour(index)
        for way, style in zip(WAYS, ("*", "s", "o-"), strict=True):
            times = [values["time_s"] for values in ways[way]]
            errors = [values["error"] for values in ways[way]]
            label = _name(setup) if way == "time steps" else None
            axes.plot(times, errors, style, color=colour, label=label, markersize=6)
    title = "Star: closed form; square: dense; line: time steps"
    plots.finish(axes, title, "wall time in s", "largest relative error", base=10)
    plots.legend(axes, "cells, K, window")
    plots.save(figure, path)
