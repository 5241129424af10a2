"""The closed sets of names that all parts of the program share; it imports nothing from pdcd, so
that a parser starts quickly."""

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
"""The same as recorded in a run; "given" are codes that came with the request."""
MethodName = Literal["coded", "pairs", "multi-image", "nayar"]
ScheduleName = Literal["none", "both", "lag", "lead", "tail", "full", "wide"]
"""Which black refreshes separate a code from the next (`pdcd.panels.schedule`)."""
GuardsName = Literal["none", "both", "lag", "lead", "tail", "full", "wide", "dark", "auto"]
"""The same as it may be requested; the measured lag of the mask decides what "auto" is."""
WindowName = Literal["auto", "whole", "quarter", "side-5/8", "side-3/4", "side-7/8"]
"""Part of a mask cell that opens (`pdcd.panels.windows`)."""
BlackLevel = Literal["none", "mask", "ambient", "both"]
"""Leaks that black exposures measure, so that they can be subtracted."""
BlackLevelName = Literal["auto", "none", "mask", "ambient", "both"]
"""The same as it may be requested; a dark photo decides what "auto" is (`pdcd.planning.look`)."""
NormaliseName = Literal["auto", "scalar", "row"]
StepName = Literal[
    "sensor", "light", "geometry", "timing", "shutter", "registration", "response",
    "focus", "disparity", "check",
]  # fmt: skip
"""Steps of `pdcd calibrate` (docs/calibration.md)."""
SubjectName = Literal["card", "scene"]
"""What a bench is calibrated on."""
MarksName = Literal["auto", "dots", "phase", "xor"]
"""How the geometry step finds the panels: by dots, or by stripes that are numbered by the maps in
use or by XOR codes."""
JobKind = Literal["capture", "plan", "show", "preview", "live", "stream", "calibrate"]
"""Kinds of jobs, by what they use of the rig: all of it, only the arithmetic, the panels, all for a
quick look, panels and the camera's finder, all for endless pictures, all to measure the bench."""
VerdictName = Literal["good", "doubtful", "bad"]
"""Verdicts on a finished run (docs/quality.md)."""
PatternName = Literal[
    "black", "white", "checker", "grid", "code", "projector", "mask",
    "pixels", "wedge", "star", "dots", "letter",
]  # fmt: skip
"""Still patterns that panels can show (docs/bench-bringup.md)."""
KeepRawName = Literal["all", "last", "none"]
"""Which RAW files a run keeps: all, that of its last shot, or none."""
KeepName = Literal["in", "out"]
"""Paths in the epipolar plane, or out of it."""
ArrangementName = Literal["coaxial", "off-axis"]
"""How projector and camera are placed relative to each other."""
MovingName = Literal["flash", "edge", "bar"]
"""Moving patterns that panels can show over and over."""
JobState = Literal["queued", "running", "done", "failed", "cancelled"]

NAME_WORDS = "1 to 80 letters, digits, spaces and any of _ . , : ; + = ( ) # ' & % @ -"
TAG_WORDS = "1 to 40 letters, digits and any of _ . : + @ -"
NOTE_WORDS = "up to 4096 characters that can be printed, in lines"
"""What a run's name, a tag and the note may contain (`pdcd.protocol.labels`)."""

SIGMA_KINDS = {
    "measured": "measured by the spread of parts",
    "sensor": "noise of the sensor; the error of the codes is not in them",
    "whole": "noise of the sensor; there is no error of codes",
}
"""What sigma includes besides the sensor's noise, in words."""
