"""The verdict on single shots: their light, the room's, and whether panels kept time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.bench.exposure_time import describe_time_conflict
from pdcd.pictures.combine import list_white_photos
from pdcd.runs.record import ShotRecord
from pdcd.sensor.profile import SensorProfile
from pdcd.verdict.causes import Cause, VerdictFinding, judge
from pdcd.verdict.evidence import Evidence, list_evenly

_NO_WEIGHT = 1e-9
"""Light below which it counts as none."""
_SURE = 3.0
"""Least light of a lit cell, in standard deviations of the noise of its mean."""
_LEAKS, _LEAST_INK = 2.0, 0.02
"""Most light of a dark cell: this multiple of what the panels' black lets through of bright light,
or the share of bright light that anything black reflects."""
_LONG, _MOST_OF_LINE = 6, 0.5
"""Least length of a line of cells, and the share of it that must be dark, for a panel not to have
shown it: a few cells in a row may be black by themselves."""
_BRIGHT = 95.0
"""Percentile of the field's light that stands for bright places."""


def judge_shots(seen: Evidence) -> Iterator[VerdictFinding]:
    """All findings on the shots that the answer is made of."""
    shares = {name: _saturated_share(seen, name) for name in seen.names}
    if shares:
        worst = max(shares, key=lambda name: shares[name])
        yield from judge(Cause.SATURATED, shares[worst], shot=worst)
    yield from _judge_lit_shots(seen)
    yield from _judge_room_light(seen)
    if "white" in seen.pictures and list_white_photos(seen.decoded.recipe):
        yield from judge_dark_cells(find_dark_cells(seen), seen.cells.grid)
    yield from judge_refreshes(seen.records)
    exif = {name: shot.exif.get("exposure_s") for name, shot in seen.decoded.shots.items()}
    told_s = {name: told for name, told in exif.items() if isinstance(told, float)}
    yield from judge_exposure_times(seen.records, told_s)
    first = next(iter(seen.decoded.shots.values()), None)
    yield from judge_levels({} if first is None else first.exif, seen.record.profile)


def _saturated_share(seen: Evidence, name: str) -> float:
    """Share of the quads of the field that a shot has saturated; dead ones do not count."""
    where = seen.cells.known if seen.decoded.dead is None else seen.cells.known & ~seen.decoded.dead
    saturated = int(np.count_nonzero(seen.decoded.shots[name].saturated & where))
    return saturated / max(int(np.count_nonzero(seen.cells.known)), 1)


def _judge_lit_shots(seen: Evidence) -> Iterator[VerdictFinding]:
    """Whether shots that were lit have light, and none outside the field."""
    thin, dark = seen.thin, _find_shots_that_may_be_dark(seen)
    for name in list_evenly([n for n in seen.names if not seen.planned[n].of_leaks]):
        shot = seen.decoded.shots[name]
        # Some are meant to be dark, as one pattern of a few cells is.
        if name in dark or not shot.realised.total_s > 0.0:
            continue
        light, variance = thin.light(shot), thin.variance(shot)
        yield from judge_light(name, thin.inside(light), thin.inside(variance))
        grey = light.mean(axis=1)
        yield from judge_light_outside(name, thin.inside(grey), thin.outside(grey))


def _find_shots_that_may_be_dark(seen: Evidence) -> set[str]:
    """Shots of photos without direct light: things may have no other, such as a flat card. A white
    photo has to be among the shots that are judged, and blocks on both panels have to be seen:
    otherwise a panel that stays black looks the same."""
    look = seen.record.panels
    if look is None or look.mask is None or look.camera is None:
        return set()
    if not any(seen.planned[name].all_light for name in seen.names):
        return set()
    blocked = [photo for photo in seen.photos if not photo.wanted.diagonal().any()]
    return {name for photo in blocked for _, name in photo.shots}


def judge_light(shot: str, light: Floats, variance: Floats) -> list[VerdictFinding]:
    """Whether a shot that was lit has light; light, variance (n, C) of pixels in the field."""
    grey = light.mean(axis=1)
    if not grey.size:
        return judge(Cause.FIELD_UNSEEN, shot=shot)
    noise = variance.mean(axis=1) / variance.shape[1]
    error, mean = float(np.sqrt(noise.sum())) / grey.size, float(grey.mean())
    times = np.inf if mean > 0.0 else 0.0
    if error > 0.0:
        times = mean / error
    if found := judge(Cause.NO_LIGHT, times, shot=shot):
        return found
    # The mean square without the part of the noise; never less than the square of the mean.
    power = max(float(np.mean(grey**2) - noise.mean()), mean**2)
    return judge(Cause.UNDER_EXPOSED, float(np.sqrt(noise.mean() / power)), shot=shot)


def judge_light_outside(shot: str, inside: Floats, outside: Floats) -> list[VerdictFinding]:
    """Light (n,) of pixels inside and outside the field."""
    if not inside.size or not outside.size:
        return []
    share = _over(float(np.median(outside)), float(np.median(inside)))
    return judge(Cause.LIGHT_OUTSIDE, share, shot=shot)


def _judge_room_light(seen: Evidence) -> Iterator[VerdictFinding]:
    """The worst of the shots with a black projector, compared with bright places of the white
    photo; where there is none, with the lit shot that it belongs to."""
    shots, thin = seen.decoded.shots, seen.thin
    white, found = _white_rate(seen), []
    for name in seen.names:
        base, shot = name.partition("-black-")[0], seen.planned[name]
        if not shot.primal_black or shot.dual_black or base not in shots:
            continue
        black, lit = shots[name].realised, shots[base].realised
        dark, bright = (float(thin.inside(thin.light(shots[n])).mean()) for n in (name, base))
        stray = dark - _over(black.total_s, lit.total_s) * bright
        share = _over(stray, bright)
        if white is not None:
            rate = _over(stray, float(black.open_s.mean()))
            share = rate / max(white - rate, _NO_WEIGHT)  # the white photo has the room's, too
        found.append((share, name))
    if found:
        share, name = max(found)
        yield from judge(Cause.STRAY if white is None else Cause.ROOM, share, shot=name)


def _white_rate(seen: Evidence) -> float | None:
    """Light within a second in bright places of a photo of all light, None where there is none."""
    for name, shot in seen.planned.items():
        if not shot.all_light or name not in seen.decoded.shots:
            continue
        white = seen.decoded.shots[name]
        light = seen.thin.inside(seen.thin.light(white).mean(axis=1))
        if light.size:
            bright = float(np.percentile(light, _BRIGHT))
            rate = _over(bright, float(white.realised.open_s.mean()))
            if rate > 0.0:
                return rate
    return None


def find_dark_cells(seen: Evidence) -> tuple[Bools, Bools]:
    """Cells that have no light in the white picture, by its sampled pixels, and those of which any
    is known, (N,) each. No light: nothing above its noise, or no more than what black lets through.
    """
    thin, white = seen.thin, seen.pictures["white"]
    light = thin.pick(white.image).mean(axis=1)
    noise = np.mean(thin.pick(white.sensor) ** 2, axis=1) / white.image.shape[2]
    lost = ~np.isfinite(noise)
    means = thin.mean(np.where(lost, 0.0, light), lost)
    counts = np.bincount(thin.cell[(thin.cell >= 0) & ~lost], minlength=thin.cells)
    errors = np.sqrt(thin.mean(np.where(lost, 0.0, noise), lost) / np.maximum(counts, 1))
    known = counts > 0
    if not known.any():
        return np.zeros_like(known), known
    leak = sum(1.0 / (one.contrast or np.inf) for one in (seen.record.projector, seen.record.mask))
    black = min(_LEAKS * leak, _LEAST_INK) * float(np.percentile(means[known], _BRIGHT))
    dark = known & (np.where(known, means, 0.0) < np.maximum(black, _SURE * errors))
    return dark, known


def judge_dark_cells(found: tuple[Bools, Bools], grid: tuple[int, int]) -> list[VerdictFinding]:
    """The finding on `find_dark_cells`. Whole dark rows or columns between lit ones are the fault
    of a panel: a black thing has an outline."""
    dark, known = found
    number = int(np.count_nonzero(dark))
    share = number / max(int(np.count_nonzero(known)), 1)
    told = f"{number} of {np.count_nonzero(known)} cells"
    lines = []
    for axis, name in ((1, "rows"), (0, "columns")):
        lit = np.flatnonzero((known & ~dark).reshape(grid).any(axis=axis))
        of_line = dark.reshape(grid).sum(axis=axis) > _MOST_OF_LINE * max(grid[axis], _LONG)
        of_line[lit] = False
        count = int(np.count_nonzero(of_line[lit[0] : lit[-1]])) if lit.size else 0
        if count:
            lines.append(f"{count} whole {name}")
    if lines:
        return judge(Cause.DARK_LINES, share, dark=told, lines=" and ".join(lines))
    return judge(Cause.DARK_CELLS, share, dark=told)


def _over(one: float, other: float) -> float:
    """`one` over `other`; 0 where `other` is none."""
    return one / other if other > 0.0 else 0.0


def judge_refreshes(shots: Sequence[ShotRecord]) -> Iterator[VerdictFinding]:
    """Whether panels showed what they were to show while the shutter was open."""
    unequal = [s for s in shots if s.level is None]
    missed = sum(s.missed for s in unequal)
    yield from judge(Cause.MISSED, len(unequal), shots=_list_first(unequal), missed=missed)
    early = [s for s in shots if s.refreshes and s.close_ns < max(s.end_ns)]
    early_s = max((max(s.end_ns) - s.close_ns for s in early), default=0) * 1e-9
    yield from judge(Cause.CLOSED_EARLY, len(early), shots=_list_first(early), early_s=early_s)
    unsure = [s for s in shots if s.refreshes and not s.verified]
    source = next((s.source for s in unsure), "")
    yield from judge(Cause.UNVERIFIED, len(unsure), shots=_list_first(unsure), source=source)


def judge_exposure_times(
    shots: Sequence[ShotRecord], told_s: Mapping[str, float]
) -> list[VerdictFinding]:
    """Whether the planned exposure, the logged one and the camera's own agree; `told_s` is the
    camera's, by shot, 0 where its file does not say."""
    found = []
    for shot in shots:
        open_s = shot.open_s
        told = describe_time_conflict(shot.planned_s or open_s, open_s, told_s.get(shot.name, 0.0))
        if told:
            found.append((shot, told))
    conflict = found[0][1] if found else ""
    shots = [shot for shot, _ in found]
    return judge(Cause.EXPOSURE_TIMES, len(found), shots=_list_first(shots), conflict=conflict)


def judge_levels(exif: Mapping[str, object], profile: SensorProfile) -> list[VerdictFinding]:
    """Whether the numbers of a photo span the range of its sensor's profile; `exif` is what the
    file says about itself."""
    black, white = exif.get("black_dn"), exif.get("white_dn")
    if not isinstance(black, list) or not isinstance(white, float):
        return []
    reach = white - float(np.mean(black))
    times = reach / (profile.white_dn - profile.black_dn)
    off = max(times, _over(1.0, times))
    return judge(Cause.LEVELS, off, reach=reach, times=times, profile=profile.name)


def _list_first(shots: Sequence[ShotRecord]) -> str:
    if not shots:
        return ""
    return f"shot {shots[0].name}" + (f" and {len(shots) - 1} more" if len(shots) > 1 else "")
