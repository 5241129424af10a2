"""A stream in the worker: photos that renew a finished first set, picture after picture.

The owner of the devices takes the photos of all rounds, over and over. In the darkroom each
photo replaces the one before it, which is forgotten, so that memory does not grow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.capture.worker.answers import AdoptedPlan, PhotoOrder, compute_rms_sigma
from pdcd.capture.worker.plan_owner import Course
from pdcd.errors import DecodeError, ExposureError, disk_errors
from pdcd.files.images import encode_jpeg
from pdcd.panels.frames import FrameLog, Frames
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.rolling import RollingPictures, keep_answer
from pdcd.pictures.to_cells import average_with_errors
from pdcd.pictures.written.previews import encode_gamma
from pdcd.protocol.stream import MOST_DRAWN_PX
from pdcd.recipes.parts import list_parts
from pdcd.recipes.recipe import Recipe, Shot
from pdcd.runs.frame_table import restore_frames
from pdcd.runs.record import ShotRecord
from pdcd.watch import Watch

_BRIGHT, _FOLLOWS = 0.99, 0.1
"""Share of the cells that are drawn darker than white, and share of a change of that level which
each picture follows: a live view must not flicker."""


@dataclass(frozen=True)
class StreamRound:
    """The photos of one picture: those of a part, after others that it needs."""

    part: int
    photos: tuple[PhotoOrder, ...]


@dataclass(frozen=True, eq=False)
class StreamPhoto:
    """A photo as it came: the shots of its planes, the frame log, and its files in memory by their
    paths below the run folder."""

    shots: tuple[ShotRecord, ...]
    log: FrameLog
    held: Mapping[str, bytes]


@dataclass(frozen=True, eq=False)
class RollingPicture:
    """A picture of a stream.

    image, sigma : (rows, cols, C) float64, means over cells, as in `pdcd.api.run.Run`. picture,
        picture_sigma : (h, w, C), of the camera's own quads. kind : of sigma. rms_sigma : RMS of
        sigma over that of the picture, None where it is not known. over : number of parts that it
        is made of. unknown : share of the quads of which nothing is known. jpeg, size_px : the
        picture as drawn, where that was wanted.
    """

    image: Floats
    sigma: NDArray[np.floating]
    picture: Floats
    picture_sigma: NDArray[np.floating]
    kind: str
    rms_sigma: float | None
    over: int
    unknown: float
    jpeg: bytes = b""
    size_px: tuple[int, int] = (0, 0)


class StreamCourse:
    """The state of a stream whose first set of photos was taken by a course."""

    def __init__(self, course: Course, over: int, watch: Watch) -> None:
        """over : how many of the newest parts make a picture. Raises DecodeError."""
        self._course = course
        self._rolling = RollingPictures(course.darkroom, over, watch)
        self._frames: dict[str, Frames] = {}
        rounds = make_rounds(keep_answer(course.plan.recipe))
        orders: dict[str, PhotoOrder] = {}
        for shot in (shot for _, shots in rounds for shot in shots):
            order = orders[shot.name] = orders.get(shot.name) or course.order(shot)
            self._frames |= {order.name: order.frames, **dict(order.beside)}
        self.rounds = tuple(
            StreamRound(part, tuple(orders[shot.name] for shot in shots)) for part, shots in rounds
        )
        self._white = 0.0

    def see(
        self, watch: Watch, photo: StreamPhoto, part: int | None, *, draw: bool
    ) -> RollingPicture | str | None:
        """Take a photo; with `part` it is the last one of that part, and its picture is made.

        draw : also as a JPEG. For a bad photo, returns what is wrong in words: it cannot be read,
            or its time of exposure is not the planned one, or its ISO or stop is not the one asked
            for.
        """
        shelf = self._course.shelf
        before = {path: shelf.held(path) for path in photo.held}
        for path, data in photo.held.items():
            shelf.hold(path, data)
        try:
            for shot in photo.shots:
                self._rolling.renew(shot, *restore_frames(self._frames[shot.name], photo.log))
        except (DecodeError, ExposureError) as err:
            for path, old in before.items():
                shelf.hold(path, old)
            return err.message
        try:
            return None if part is None else self._make(part, watch, draw=draw)
        except DecodeError as err:
            return err.message

    def _make(self, part: int, watch: Watch, *, draw: bool) -> RollingPicture:
        """The picture from the newest parts. Raises DecodeError."""
        made = self._rolling.picture(part, watch)
        cells = average_with_errors(
            made, self._course.darkroom.cells, self._rolling.find_full_quads()
        )
        rms = compute_rms_sigma(cells)
        unknown = np.isinf(made.sigma)
        jpeg, size_px = self._drawn(made, cells) if draw else (b"", (0, 0))
        return RollingPicture(
            image=cells.image,
            sigma=cells.sigma,
            picture=made.image,
            picture_sigma=made.sigma,
            kind=made.kind,
            rms_sigma=rms if np.isfinite(rms) else None,
            over=self._rolling.over,
            unknown=float(unknown.any(axis=-1).mean()),
            jpeg=jpeg,
            size_px=size_px,
        )

    def keep(self, folder: Path) -> tuple[AdoptedPlan, Darkroom]:
        """Write the codes and the newest photo of each shot into a run folder, with all other
        photos of its record. Returns the plan as it has to be kept, and a darkroom for that folder.
        Raises NoSpaceError and DiskError."""
        course = self._course
        record = course.darkroom.record
        course.write_patterns(folder)
        with disk_errors(str(folder.resolve())):
            for path, data in course.shelf.list_all():
                (folder / path).write_bytes(data)
        return course.adopted(), Darkroom(folder, record)

    def _drawn(
        self, made: PictureWithErrors, cells: PictureWithErrors
    ) -> tuple[bytes, tuple[int, int]]:
        """A picture for viewing, as bright as those before it."""
        white = float(np.quantile(cells.image.max(axis=-1), _BRIGHT)) or 1.0
        self._white = (
            white if self._white <= 0.0 else self._white + _FOLLOWS * (white - self._white)
        )
        light = made.image.astype(np.float32)
        over = max(light.shape[:2]) / MOST_DRAWN_PX
        if over > 1.0:
            size = round(light.shape[1] / over), round(light.shape[0] / over)
            small = cv2.resize(np.ascontiguousarray(light), size, interpolation=cv2.INTER_AREA)
            light = np.asarray(small, np.float32).reshape(*small.shape[:2], -1)
        drawn = encode_gamma(light / np.float32(self._white))
        drawn = drawn[..., 0] if drawn.shape[2] == 1 else drawn
        return encode_jpeg(np.ascontiguousarray(drawn)), (drawn.shape[1], drawn.shape[0])


def make_rounds(recipe: Recipe) -> list[tuple[int, tuple[Shot, ...]]]:
    """The photos of each part, in order, by its number.

    Photos that all parts share are repeated with every part where the answer is made of them, as
    for what remains of all light; otherwise they come once per set, because they show little that
    changes. Raises DecodeError where there are no parts.
    """
    wanted = {name for photo in recipe.photos for _, name in photo.shots}
    taken = [
        shot
        for shot in recipe.shots
        if shot.name in wanted and shot.name not in recipe.stack and not shot.beside
    ]
    of_answer = {name for photo in recipe.answer_photos for _, name in photo.shots}
    shared = [shot for shot in taken if not shot.part]
    each = any(shot.name in of_answer for shot in shared)
    parts = list_parts(recipe)
    if not parts:
        raise DecodeError("no parts to make a stream of")
    return [
        (
            part,
            (
                *(shared if each or part == parts[0] else ()),
                *(shot for shot in taken if shot.part == part),
            ),
        )
        for part in parts
    ]
