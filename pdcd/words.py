"""The closed sets of names that every floor shares; no imports of pdcd, so that a parser is
quick."""

from __future__ import annotations

from typing import Literal

GoalName = Literal[
    "white",
    "indirect",
    "direct",
    "fraction",
    "illuminated",
    "diagonal",
    "off-diagonal",
    "warped",
    "two-samples",
    "relit",
    "long-range",
    "short-range",
    "blocked",
    "descattered",
    "filtered",
    "split",
    "transport",
]
FamilyName = Literal[
    "bernoulli", "rademacher", "balanced", "hadamard", "singer", "isolation", "confocal"
]
MethodName = Literal["coded", "multi-image", "nayar"]
ScheduleName = Literal["none", "both", "lag", "lead", "full"]
"""Which black refreshes keep a code apart from the next (`pdcd.frames.schedule`)."""
GuardsName = Literal["none", "both", "lag", "lead", "full", "auto"]
"""The same as it may be asked for; "auto" is settled by the measured lag of the mask."""
WindowName = Literal["auto", "whole", "quarter"]
BlackLevel = Literal["none", "mask", "ambient", "both"]
NormaliseName = Literal["auto", "scalar", "row"]
StepName = Literal[
    "sensor", "light", "geometry", "timing", "shutter", "registration", "response",
    "coaxial", "focus", "check",
]  # fmt: skip
"""Steps of `pdcd calibrate` (docs/calibration.md)."""
JobKind = Literal["capture", "plan", "show", "preview", "calibrate"]
"""What of the rig a job uses: all of it, the arithmetic alone, the panels, all for a quick look."""
VerdictName = Literal["good", "doubtful", "bad"]
"""On a finished run (docs/quality.md)."""
PatternName = Literal[
    "black", "white", "checker", "grid", "code", "projector", "mask",
    "pixels", "wedge", "star", "dots", "letter",
]  # fmt: skip
"""What panels can hold to look at (docs/bench-bringup.md)."""
MovingName = Literal["flash", "edge", "bar"]
"""What they can show over and over."""
JobState = Literal["queued", "running", "done", "failed", "cancelled"]
