"""What the verdict says of panels and a camera that lie elsewhere, as blocks showed them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.bench.tables import PanelConfig
from pdcd.panels.blocks import TOO_FEW
from pdcd.panels.placing import Placing
from pdcd.pictures.misplaced import (
    LostDirectLight,
    Misplacement,
    estimate_lost_direct,
    known_shift_px,
    mean_cell_px,
    measure_misplacement,
)
from pdcd.printable import to_percent
from pdcd.runs.record import PanelLook, RunRecord
from pdcd.verdict.limits import LIMITS, Grade, VerdictFinding, VerdictLimits, choose_grade

_CALIBRATE = "run pdcd calibrate geometry"
_FLIPS = {
    "horizontal": "mirrored left to right",
    "vertical": "mirrored top to bottom",
    "both": "turned by 180 degrees",
}
_LEAST_DEG, _LEAST_SCALE = 0.05, 0.002
"""Turn and change of size from which they are told."""
HOPELESS = 0.5
"""Direct light that goes through wrong cells from which photos do not tell how much there is."""
_HARDLY = 0.05
"""Share of direct light in a scene that is hardly any."""


def judge_unseen_panels(look: PanelLook, *, measured: bool) -> Iterator[VerdictFinding]:
    """Panels of which no photos tell where they lie. measured : whether a calibration does: where
    nobody could look, its word is taken. Too few quads are a remark: only toys have so few."""
    if look.mask is not None:
        return
    if look.why:
        if measured:
            return
        text = (
            f"nobody looked whether panels and camera lie where they are believed to: {look.why}; "
            f"{_CALIBRATE}"
        )
        if look.why == TOO_FEW:
            yield VerdictFinding(Grade.REMARK, text)
            return
    elif look.mask_seen:
        text = (
            "nobody knows whether both panels lie alike: blocks on the projector are not seen in "
            "the scene, which has hardly any direct light, or the projector is out of focus or "
            f"lies elsewhere; look at a plain card, or {_CALIBRATE}"
        )
    else:
        text = (
            "nobody knows where the mask lies: blocks on it are not seen by the camera; look at "
            f"its picture, its polarisers and the camera's focus, and {_CALIBRATE}"
        )
    yield VerdictFinding(Grade.DOUBTFUL, text)


def judge_mask_place(
    look: PanelLook,
    mask: PanelConfig,
    size_px: tuple[int, int],
    lost: LostDirectLight,
    share: float,
    side_px: float,
    limits: VerdictLimits = LIMITS,
) -> Iterator[VerdictFinding]:
    """The mask's picture against the projector's.

    size_px : (width, height) of the field in projector pixels. share : RMS of that over the RMS of
        the answer. side_px : of the cells; a mask that lies a quarter of one elsewhere opened at
        other quads than these are divided by, of all light alike.
    """
    if look.mask is None:
        return
    lie = measure_misplacement(look.mask, size_px, known_shift_px(mask))
    grade = choose_grade(share, limits.misplaced)
    if lie.median_px >= 0.25 * side_px:
        grade = max(grade, Grade.DOUBTFUL)
    if lie.flip != "none" or (lost.mean >= HOPELESS and look.direct > _HARDLY):
        grade = Grade.BAD
    if not grade:
        return
    what = "all" if lie.flip != "none" else to_percent(lost.mean)
    yield VerdictFinding(
        grade,
        f"the mask's picture {_lies(lie)} [mask.place] says: {what} of the direct light goes "
        f"through wrong cells, {to_percent(share)} of the answer (limit "
        f"{to_percent(limits.misplaced[0])}), and a quarter of a cell is {0.25 * side_px:.3g} px; "
        f"{_mend('mask', mask.place, lie)}",
    )


def judge_field_beside_mask(
    beside_mask: Bools, field: Bools, image: Floats, step: int, limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """A part of the field that lies beside the mask's picture, from where no light comes.

    beside_mask, field : (h, w). image : the answer, (h, w, C). step : every so many quads are
    looked at. Its error bars say that nothing is known there, so that what is left may be right;
    whoever looks at the whole picture sees a dark edge, which is doubtful where light next to it
    would be much of the answer.
    """
    import scipy  # few photos have such a part

    lost, seen = beside_mask[::step, ::step], (field & ~beside_mask)[::step, ::step]
    square = np.mean(image[::step, ::step] ** 2, axis=-1)
    share = 1.0
    if seen.any():
        near = scipy.ndimage.distance_transform_edt(
            ~seen, return_distances=False, return_indices=True
        )
        whole = float(np.nansum(square[seen]))
        if whole > 0.0:
            share = float(np.sqrt(np.nansum(square[tuple(near)][lost]) / whole))
    part = float(np.count_nonzero(beside_mask & field)) / max(int(np.count_nonzero(field)), 1)
    yield VerdictFinding(
        Grade.DOUBTFUL if share >= limits.beyond else Grade.REMARK,
        f"{to_percent(part)} of the field lies beside the mask's picture, and nothing is known "
        f"there: were it as bright as next to it, {to_percent(share)} of the answer would be "
        f"missing (limit {to_percent(limits.beyond)}); {_CALIBRATE}, or move the mask",
    )


def judge_camera_place(
    look: PanelLook, place: Placing, size_px: tuple[int, int], side_px: float
) -> Iterator[VerdictFinding]:
    """What the camera sees against where it is believed to look; cells have sides of `side_px`."""
    if look.camera is None:
        return
    lie = measure_misplacement(look.camera, size_px)
    if lie.flip == "none" and lie.median_px < 0.5 * side_px:
        return
    yield VerdictFinding(
        Grade.DOUBTFUL,
        f"what the camera sees {_lies(lie)} [camera.place] says, and half a cell is "
        f"{0.5 * side_px:.3g} px: quads count as seeing other cells than they do; "
        f"{_mend('camera', place, lie)}",
    )


def _lies(lie: Misplacement) -> str:
    """Words that end in "where"."""
    right, down = lie.offset_px
    parts = [_FLIPS[lie.flip]] if lie.flip != "none" else []
    if abs(lie.turn_deg) >= _LEAST_DEG:
        way = "clockwise" if lie.turn_deg > 0.0 else "anticlockwise"
        parts.append(f"turned {way} by {abs(lie.turn_deg):.2g} degrees")
    if abs(lie.scale - 1.0) >= _LEAST_SCALE:
        parts.append(f"{lie.scale:.3f} times as large")
    across = f"{abs(right):.1f} px {'right' if right >= 0.0 else 'left'}"
    along = f"{abs(down):.1f} px {'down' if down >= 0.0 else 'up'}"
    shape = f"is {', '.join(parts)}, and " if parts else ""
    return (
        f"{shape}lies {across} and {along} (projector pixels, at the field's middle; up to "
        f"{lie.most_px:.3g} px over it) of where"
    )


def _mend(device: str, place: Placing, lie: Misplacement) -> str:
    """One thing to do, and what else does where places are given by hand."""
    if place.map is not None or place.homography is not None:
        return _CALIBRATE
    right, down = lie.offset_px
    keys = []
    if lie.flip == "none":
        before = place.offset_px
        keys.append(f"offset_px = [{before[0] + right:.1f}, {before[1] + down:.1f}]")
        if abs(lie.turn_deg) >= _LEAST_DEG:
            keys.append(f"turn_deg = {place.turn_deg + lie.turn_deg:.2f}")
        if abs(lie.scale - 1.0) >= _LEAST_SCALE:
            keys.append(f"scale = {place.scale * lie.scale:.3f}")
    elif place.flip == "none":
        if lie.flip == "both":
            keys.append(f"turn_deg = {place.turn_deg + 180.0:g}")
        else:
            keys.append(f'flip = "{lie.flip}"')
    else:
        keys.append("flip")
    return f"{_CALIBRATE}, or set {', '.join(keys)} in [{device}.place]"


def is_place_measured(record: RunRecord) -> bool:
    """Whether a calibration has measured where mask and camera lie."""
    return record.mask.place.map is not None and record.camera_place.map is not None


def list_placement_warnings(record: RunRecord, window: str) -> list[str]:
    """What a user is to hear at once, before the other photos are taken; a share of the answer is
    not known yet, and is that of a scene with as much light of either kind as the blocks show."""
    look, found = record.panels, list[VerdictFinding]()
    if look is None:
        return []
    size_px, lost = record.projector.field_size_px, estimate_lost_direct(record, window)
    share = predict_indirect_error(look.direct, lost.rms)
    found += judge_unseen_panels(look, measured=is_place_measured(record))
    found += judge_mask_place(look, record.mask, size_px, lost, share, mean_cell_px(record))
    found += judge_camera_place(look, record.camera_place, size_px, mean_cell_px(record))
    return [finding.text for finding in found]


def predict_indirect_error(direct: float, lost: float) -> float:
    """Error of indirect light by direct light that was lost to it, in a scene with such a share of
    direct light."""
    return lost * direct / max(1.0 - direct + lost * direct, _HARDLY)
