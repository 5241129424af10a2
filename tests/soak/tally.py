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
            ("growth of a daemon and of what lived as long, over 1000 captures", self._growth()),
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
        found = sorted(self.answers_s)
        if not found:
            return "not asked"
        shares = (found[min(len(found) - 1, math.ceil(q * len(found)) - 1)] for q in (0.5, 0.99, 1))
        return " / ".join(f"{1e3 * s:.0f} ms" for s in shares) + f", {len(found)} answers"

    def _kinds(self) -> str:
        return ", ".join(f"{kind} {count}" for kind, count in self.answers.most_common()) or "none"

    def _growth(self) -> str:
        taken = sum(count for count, _ in self.growth)
        if not taken:
            return "not measured"
        return f"{1000.0 * sum(mib for _, mib in self.growth) / taken:.1f} MiB ({taken} captures)"
