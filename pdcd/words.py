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
    "keyed",
    "epipolar",
    "stereo",
    "transport",
]
FamilyName = Literal[
    "bernoulli", "rademacher", "balanced", "hadamard", "singer", "isolation", "confocal"
]
ShownFamilyName = Literal[FamilyName, "given"]
"""The same as a run has it; "given" are codes that came with the request."""
MethodName = Literal["coded", "pairs", "multi-image", "nayar"]
ScheduleName = Literal["none", "both", "lag", "lead", "tail", "full", "wide"]
"""Which black refreshes keep a code apart from the next (`pdcd.panels.schedule`)."""
GuardsName = Literal["none", "both", "lag", "lead", "tail", "full", "wide", "dark", "auto"]
"""The same as it may be asked for; "auto" is settled by the measured lag of the mask."""
WindowName = Literal["auto", "whole", "quarter", "side-5/8", "side-3/4", "side-7/8"]
"""Part of a mask cell that opens (`pdcd.panels.windows`)."""
BlackLevel = Literal["none", "mask", "ambient", "both"]
"""Leaks that black exposures measure and take off."""
BlackLevelName = Literal["auto", "none", "mask", "ambient", "both"]
"""The same as it may be asked for; "auto" is settled by a dark photo (`pdcd.planning.look`)."""
NormaliseName = Literal["auto", "scalar", "row"]
StepName = Literal[
    "sensor", "light", "geometry", "timing", "shutter", "registration", "response",
    "focus", "disparity", "check",
]  # fmt: skip
"""Steps of `pdcd calibrate` (docs/calibration.md)."""
SubjectName = Literal["card", "scene"]
"""What a bench is calibrated on."""
MarksName = Literal["auto", "dots", "phase", "xor"]
"""By what the geometry finds the panels: dots; stripes numbered by maps in use, or by XOR codes."""
JobKind = Literal["capture", "plan", "show", "preview", "live", "stream", "calibrate"]
"""What of the rig a job uses: all of it, the arithmetic alone, the panels, all for a quick look,
panels and the camera's finder, all for pictures without end."""
VerdictName = Literal["good", "doubtful", "bad"]
"""On a finished run (docs/quality.md)."""
PatternName = Literal[
    "black", "white", "checker", "grid", "code", "projector", "mask",
    "pixels", "wedge", "star", "dots", "letter",
]  # fmt: skip
"""What panels can hold to look at (docs/bench-bringup.md)."""
KeepRawName = Literal["all", "last", "none"]
"""Which RAW files a run keeps: all, that of its last shot, or none."""
KeepName = Literal["in", "out"]
"""Paths in the epipolar plane, or out of it."""
ArrangementName = Literal["coaxial", "off-axis"]
"""How projector and camera stand to each other."""
MovingName = Literal["flash", "edge", "bar"]
"""What they can show over and over."""
JobState = Literal["queued", "running", "done", "failed", "cancelled"]

NAME_WORDS = "1 to 80 letters, digits, spaces and any of _ . , : ; + = ( ) # ' & % @ -"
TAG_WORDS = "1 to 40 letters, digits and any of _ . : + @ -"
NOTE_WORDS = "up to 4096 characters that can be printed, in lines"
"""What a run's name, a tag and the note may be (`pdcd.protocol.labels`)."""

SIGMA_KINDS = {
    "measured": "measured by the spread of parts",
    "sensor": "noise of the sensor; the error of the codes is not in them",
    "whole": "noise of the sensor; there is no error of codes",
}
"""What sigma has beside the noise, for people."""
