"""What was done, what came of it, and which promises broke: counted, and told as a table."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

from tests.soak.lapse import Lapse


@dataclass
class Row:
    """One kind of attack: how often, how the captures it met ended, and the slowest making safe."""

    times: int = 0
    ends: Counter[str] = field(default_factory=Counter)
    dark_s: float = 0.0
    closed_s: float = 0.0


@dataclass
class Tally:
    """All counts of a soak. `say` is told of broken promises as they are found."""

    rows: dict[str, Row] = field(default_factory=dict)
    broken: list[str] = field(default_factory=list)
    captures: int = 0
    kills: int = 0
    folders: int = 0
    answers_s: list[float] = field(default_factory=list)
    """How long `rig.status` took an honest client beside everything else."""
    answers: Counter[str] = field(default_factory=Counter)
    """To hostile requests, by kind."""
    beat_gap_s: float = 0.0
    rss_mib: float = 0.0
    growth: list[tuple[int, float]] = field(default_factory=list)
    """Captures of a daemon's life, and by how many MiB it grew over them."""
    live_pictures: int = 0
    """Pictures that the page saw of its streams."""
    spoilt: int = 0
    """Photos of these that were spoilt."""
    stops_s: list[float] = field(default_factory=list)
    """How long the rig was held after the page had closed its live picture."""
    page_mib: list[tuple[float, float]] = field(default_factory=list)
    """Resident memory of each server of a page, after its first live picture and in the end."""
    lapse: Lapse = field(default_factory=Lapse)

    def row(self, name: str) -> Row:
        """The row of an attack."""
        return self.rows.setdefault(name, Row())

    def promise(self, kept: bool, what: str) -> None:
        """Count a promise; one that broke is named in the table."""
        if not kept:
            self.broken.append(what)

    def table(self) -> str:
        """All of it as Markdown."""
        whole_s, own_s = self.lapse.whole_s, self.lapse.own_s
        head = [
            ("time", f"{whole_s / 60.0:.0f} min"),
            ("of it withheld from the machine by its host", f"{abs(1.0 - own_s / whole_s):.0%}"),
            ("captures", str(self.captures)),
            ("kills", str(self.kills)),
            ("finished folders, each verified", str(self.folders)),
            ("`rig.status` of an honest client, p50 / p99 / max", self._answers()),
            (
                "longest silence of the heart beat, without such time",
                f"{self.beat_gap_s:.2f} s",
            ),
            ("largest resident memory, all processes of a daemon", f"{self.rss_mib:.0f} MiB"),
            ("growth of a daemon and of what lived as long, after 100 captures", self._growth()),
            ("live pictures on a page that was open throughout", self._pictures()),
            ("the rig was free after the page closed them, p50 / p99 / max", self._stops()),
            ("growth of the page's server", self._page()),
            ("hostile requests, by what they were answered", self._kinds()),
            ("broken promises", str(len(self.broken))),
        ]
        lines = ["| soak | |", "|---|---|", *(f"| {name} | {value} |" for name, value in head), ""]
        lines += [
            "| attack | times | captures met: done / failed / cancelled | panels black within | "
            "shutter closed within |",
            "|---|---|---|---|---|",
        ]
        for name, row in sorted(self.rows.items()):
            ends = " / ".join(str(row.ends[end]) for end in ("done", "failed", "cancelled"))
            slowest = (f"{s:.2f} s" if s else "" for s in (row.dark_s, row.closed_s))
            lines.append(f"| {name} | {row.times} | {ends} | {' | '.join(slowest)} |")
        return "\n".join(lines + [f"- BROKEN: {what}" for what in self.broken]) + "\n"

    def _answers(self) -> str:
        return _tell_shares(self.answers_s, "not asked", "answers")

    def _pictures(self) -> str:
        return f"{self.live_pictures}, and {self.spoilt} photos that were spoilt"

    def _stops(self) -> str:
        return _tell_shares(self.stops_s, "none was closed", "stops")

    def _page(self) -> str:
        grown = ", ".join(f"{last - first:.1f}" for first, last in self.page_mib if first)
        return f"{grown} MiB" if grown else "not measured"

    def _kinds(self) -> str:
        return ", ".join(f"{kind} {count}" for kind, count in self.answers.most_common()) or "none"

    def _growth(self) -> str:
        grown = (f"{mib:.1f} MiB in {count} more" for count, mib in self.growth)
        return ", ".join(grown) or "not measured"


def _tell_shares(seconds: list[float], none: str, what: str) -> str:
    """Quantiles of times, and how many there are."""
    found = sorted(seconds)
    if not found:
        return none
    shares = (found[min(len(found) - 1, math.ceil(q * len(found)) - 1)] for q in (0.5, 0.99, 1))
    return " / ".join(f"{1e3 * s:.0f} ms" for s in shares) + f", {len(found)} {what}"
