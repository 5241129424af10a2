"""The table of the verdict: the figures from which a photo is doubtful or bad, and what is said.

`judge` compares one figure with its row. The room's other modules compute the figures.
docs/quality.md has the same table for users.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, IntEnum

from pdcd.bench.exposure_time import OFF_S, OFF_SHARE
from pdcd.printable import to_percent
from pdcd.protocol.result import Quality

NEVER = math.nan
"""A limit that no figure reaches."""
YES = 1.0
"""The limit of figures that are counts, or true and false."""


class Grade(IntEnum):
    """How heavily a figure weighs; remarks leave a photo good."""

    SOUND = 0
    REMARK = 1
    DOUBTFUL = 2
    BAD = 3


@dataclass(frozen=True)
class VerdictRow:
    """One cause: the figures from which a photo is doubtful and bad, and what is said.

    says : one sentence with what to do. ``{figure}`` and ``{limit}``, as all shares, are written as
    percentages unless a format follows the name; other names are details of the figure.
    remark : the figure from which it is worth a remark. falls : small figures are the bad ones.
    """

    doubtful: float
    bad: float
    says: str
    remark: float = NEVER
    falls: bool = False

    def grade(self, figure: float) -> Grade:
        """The grade of the heaviest limit that the figure reaches."""
        for limit, grade in (
            (self.bad, Grade.BAD),
            (self.doubtful, Grade.DOUBTFUL),
            (self.remark, Grade.REMARK),
        ):
            if figure < limit if self.falls else figure >= limit:
                return grade
        return Grade.SOUND


class Cause(Enum):
    """All causes for which a photo may be doubtful or bad; shares are of 1."""

    # fmt: off
    # Single shots.
    SATURATED = VerdictRow(0.002, 0.05,  # a few glints are left alone by metering
        "shot {shot}: {figure} of the field is saturated (limit {limit}); close the aperture, or "
        "take fewer passes")
    FIELD_UNSEEN = VerdictRow(NEVER, YES,
        "shot {shot}: no pixel of the camera sees the field")
    NO_LIGHT = VerdictRow(NEVER, 5.0,
        "shot {shot}: no light, its mean is {figure:.2g} times its error (limit {limit:g}); check "
        "lens cap, shutter, projector and mask", falls=True)
    UNDER_EXPOSED = VerdictRow(0.3, 1.0,
        "shot {shot} is under-exposed: its noise is {figure} of its light (limit {limit}); open "
        "the aperture, or expose longer")
    # Panels are black outside the field.
    LIGHT_OUTSIDE = VerdictRow(0.25, NEVER,
        "ambient or stray light: shot {shot} has {figure} of the field's light outside it (limit "
        "{limit}); darken the room, or check that [camera.place] says where the field lies")
    # A white card gets 5 % in a lit room; bright places of scenes reflect half as much and more.
    ROOM = VerdictRow(0.1, 1.0,
        "ambient or stray light: in shot {shot} the room's light is {figure} of white (limit "
        "{limit}); it is subtracted, but its changes from photo to photo are not: darken the room")
    # Without a white photo: a shot of codes may be dark as its scene has little of what is wanted.
    STRAY = VerdictRow(0.25, 1.0,
        "ambient or stray light: beyond what the panels let through, shot {shot} has {figure} of "
        "the light of the lit shot (limit {limit}); it is subtracted, but its changes from photo "
        "to photo are not: darken the room, or block the path of that light")
    # Black ink has more light than panels' black lets through.
    DARK_CELLS = VerdictRow(NEVER, NEVER,
        "{dark} have no light in the white photo ({figure}): black things, or pixels that a panel "
        "does not show", remark=0.01)
    DARK_LINES = VerdictRow(0.01, NEVER,
        "{dark} have no light in the white photo ({figure}, limit {limit}), among them {lines} "
        "between lit ones, as if a panel did not show part of its picture; look at a white "
        "picture on [mask] and on [projector]")
    MISSED = VerdictRow(YES, NEVER,
        "{missed} refreshes were missed in {shots}, so that codes got unequal light; let nothing "
        "else run on the display, or set rig.on_miss to balance")
    CLOSED_EARLY = VerdictRow(NEVER, YES,
        "the shutter closed {early_s:.3g} s before the panels went black in {shots}; give the "
        "shutter more time (trigger lag)")
    UNVERIFIED = VerdictRow(YES, NEVER,
        "presentation times are not verified in {shots} (time source {source}), so refreshes may "
        "have been lost; use a display with a verified time source")
    EXPOSURE_TIMES = VerdictRow(YES, NEVER,
        f"{{shots}}: {{conflict}} (limit the larger of {OFF_S:g} s and {to_percent(OFF_SHARE)}); "
        "make sure that nothing suspends this program and that the camera is set to bulb, and "
        "check the shutter's cable")
    # Cameras stop a fifth below their highest number at most; one bit is a factor of 2. Either the
    # profile or the file may be right.
    LEVELS = VerdictRow(1.5, NEVER,
        "photos span {reach:g} DN from black to white, {times:.3g} times as many as in sensor "
        "profile {profile} (limit {limit:g} times either way), from which electrons and noise were "
        "computed; name this camera's own in camera.profile, or run pdcd calibrate sensor")

    # Places of panels and camera, by light that follows codes, and by photos of blocks.
    # Misplaced panels have 0.5 to 1 of the light follow their codes, others up to 0.2.
    WRONG_WAY = VerdictRow(NEVER, 0.3,
        "a panel is {how}: {figure} of the light follows codes placed that way (limit {limit}); "
        "check [projector.place], [mask.place] and [camera.place]")
    LESS_THAN_NO_DIRECT = VerdictRow(NEVER, -0.2,
        "the coded photo has more light than there can be (direct light {figure}, limit {limit}): "
        "a panel is inverted, or shows its codes whole refreshes late, or there is much ambient "
        "light; check the polarisers of the mask, run pdcd calibrate timing, or measure with "
        "black_level ambient", falls=True)
    # A tenth of all cells must have so much: of misplaced panels 0.05, of the virtual scenes 0.9.
    NO_DIRECT = VerdictRow(0.15, NEVER,
        "no direct light in the scene (at most {figure} in nine of ten places, limit {limit}): "
        "mask and projector do not show the same place, or one is far out of focus; check "
        "[projector.place], [mask.place] and [camera.place]", falls=True)
    # Less than 3 % of the direct light is the error of telling, whatever it is of the answer.
    CODES_APART = VerdictRow(0.06, 0.3,
        "codes of the panels do not meet: {lost} of the direct light passes under codes that are "
        "not its own, {figure} of the answer (limit {limit}); the mask probably shows its codes "
        "later, earlier or more slowly than configured{elsewhere}: run pdcd calibrate timing, or "
        "set skew_s, scan_s, rise_s and fall_s in [mask]")
    TIMES_UNSURE = VerdictRow(0.06, NEVER,
        "nobody measured when mask and projector switch: if they are so far apart that {lost} of "
        "the direct light does not meet its own codes, nothing in this photo shows it, and "
        "{figure} of the answer is wrong (limit {limit}); run pdcd calibrate timing, or take a "
        "plain capture of indirect first, whose parts show it")
    NOBODY_LOOKED = VerdictRow(YES, NEVER,
        "the places of panels and camera were not checked: {why}; run pdcd calibrate geometry")
    PROJECTOR_UNSEEN = VerdictRow(YES, NEVER,
        "it is not known whether both panels show the same place: the camera does not see blocks "
        "on the projector; the scene has hardly any direct light, or the projector is out of focus "
        "or misplaced; try a plain card, or run pdcd calibrate geometry")
    MASK_UNSEEN = VerdictRow(YES, NEVER,
        "it is not known where the mask lies: the camera does not see blocks on it; check its "
        "picture, its polarisers and the camera's focus, and run pdcd calibrate geometry")
    MASK_PLACE = VerdictRow(0.06, 0.4,
        "the mask's picture {lies} [mask.place] says: {lost} of the direct light goes through "
        "wrong cells, {figure} of the answer (limit {limit}), and a quarter of a cell is "
        "{quarter_px:.3g} px; {mend}")
    MASK_BLUR = VerdictRow(0.06, 0.4,
        "light is blurred by {blur_px:.2g} px on its way to the mask (projector pixels; a mask "
        "that is displaced by as much looks the same), not by the {known_px:.2g} px of [mask] "
        "blur_px: {lost} of the direct light goes through wrong cells, {figure} of the answer "
        "(limit {limit}); run pdcd calibrate registration, or take quarter windows; or focus the "
        "projector, and the scene on the mask")
    MASK_UNSURE = VerdictRow(0.06, NEVER,
        "if the mask is {shift_px:.2g} px away, or light on its way to it blurred by {blur_px:.2g} "
        "px (projector pixels), nothing in this photo shows it, and {figure} of the answer goes "
        "through wrong cells (limit {limit}); run pdcd calibrate registration, or take quarter "
        "windows or larger cells")
    CAMERA_PLACE = VerdictRow(0.5, NEVER,
        "the camera's view {lies} [camera.place] says, and half a cell is {half_px:.3g} px: "
        "pixels are assigned to wrong cells; {mend}")
    BESIDE_MASK = VerdictRow(0.06, NEVER,
        "{part} of the field lies outside the mask's picture, and nothing is known there: if it is "
        "as bright as the field next to it, {figure} of the answer is missing (limit {limit}); run "
        "pdcd calibrate geometry, or move the mask", remark=0.0)

    # Probing matrices, as the panels realised them.
    TORN = VerdictRow(0.1, 0.5,
        "{figure} of the cells share windows with others that are matched with another place "
        "(limit {limit}), and see that place, too; take whole windows")
    DIRECT_WEIGHT = VerdictRow(0.1, 0.5,
        "photo {photo}: direct light has a weight that is {figure} off (limit {limit}); check "
        "contrast, guards and offset of the panels, or take more codes")
    # A single path may be wrong by 1 where codes are few: sums over many paths are not.
    PATH_WEIGHTS = VerdictRow(1.0, 3.0,
        "photo {photo}: paths have weights that are {figure} off (limit {limit}); take more codes")
    # Quarter windows have up to 0.19 of goals with edges in the wanted matrix.
    COMMON_WEIGHTS = VerdictRow(0.3, 0.6,
        "photo {photo}: paths have weights that are {figure} off in all parts alike (limit "
        "{limit}), which error bars do not include; check the codes (codes_from): averaged over "
        "all pairs they do not keep the light that the goal wants")
    GREY_LIGHT = VerdictRow(YES, NEVER,
        "the {panels} showed grey levels, and it is not known what light they give: with a gamma, "
        "paths have other weights than the goal wants; run pdcd calibrate response, or set gamma")
    # Parts miss alike what no code of any of them ever shows, so that error bars are without it.
    NEVER_LIT = VerdictRow(0.01, 0.1,
        "photo {photo}: the projector never lights {cells}, which have {figure} of the wanted "
        "weights (limit {limit}), and error bars do not include that; check the codes "
        "(codes_from), or [projector]")
    NEVER_OPEN = VerdictRow(0.01, NEVER,
        "photo {photo}: the mask never opens {cells}, {figure} of the field (limit {limit}), and "
        "nothing is known there; check the codes (codes_from), or [mask]")
    DIRECT_BY_CELL = VerdictRow(0.3, 1.0,
        "photo {photo}: direct light has weights that are {figure} off from cell to cell (RMS, "
        "limit {limit}); check guards, lag and offset of the panels, or take more codes")
    DIRECT_LEFT = VerdictRow(0.15, 0.5,
        "{figure} of the picture is direct light (limit {limit}), as it has a weight of {weight}; "
        "take quarter windows, and check contrast, guards and places of the panels")
    # A third of it may be wrong: what leaks goes by the exponential of times known to ten percent.
    DIRECT_TAKEN_OUT = VerdictRow(0.45, 1.5,
        "direct light as strong as {figure} of the picture was subtracted from it, as computed for "
        "these panels (limit {limit}); take quarter windows, and check contrast, guards and "
        "places of the panels")
    BLOCKED_LEFT = VerdictRow(0.15, 0.5,
        "{figure} of the picture is light that should be blocked (limit {limit}), as it has a "
        "weight of {weight}; check contrast, guards and places of the panels")
    # Direct light is taken for ten times the rest of the scene.
    DIRECT_UNSEEN = VerdictRow(0.015, 0.05,
        "direct light that should be blocked has a weight of {figure} (limit {limit}), and no "
        "photo shows how much there is; check contrast and places of the panels, take schedule "
        "auto or tail for a slow mask, or take indirect, which shows it")

    # The answer.
    ANSWER_MISSING = VerdictRow(NEVER, YES,
        "the picture {asked} that was asked for is missing, as photos for it are, and {stands} "
        "stands in its place; capture again")
    ANSWER_UNKNOWN = VerdictRow(NEVER, YES,
        "nothing is known of the answer: the whole field is saturated or unseen; close the "
        "aperture and check what the camera sees")
    NOISE = VerdictRow(0.3, 1.0,
        "the sensor's noise is {figure} of the answer (limit {limit}); open the aperture, or "
        "expose longer")
    UNSURE = VerdictRow(0.5, 0.9,
        "in {figure} of the field sigma is larger than the answer (limit {limit}); take more "
        "codes, or parts to measure it")
    # Over the light that is left without the error: at 1, half of the picture's power is error.
    ERROR_BARS = VerdictRow(0.3, 1.0,
        "by its error bars the answer may be off by {figure} (RMS, limit {limit}): {why}")
    # Light below zero shows as little as half of the error.
    BELOW_ZERO = VerdictRow(0.15, 1.0,
        "the answer has light below zero, which is an error: it is off by {figure} or more (RMS, "
        "limit {limit}); it comes from other light, which is much stronger than the wanted "
        "light; take more codes")
    # 16 codes have 0.25, 100 of them 0.1; codes that leave no error less than 0.003.
    CODES_UNMEASURED = VerdictRow(0.1, NEVER,
        "error bars do not include the error of the codes: with sharp light, such as that of "
        "mirrors, the answer may be off by {figure} (RMS, limit {limit}); take {advice}",
        remark=0.003)
    LEAKS_LEFT = VerdictRow(0.05, 0.3,
        "ambient light and leaks are {figure} of the answer and were not subtracted (limit "
        "{limit}); darken the room, or take black exposures")
    LEAKS_UNSEEN = VerdictRow(YES, NEVER,
        "no dark photo was taken that would show {light}, and any of it is in the picture; capture "
        "with black level auto or both")
    # Nobody knows which photos saw the change, so that the answer may be right.
    ROOM_CHANGED = VerdictRow(0.05, NEVER,
        "the room's light changed between the dark photos before and after: the difference makes "
        "up to {figure} of the answer (limit {limit}); make sure that no light is switched, and "
        "capture again")
    COMMON_LIGHT = VerdictRow(0.25, NEVER,
        "{share} of the light does not depend on what is shown (limit {limit} of the rest): the "
        "entries of T do not contain it, but the picture does; darken the room")
    PAIR_SUM = VerdictRow(0.02, 0.1,
        "the pair of exposures does not add up to the white photo: it is {figure} off (limit "
        "{limit}); check ambient light and leaks (black_level), a drifting lamp, an aperture that "
        "does not return to its stop, and missed refreshes")
    # fmt: on


@dataclass(frozen=True)
class VerdictFinding:
    """One plain sentence with its figure, its limit and what to do, and the row it comes from."""

    grade: Grade
    text: str
    cause: Cause | None = None


class _Share(float):
    """A share of 1, written as a percentage in sentences."""

    def __format__(self, spec: str) -> str:
        if spec:
            return super().__format__(spec)
        return to_percent(self) if math.isfinite(self) else "as much as all that it shows"


def judge(
    cause: Cause, figure: float = YES, grade: Grade | None = None, **words: float | str
) -> list[VerdictFinding]:
    """The finding that this figure leads to, or none.

    grade : where it does not depend on the figure alone. words : further names in the sentence.
    """
    row = cause.value
    grade = row.grade(figure) if grade is None else grade
    if not grade:
        return []
    limit = row.bad if math.isnan(row.doubtful) else row.doubtful
    shares = {"figure": figure, "limit": limit, **words}
    told = {n: _Share(w) if isinstance(w, float) else w for n, w in shares.items()}
    return [VerdictFinding(grade, row.says.format(**told), cause)]


def combine_findings(findings: Iterable[VerdictFinding]) -> Quality:
    """The worst finding decides; reasons come worst first, remarks apart."""
    listed = sorted(findings, key=lambda f: -f.grade)
    worst = max((f.grade for f in listed), default=Grade.SOUND)
    return Quality(
        verdict="bad" if worst == Grade.BAD else "doubtful" if worst == Grade.DOUBTFUL else "good",
        reasons=tuple(f.text for f in listed if f.grade > Grade.REMARK),
        remarks=tuple(f.text for f in listed if f.grade == Grade.REMARK),
    )
