"""How a device lies on the field, given by hand: flips, a turn, a size, a shift; or exactly."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from pdcd.arrays import Floats
from pdcd.errors import ConfigError
from pdcd.panels.map import Map, MapMatrix, to_map_matrix
from pdcd.panels.map_file import load_map
from pdcd.panels.map_soundness import check_map


class Placing(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[projector.place], [mask.place] or [camera.place].

    With nothing given the device fills the field, upright. Else its picture on the field is first
    mirrored, then turned about the field's centre, then enlarged, then shifted. `homography`
    gives all of that at once instead.
    """

    flip: Literal["none", "horizontal", "vertical"] = "none"
    """"horizontal": left and right exchanged."""
    turn_deg: float = 0.0
    """Clockwise, as the projector sees the scene; upside down is 180."""
    scale: Annotated[float, Meta(gt=0.0)] = 1.0
    """Size of the device's picture, over that of the field."""
    offset_px: tuple[float, float] = (0.0, 0.0)
    """Shift of the device's picture (right, down), in projector pixels."""
    homography: MapMatrix | None = None
    """3 x 3, row by row, of (x, y, 1); `homography_from` gives its direction."""
    homography_from: Literal["pixels", "field"] = "pixels"
    """"pixels": from the device's pixels (of a camera: Bayer quads), whose first one covers 0 to 1,
    to the field, which covers 0 to 1 either way; "field": from the field to them."""
    radial: tuple[float, float] = (0.0, 0.0)
    """k1, k2 of the lens: straight = seen (1 + k1 r^2 + k2 r^4), r in half heights of the
    picture."""
    tangential: tuple[float, float] = (0.0, 0.0)
    """p1, p2 of the same."""
    map: str | Map | None = None
    """File of a calibration, .npz, instead of all of these: it holds the map of this device by the
    name of its table. When a configuration is read, the content of the file replaces its name, so
    that all who use the configuration, and the records of its runs, have the same map."""

    @property
    def by_hand(self) -> tuple[str, ...]:
        """What is given by hand, by key."""
        return tuple(
            name for name, default in _by_hand_defaults() if getattr(self, name) != default
        )


@cache
def _by_hand_defaults() -> tuple[tuple[str, object], ...]:
    """Each key of a place by hand, and its default."""
    return tuple((f.name, f.default) for f in msgspec.structs.fields(Placing) if f.name != "map")


def make_placed_map(
    placing: Placing, size_px: tuple[int, int], projector_px: tuple[int, int], device: str
) -> Map:
    """The map of a device that is placed by hand.

    size_px, projector_px : (width, height) of the device, and of the projector, whose pixels are
        square: they define a turn on a field that is not square.

    Raises ConfigError for a map that cannot be used (`pdcd.panels.map_soundness`), one of another
    size, a file that cannot be read, and a place that is given twice.
    """
    check_once(placing, device)
    if placing.map is not None:
        return _given(placing.map, size_px, device)
    return _worked_out(placing, tuple(size_px), tuple(projector_px), device)


@lru_cache(maxsize=32)
def _worked_out(
    placing: Placing, size_px: tuple[int, int], projector_px: tuple[int, int], device: str
) -> Map:
    """The map of a place by hand, without a file; cached, as every capture needs it many times."""
    filling = Map.filling(size_px)
    if placing.homography is None:
        lens = filling.then(_by_hand(placing, projector_px))
    else:
        given: Floats = np.array(placing.homography, dtype=np.float64).reshape(3, 3)
        usable = bool(np.isfinite(given).all()) and np.linalg.matrix_rank(given) == 3
        if placing.homography_from == "field" and usable:
            given = np.asarray(np.linalg.inv(given), dtype=np.float64)
        lens = msgspec.structs.replace(filling, homography=to_map_matrix(given))
    bent = msgspec.structs.replace(lens, radial=placing.radial, tangential=placing.tangential)
    return check_map(bent, device)


def check_once(placing: Placing, device: str) -> None:
    """Raise ConfigError for a place that is given twice: by a map or a homography, and by hand."""
    whole = "map" if placing.map is not None else "homography"
    besides = set(placing.by_hand)
    if placing.map is None:
        besides &= {"flip", "turn_deg", "scale", "offset_px"} if placing.homography else set()
    if besides:
        raise ConfigError(
            f"{whole} says where the {device} lies, and so does {', '.join(sorted(besides))}",
            device=device,
            hint="take out one of them",
        )


def _given(given: str | Map, size_px: tuple[int, int], device: str) -> Map:
    """The map of a file or a table, if it is for a device of that size."""
    found = load_map(given, device) if isinstance(given, str) else check_map(given, device)
    if found.size_px != tuple(size_px):
        wide, high = found.size_px
        raise ConfigError(
            f"the map is of a {device} of {wide} x {high} pixels, this one has "
            f"{size_px[0]} x {size_px[1]}"
            + (", counted in pixels of its pictures" if device == "camera" else ""),
            device=device,
            hint="calibrate the geometry again",
        )
    return found


def _by_hand(placing: Placing, projector_px: tuple[int, int]) -> Floats:
    """Flip, turn, size and shift as a homography from field to field."""
    width, height = projector_px
    # In projector pixels about the centre of the field, where a rotation keeps shapes.
    to_px = np.array([[width, 0.0, -0.5 * width], [0.0, height, -0.5 * height], [0.0, 0.0, 1.0]])
    sides = {"none": (1.0, 1.0), "horizontal": (-1.0, 1.0), "vertical": (1.0, -1.0)}
    flip = np.diag([*sides[placing.flip], 1.0])
    cos, sin = _turn(placing.turn_deg)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    size = np.diag([placing.scale, placing.scale, 1.0])
    shift = np.eye(3)
    shift[:2, 2] = placing.offset_px
    whole: Floats = np.linalg.inv(to_px) @ shift @ size @ turn @ flip @ to_px
    return whole


def _turn(degrees: float) -> tuple[float, float]:
    """Cosine and sine, exact for quarter turns."""
    quarters = {0.0: (1.0, 0.0), 90.0: (0.0, 1.0), 180.0: (-1.0, 0.0), 270.0: (0.0, -1.0)}
    angle = degrees % 360.0
    return quarters.get(angle) or (
        float(np.cos(np.radians(angle))),
        float(np.sin(np.radians(angle))),
    )


_SINGULAR = 1e-9
"""Determinant over the cube of the largest entry below which there is no inverse."""
_HORIZON = 1e-6
"""The same for the depth of a point."""


def project_points(matrix: tuple[float, ...], points: Floats) -> Floats:
    """Points (n, 2) of one field, 0 to 1 across and down, on the other: (n, 2).

    matrix : nine numbers, row by row, for (x, y, 1).

    Raises ValueError, in words for a user, for a matrix without an inverse or one that takes any of
    the points to infinity or behind it.
    """
    homography = np.array(matrix, dtype=np.float64).reshape(3, 3)
    scale = float(np.abs(homography).max())
    if not np.isfinite(scale) or scale == 0.0 or abs(np.linalg.det(homography / scale)) < _SINGULAR:
        raise ValueError("the homography has no inverse")
    places = np.column_stack([points, np.ones(len(points))]) @ homography.T
    depth = places[:, 2] / scale
    if not (np.all(depth > _HORIZON) or np.all(depth < -_HORIZON)):
        raise ValueError("the homography takes a part of the field to infinity")
    found: Floats = places[:, :2] / places[:, 2:]
    return found
