"""What a user asks for: the single list of the fields of a request.

They are plain values, so that the socket, the command line, the run folder and Python callers share
one definition and one JSON Schema. The results are in `pdcd.protocol.plan_summary` and
`pdcd.protocol.result`.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from pdcd.protocol.about import describe_array, describe_field
from pdcd.protocol.labels import MOST_TAGS, Label, NoteText, Tag
from pdcd.words import (
    BlackLevelName,
    FamilyName,
    GoalName,
    GuardsName,
    KeepName,
    KeepRawName,
    MarksName,
    MethodName,
    NormaliseName,
    StepName,
    SubjectName,
    WindowName,
)

_Name = Annotated[str, Meta(max_length=4096)]


class SentArray(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """An array that comes as the content of a file: by descriptor, or within the line.

    A client gives `fd` or `npy`, and may give `file`. In the manifest, `file` and `sha256` say what
    was given.
    """

    fd: Annotated[int, Meta(ge=0, le=63)] | None = None
    """Index, from 0, among the descriptors that came with the line."""
    npy: str | None = None
    """Base64 of a .npy, .npz or PNG file."""
    file: Annotated[str, Meta(max_length=255)] | None = None
    """The client's name for the file, for people: no file is opened by it."""
    sha256: str | None = None
    """Digest of the content; written by the program that read it."""


NumberRows = tuple[tuple[float, ...], ...]
_Table = _Name | SentArray | NumberRows
"""Rows of numbers; the content of a file; or a name below the daemon's folder of arrays."""


_MOST_CELLS = 65536
"""No panel has more pixels along a side; the rig's own grid allows less (`pdcd.recipes.bounds`)."""
_Step = Annotated[int, Meta(ge=-_MOST_CELLS, le=_MOST_CELLS)]
_Share = Annotated[float, Meta(gt=0.0, lt=1.0)]
_Weight = Annotated[float, Meta(ge=-1e6, le=1e6)]
_Unit = Annotated[float, Meta(ge=0.0, le=1.0)]
_Entry = Annotated[float, Meta(ge=-1e6, le=1e6)]
Plane = tuple[_Entry, _Entry, _Entry, _Entry, _Entry, _Entry, _Entry, _Entry, _Entry]
FieldPlace = tuple[_Unit, _Unit]
"""(x, y) on the field, from its upper left corner (`pdcd.panels.map`)."""

_MATCHED: tuple[GoalName, ...] = ("indirect", "direct", "fraction", "split")
"""Goals in which the matched cell may be another than the cell itself."""
_RANGES_OF_DEPTH: tuple[GoalName, ...] = ("keyed", "stereo")


class CaptureRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One wanted photo, as `capture.start` and `pdcd capture` take it.

    This is the one list of what can be asked for: name, type, bounds and default of each field,
    what it is, and which goals take it (`describe_field`). Fields that are None take the value of
    the rig's configuration, or what `pdcd.planning.defaults` finds best.
    """

    goal: Annotated[GoalName, describe_field("which light to keep", "goal")]
    codes: Annotated[
        Annotated[int, Meta(ge=1, le=65536)] | None,
        describe_field("independent pairs of codes, one for each panel", "codes", "K", common=True),
    ] = None
    family: Annotated[FamilyName | None, describe_field("how the codes are made", "codes")] = None
    codes_from: Annotated[
        _Name | SentArray | None,
        describe_field(
            "codes of your own: arrays primal and dual, codes x rows x columns each, 0 to 1",
            "codes",
            "FILE",
            takes="a file (.npz)",
        ),
    ] = None
    p: Annotated[
        _Share | None,
        describe_field(
            "share of all other light to keep",
            "goal",
            "P",
            needed_by=["fraction"],
            taken_by=["off-diagonal"],
        ),
    ] = None
    shift: Annotated[
        tuple[_Step, _Step] | None,
        describe_field(
            "cells down and right from each camera cell to the projector cell it is matched with",
            "goal",
            ("DOWN", "RIGHT"),
            needed_by=["off-diagonal", "descattered"],
            taken_by=_MATCHED,
        ),
    ] = None
    equal_brightness: Annotated[
        bool,
        describe_field(
            "take 1 / (2 p) times as many codes, so that light of the matched cell is equally "
            "bright for every p",
            "codes",
        ),
    ] = False
    radius: Annotated[
        Annotated[int, Meta(ge=0, le=_MOST_CELLS)] | None,
        describe_field(
            "largest distance that counts as near, in cells",
            "goal",
            "CELLS",
            needed_by=["long-range", "short-range"],
        ),
    ] = None
    mix: Annotated[
        tuple[_Weight, _Weight] | None,
        describe_field("weights of the two warps", "goal", ("A", "B"), needed_by=["two-samples"]),
    ] = None
    period: Annotated[
        Annotated[int, Meta(ge=4, le=_MOST_CELLS, multiple_of=4)] | None,
        describe_field("cells from one stripe to the next", "goal", "CELLS", needed_by=["split"]),
    ] = None
    disparity: Annotated[
        tuple[_Step, _Step] | None,
        describe_field(
            "lowest and highest disparity: cells to the right from where the camera sees a point "
            "to the projector cell that lights it; default: 0",
            "goal",
            ("LOW", "HIGH"),
            taken_by=_RANGES_OF_DEPTH,
            one_is_both=True,
        ),
    ] = None
    plane: Annotated[
        Plane | None,
        describe_field(
            "homography from the camera's field to the projector's, row by row, of the plane that "
            "disparities count from; default: the rig's",
            "goal",
            "H",
            taken_by=_RANGES_OF_DEPTH,
        ),
    ] = None
    keep: Annotated[
        KeepName | None,
        describe_field(
            "paths in the epipolar plane, which are those within rows of cells (default: in), or "
            "all others",
            "goal",
            taken_by=["epipolar"],
        ),
    ] = None
    rows: Annotated[
        tuple[_Step, _Step] | None,
        describe_field(
            "row of projector cells and row of camera cells; default: all of T",
            "goal",
            ("R", "R2"),
            taken_by=["transport"],
            one_is_both=True,
        ),
    ] = None
    masked: Annotated[
        bool | None,
        describe_field(
            "open the mask at the row of camera cells only", "goal", taken_by=["transport"]
        ),
    ] = None
    illumination: Annotated[
        _Table | None,
        describe_array(
            "light of the projector, 0 to 1",
            needed_by=["illuminated"],
            taken_by=[g for g in get_args(GoalName) if g not in ("illuminated", "transport")],
        ),
    ] = None
    disparities: Annotated[
        _Table | None,
        describe_array(
            "cells to the right from each camera cell to the projector cell that disparities count "
            "from",
            taken_by=_RANGES_OF_DEPTH,
        ),
    ] = None
    warp: Annotated[
        _Table | None,
        describe_array(
            "projector cell of each camera cell, as row * columns + column, or -1",
            needed_by=["warped", "two-samples"],
            taken_by=(*_MATCHED, *_RANGES_OF_DEPTH),
        ),
    ] = None
    warp_b: Annotated[_Table | None, describe_array("a second warp", needed_by=["two-samples"])] = (
        None
    )
    region_a: Annotated[
        _Table | None, describe_array("camera cells of a region, 0 or 1", needed_by=["blocked"])
    ] = None
    region_b: Annotated[
        _Table | None, describe_array("projector cells of a region, 0 or 1", needed_by=["blocked"])
    ] = None
    kernel: Annotated[
        _Table | None,
        describe_array(
            "weights of shifts, an array with odd sides whose centre is the shift (0, 0)",
            needed_by=["filtered"],
        ),
    ] = None
    matrix: Annotated[
        _Table | None, describe_array("weight of every pair of cells, N x N", needed_by=["relit"])
    ] = None
    method: Annotated[
        MethodName,
        describe_field(
            "one coded photo; a pair of them, with the mask's codes and with their complement; "
            "many photos through an open mask; or shifted checkers (nayar). The last two are there "
            "to compare with",
            "codes",
        ),
    ] = "coded"
    pilot: Annotated[
        Annotated[int, Meta(ge=0, le=4096)] | Literal["auto"] | None,
        describe_field(
            "how many of the codes to photograph one by one first, to learn which far cells are "
            "linked: 8, 12 or 16 in front of mirrors (all codes, if you like), or a power of two "
            "from 32, if codes are left; 0: none; auto: a few, if the first photos show that they "
            "are worth their files; default: auto, for goals that gain by it",
            "codes",
            "K0",
        ),
    ] = None
    parts: Annotated[
        Annotated[int, Meta(ge=1, le=64)] | Literal["auto"] | None,
        describe_field(
            "exposures to split the codes over; the spread of 4 or more measures the error of the "
            "codes, which otherwise is not in sigma; auto: as many of 16 codes or more as are "
            "worth their files; default: auto, for goals that allow it",
            "codes",
            "B",
        ),
    ] = None
    until_error: Annotated[
        _Share | None,
        describe_field(
            "take parts until RMS sigma is at most this share of the picture's RMS",
            "codes",
            "E",
        ),
    ] = None
    repeat: Annotated[
        int,
        Meta(ge=1, le=1024),
        describe_field(
            "equal exposures to add up: less sensor noise, the same error of the codes",
            "codes",
            "B",
        ),
    ] = 1
    error: Annotated[
        _Share | None,
        describe_field(
            "wanted RMS error as a share of the picture's RMS; it decides codes and exposures",
            "planning",
            "E",
            common=True,
        ),
    ] = None
    confidence: Annotated[
        Annotated[float, Meta(ge=0.5, lt=1.0)] | None,
        describe_field("probability of an error within that; default: 0.95", "planning", "C"),
    ] = None
    seconds: Annotated[
        Annotated[float, Meta(gt=0.0, le=86400.0)] | None,
        describe_field(
            "time of all exposures; codes and exposures are chosen for the smallest error in it",
            "planning",
            "S",
            common=True,
        ),
    ] = None
    prior: Annotated[
        _Name | SentArray | None,
        describe_field(
            "what is known of the scene, to choose codes and predict errors: scene:NAME of a "
            "preset, decay:CELLS, or a transport matrix",
            "planning",
            "PRIOR",
            takes="scene:NAME, decay:CELLS, or a file (.npz)",
            worded=("scene:", "decay:"),
        ),
    ] = None
    smooth: Annotated[
        bool | None,
        describe_field(
            "correct indirect and far light for the codes' error on smooth light, by a model "
            "from the photo itself; default: with the family hadamard",
            "codes",
        ),
    ] = None
    grey_masks: Annotated[
        bool | None,
        describe_field(
            "let masks of long- and short-range light have grey levels, which count it more "
            "evenly, for less light; default: if the mask can show them and their light was "
            "measured",
            "codes",
        ),
    ] = None
    seed: Annotated[
        int,
        Meta(ge=0, lt=2**53),
        describe_field("the same seed gives the same codes", "codes", "N"),
    ] = 0
    exposure_s: Annotated[
        Annotated[float, Meta(gt=0.0, le=3600.0)] | None,
        describe_field(
            "coded time in seconds: as many whole passes of the codes as fit",
            "photo",
            "S",
            option="exposure",
        ),
    ] = None
    window: Annotated[
        WindowName | None, describe_field("part of a mask cell that opens", "photo")
    ] = None
    guards: Annotated[
        bool | GuardsName | None,
        describe_field(
            "refreshes that keep a code apart from the next: 1 (none), 2 (both panels black; the "
            "mask black, before or after its code), 3 (tail, for slow masks; full) or 4 (wide, for "
            "panels set from opposite ends); dark: a dark time between rows, for DMDs; auto: by "
            "the measured lag of the mask",
            "photo",
            option="schedule",
            switched=(
                "a black mask between codes, whatever a wanted error would choose",
                "no black mask between codes: more light, more error",
            ),
        ),
    ] = None
    black_level: Annotated[
        BlackLevelName | None,
        describe_field(
            "black exposures to take and subtract; auto: those that a dark photo calls for", "photo"
        ),
    ] = None
    normalise: Annotated[
        NormaliseName | None,
        describe_field(
            "divide a photo by one number, each cell by its own weight, or (auto) as it needs",
            "photo",
        ),
    ] = None
    white: Annotated[
        bool,
        describe_field(
            "take a white photo beside an indirect one, so that the run shows white, direct and "
            "indirect light",
            "photo",
        ),
    ] = True
    white_patch: Annotated[
        FieldPlace | None,
        describe_field(
            "where on the field something white lies, to balance the previews by, from 0 0 at its "
            "upper left corner to 1 1; default: what is bright and nearly neutral",
            "photo",
            ("X", "Y"),
        ),
    ] = None
    keep_raw: Annotated[
        KeepRawName | None, describe_field("which RAW files to keep; default: the rig's", "run")
    ] = None
    out: Annotated[
        str | None,
        describe_field(
            "make the run folder in DIR; over the socket, below the daemon's state folder",
            "run",
            "DIR",
        ),
    ] = None
    name: Annotated[
        Label | None,
        describe_field("name of the run; it need not be unique", "run", "TEXT", common=True),
    ] = None
    tags: Annotated[
        tuple[Tag, ...],
        Meta(max_length=MOST_TAGS),
        describe_field("words to find the run by", "run", "WORD", option="tag", common=True),
    ] = ()
    note: Annotated[
        NoteText, describe_field("anything worth remembering", "run", "TEXT", common=True)
    ] = ""


class CalibrateRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a bench is to measure of itself, as `calibrate.start` and `pdcd calibrate` take it."""

    # Every client is told the steps for as long as the job is known, so their count is limited.
    steps: Annotated[
        tuple[StepName, ...],
        Meta(max_length=len(get_args(StepName))),
        describe_field("what to measure; none: all that a bench needs", "calibration", "STEP"),
    ] = ()
    attended: Annotated[
        bool,
        describe_field(
            "whether somebody is there to put a card in front of the camera and confirm it; else "
            "it begins at once",
            "calibration",
        ),
    ] = False
    subject: Annotated[
        SubjectName, describe_field("what is in front of the camera", "calibration")
    ] = "card"
    marks: Annotated[
        MarksName,
        describe_field(
            "marks for the geometry: dots, or stripes; auto: dots on a card, stripes on a scene",
            "calibration",
        ),
    ] = "auto"
    anew: Annotated[
        bool,
        describe_field(
            "measure all steps, also those of a calibration that stopped not long ago",
            "calibration",
        ),
    ] = False
