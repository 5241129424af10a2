"""The verdict on panels and a camera that lie elsewhere than believed, from photos of blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.bench.tables import PanelConfig
from pdcd.panels.placing import Placing
from pdcd.pictures.border_lines import find_line_pictures
from pdcd.pictures.lost_direct import (
    LostDirectLight,
    blur_with_lines_px,
    estimate_lost_direct,
    estimate_unseen_loss,
    find_quads_beside_mask,
    finding_error_px,
    measure_unseen_shift_px,
)
from pdcd.pictures.misplaced import (
    Misplacement,
    known_shift_px,
    mean_cell_px,
    measure_misplacement,
)
from pdcd.probing.wanted import shift_cells
from pdcd.runs.record import PanelLook, RunRecord
from pdcd.verdict.causes import Cause, Grade, VerdictFinding, judge
from pdcd.verdict.evidence import Evidence, compute_rms

_FLIPS = {
    "horizontal": "mirrored left to right",
    "vertical": "mirrored top to bottom",
    "both": "turned by 180 degrees",
}
_LEAST_DEG, _LEAST_SCALE = 0.05, 0.002
"""Turn and change of size from which they are mentioned."""
_UNSEEN_BLUR = 0.2
"""Least blur that photos of blocks show, in quads."""
_HOPELESS = 0.5
"""Share of direct light through wrong cells from which photos no longer measure direct light."""
_HARDLY = 0.05
"""Share of direct light in a scene below which there is hardly any."""


def judge_blocks(seen: Evidence, look: PanelLook) -> Iterator[VerdictFinding]:
    """Findings from photos of blocks on where panels and camera are, once the pictures are made."""
    record, image = seen.record, seen.decoded.answer.image
    answer = compute_rms(seen.inside(image))
    white, direct = (seen.pictures.get(name) for name in ("white", "direct"))

    def share(lost: LostDirectLight) -> float:
        if white is None or not answer > 0.0 or record.goal.name == "fraction":
            return lost.rms if _keeps_direct_light(seen) else _predict_share(look.direct, lost)
        light = look.direct * seen.inside(white.image)
        if lost.mean < _HOPELESS and direct is not None:
            light = seen.inside(direct.image) / (1.0 - lost.mean)
        return lost.rms * float(np.sqrt(np.nanmean(light**2))) / answer

    found = list(_judge_look(record, look, seen.window, share))
    yield from found or _judge_unseen_loss(seen, look, share)
    beside = find_quads_beside_mask(record, seen.cells)
    if beside is not None and beside.any():
        part = float(np.count_nonzero(beside & seen.cells.known)) / max(
            int(seen.cells.known.sum()), 1
        )
        missing = _missing_share(beside, seen.cells.known, image, seen.thin.step)
        yield from judge(Cause.BESIDE_MASK, missing, part=part)


def _judge_unseen_loss(
    seen: Evidence, look: PanelLook, share: Callable[[LostDirectLight], float]
) -> list[VerdictFinding]:
    """What a shift and a blur would do that neither blocks nor lines along borders of cells show;
    nothing where a calibration measured both maps, and with them the blur."""
    record = seen.record
    if look.mask is None or _is_measured(record) or not _weighs_neighbours(seen):
        return []
    if any(find_line_pictures(record, seen.decoded.recipe, seen.cells)):
        return []
    blur_px = _UNSEEN_BLUR * mean_cell_px(record) * seen.cells.quad_cells**0.5
    shift_px = measure_unseen_shift_px(record, look)
    lost = estimate_unseen_loss(record, seen.window, shift_px, blur_px)
    return judge(Cause.MASK_UNSURE, share(lost), shift_px=shift_px, blur_px=blur_px)


def _keeps_direct_light(seen: Evidence) -> bool:
    """Whether the answer is made of direct light, all in all."""
    return any(float(np.mean(photo.wanted.diagonal())) > 0.5 for photo in seen.photos)


def _weighs_neighbours(seen: Evidence) -> bool:
    """Whether photos of the answer weigh light from the next cell otherwise than a cell's own: far
    light alone does not change where direct light goes through a cell beside its own."""
    beside = [shift_cells(seen.cells.grid, step) for step in ((0, 1), (0, -1), (1, 0), (-1, 0))]
    return any(
        bool(np.any((photo.wanted.entries(at) != own)[at >= 0]))
        for photo in seen.photos
        for own in (photo.wanted.diagonal(),)
        for at in beside
    )


def _is_measured(record: RunRecord) -> bool:
    """Whether a calibration has measured where mask and camera lie."""
    return record.mask.place.map is not None and record.camera_place.map is not None


def list_placement_warnings(record: RunRecord, window: str) -> list[str]:
    """What to tell a user at once, before the other photos are taken. The effect on the answer is
    not known yet; it is predicted for a scene with as much direct light as the blocks show."""
    look = record.panels
    if look is None:
        return []
    found = _judge_look(record, look, window, lambda lost: _predict_share(look.direct, lost))
    return [finding.text for finding in found]


def _predict_share(direct: float, lost: LostDirectLight) -> float:
    """Error of indirect light because of lost direct light, in a scene with this share of direct
    light."""
    return lost.rms * direct / max(1.0 - direct + lost.rms * direct, _HARDLY)


def _judge_look(
    record: RunRecord, look: PanelLook, window: str, share: Callable[[LostDirectLight], float]
) -> Iterator[VerdictFinding]:
    """Findings on both panels and the camera. share : error of the answer by lost direct light."""
    size_px, cell_px = record.projector.field_size_px, mean_cell_px(record)
    yield from judge_unseen_panels(look, measured=_is_measured(record))
    lost = estimate_lost_direct(record, window, blurred=False)
    unsure_px = finding_error_px(record)
    placed = judge_mask_place(look, record.mask, size_px, lost, share(lost), cell_px, unsure_px)
    yield from placed
    known_px = record.mask.blur_px
    by_lines_px = 0.0 if placed else blur_with_lines_px(record, look)
    blur_px = max(look.blur_px, by_lines_px)  # a misplaced mask makes such lines, too
    if blur_px > known_px and look.upright:
        lost = estimate_lost_direct(record, window)
        yield from judge_mask_blur(look, blur_px, known_px, lost, share(lost))
    yield from judge_camera_place(look, record.camera_place, size_px, cell_px)


def judge_unseen_panels(look: PanelLook, *, measured: bool) -> list[VerdictFinding]:
    """Panels that no photos locate. measured : whether a calibration has; it is trusted where no
    look was possible."""
    if look.mask is not None or (look.why and measured):
        return []
    if look.why:
        return judge(Cause.NOBODY_LOOKED, why=look.why)
    return judge(Cause.PROJECTOR_UNSEEN if look.mask_seen else Cause.MASK_UNSEEN)


def judge_mask_place(
    look: PanelLook,
    mask: PanelConfig,
    size_px: tuple[int, int],
    lost: LostDirectLight,
    share: float,
    cell_px: float,
    unsure_px: float = 0.0,
) -> list[VerdictFinding]:
    """The mask's picture compared with the projector's.

    size_px : (width, height) of the field in projector pixels. share : RMS of the light lost to
        wrong cells over the RMS of the answer. cell_px : side of a cell. If the mask lies a quarter
        of a cell off, quads are divided by the weights of other windows than they saw, for all
        light alike.
    """
    if look.mask is None:
        return []
    lie = measure_misplacement(look.mask, size_px, known_shift_px(mask), look.bent_px)
    quarter_px, flipped = 0.25 * cell_px, lie.flip != "none"
    grade = Cause.MASK_PLACE.value.grade(share)
    if flipped or (lost.mean >= _HOPELESS and look.direct > _HARDLY):
        grade = Grade.BAD
    elif lie.median_px >= quarter_px - unsure_px:
        grade = max(grade, Grade.DOUBTFUL)
    return judge(
        Cause.MASK_PLACE,
        share,
        grade,
        lies=_describe_lie(lie),
        lost="all" if flipped else lost.mean,
        quarter_px=quarter_px,
        mend=_describe_mend("mask", mask.place, lie),
    )


def judge_mask_blur(
    look: PanelLook, blur_px: float, known_px: float, lost: LostDirectLight, share: float
) -> list[VerdictFinding]:
    """A blur of light on its way to the mask beyond the known one. share : RMS of the direct light
    that it sends through wrong cells over the RMS of the answer."""
    grade = Cause.MASK_BLUR.value.grade(share)
    if lost.mean >= _HOPELESS and look.direct > _HARDLY:
        grade = Grade.BAD
    return judge(Cause.MASK_BLUR, share, grade, blur_px=blur_px, known_px=known_px, lost=lost.mean)


def judge_camera_place(
    look: PanelLook, place: Placing, size_px: tuple[int, int], cell_px: float
) -> list[VerdictFinding]:
    """Where the camera looks, compared with where it is believed to; `cell_px`: side of a cell."""
    if look.camera is None:
        return []
    lie = measure_misplacement(look.camera, size_px)
    return judge(
        Cause.CAMERA_PLACE,
        lie.median_px / cell_px if lie.flip == "none" else np.inf,
        lies=_describe_lie(lie),
        half_px=0.5 * cell_px,
        mend=_describe_mend("camera", place, lie),
    )


def _missing_share(beside_mask: Bools, field: Bools, image: Floats, step: int) -> float:
    """RMS of the light that the answer, (h, w, C), lacks where the field lies beside the mask's
    picture, over the RMS of the rest, if it were as bright there as next to it; 1 where nothing
    else is seen.

    beside_mask, field : (h, w). step : every so many quads are used. Error bars are infinite there;
    whoever looks at the whole picture sees a dark edge.
    """
    import scipy  # few photos have such a part

    lost, seen = beside_mask[::step, ::step], (field & ~beside_mask)[::step, ::step]
    square = np.mean(image[::step, ::step] ** 2, axis=-1)
    whole = float(np.nansum(square[seen]))
    if not whole > 0.0:
        return 1.0
    near = scipy.ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
    return float(np.sqrt(np.nansum(square[tuple(near)][lost]) / whole))


def _describe_lie(lie: Misplacement) -> str:
    """How a picture lies, in words that end in "where"."""
    right, down = lie.offset_px
    parts = [_FLIPS[lie.flip]] if lie.flip != "none" else []
    parts += ["bent"] if lie.bent else []
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


def _describe_mend(device: str, place: Placing, lie: Misplacement) -> str:
    """One thing to do, and an alternative where places were typed in by hand."""
    if lie.bent or place.map is not None or place.homography is not None:
        return "run pdcd calibrate geometry"
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
    return f"run pdcd calibrate geometry, or set {', '.join(keys)} in [{device}.place]"
