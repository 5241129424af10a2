"""What the verdict is made of: limits, grades and findings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

from pdcd.protocol.result import Quality


@dataclass(frozen=True)
class VerdictLimits:
    """From which figure on a photo is doubtful, or bad. Shares are of 1."""

    saturated: tuple[float, float] = (0.002, 0.05)
    """Share of the field. A few glints are left alone by metering; a twentieth is a hole."""
    noise: tuple[float, float] = (0.3, 1.0)
    """RMS of the sensor's noise over the RMS of the answer: at 1 the picture is noise."""
    noisy_shot: tuple[float, float] = (0.3, 1.0)
    """The same of the shots that the answer is made of: an answer may be small because the scene
    has little of it, but then its shots are not dark."""
    dark: float = 5.0
    """Mean light of a shot over its standard error: below, no light can be shown to be there."""
    error: tuple[float, float] = (0.3, 1.0)
    """RMS error of the answer, by its sigma, over the RMS of the light that is left when the error
    is taken off. At 1 half of the picture's power is error."""
    unmeasured: float = 0.1
    """RMS error by codes over the answer's RMS that nothing has measured, if each point gets its
    light by one path: from here, doubtful. 16 codes have 0.25, 100 of them 0.1."""
    exact: float = 0.003
    """The same below which it is not told: codes that leave no error have none."""
    below: tuple[float, float] = (0.15, 1.0)
    """The same by light below zero alone, which shows as little as half of the error."""
    unsure: tuple[float, float] = (0.5, 0.9)
    """Share of the field where sigma is larger than the RMS of the answer."""
    stray: tuple[float, float] = (0.25, 1.0)
    """Light of a black shot beyond what the panels let through, over the light of the shot that it
    belongs to, where no photo of all light stands beside it. It is subtracted; its noise and what
    it drifts stay."""
    room: tuple[float, float] = (0.1, 1.0)
    """The same within a second, over what bright places of the white photo get of the projector:
    of a white card some 5 %, as bright places of scenes reflect half as much and more."""
    changed: float = 0.05
    """RMS error of the answer by what the light of the room changed while it was taken, over its
    RMS. Nobody knows which photos saw the change, so that the answer may be right."""
    beyond: float = 0.06
    """RMS over the answer's of the light that it lacks where the field lies beside the mask, were
    it as much there as next to it."""
    left: tuple[float, float] = (0.05, 0.3)
    """RMS error by ambient light and leaks that are known and were not taken off, over the RMS of
    the answer."""
    misplaced: tuple[float, float] = (0.06, 0.4)
    """RMS of the direct light that goes through wrong cells because the mask lies elsewhere, over
    the RMS of the answer: as predicted from where blocks were seen."""
    outside: float = 0.25
    """Median light outside the field over that inside: panels are black there."""
    torn: tuple[float, float] = (0.1, 0.5)
    """Share of cells that parted windows join with others that are matched elsewhere."""
    direct: float = 0.15
    """Share of direct light that a tenth of all cells must have. Of misplaced panels they have
    0.05 at most, of the virtual scenes 0.9 and more."""
    inverted: float = -0.2
    """Median share of direct light below which it is less than none."""
    fingerprint: tuple[float, float] = (0.3, 6.0)
    """Share of the light that follows the codes of a panel in another place, and that over chance.
    Misplaced panels have 0.5 to 1, and 14 to 54; others up to 0.2, and 3."""
    followed: float = 1.5
    """The same share that is too much: no more light can follow codes than there is. It is found
    where such codes hardly differ from cell to cell, as at the borders of matched ones."""
    diagonal: tuple[float, float] = (0.1, 0.5)
    """Mean error of the weight of direct light, where a wanted weight of 1 is 1."""
    direct_left: tuple[float, float] = (0.15, 0.5)
    """Direct light that is left in an answer without any, over the RMS of the answer: its weight by
    the realised matrix, times the direct light of the scene."""
    pair_sum: tuple[float, float] = (0.02, 0.1)
    """RMS difference of what a complement pair adds up to and of the floodlit photo, over the RMS
    of that, beyond the sensor's noise."""
    off_rms: tuple[float, float] = (1.0, 3.0)
    """RMS error of the weights of other paths. A single path may be wrong by 1 where codes are few:
    sums over many paths are not."""


LIMITS = VerdictLimits()


class Grade(IntEnum):
    """How heavily a finding weighs; remarks leave a photo good."""

    REMARK = 0
    DOUBTFUL = 1
    BAD = 2


@dataclass(frozen=True)
class VerdictFinding:
    """One plain sentence with its figure, its limit and what to do."""

    grade: Grade
    text: str


def combine_findings(findings: Iterable[VerdictFinding]) -> Quality:
    """The worst finding decides; reasons come worst first, remarks apart."""
    listed = sorted(findings, key=lambda f: -f.grade)
    worst = max((f.grade for f in listed), default=Grade.REMARK)
    return Quality(
        verdict="bad" if worst == Grade.BAD else "doubtful" if worst else "good",
        reasons=tuple(f.text for f in listed if f.grade),
        remarks=tuple(f.text for f in listed if not f.grade),
    )


def choose_grade(value: float, limits: tuple[float, float]) -> Grade:
    """REMARK below the first limit, DOUBTFUL from it on, BAD from the second on."""
    return Grade(int(value >= limits[0]) + int(value >= limits[1]))
