"""The configurations that pdcd gets of a stranger's bench: by data sheets, or with the truth typed.

The truth is typed as a user would who knew everything: maps in a file, times, contrasts, the room.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.config import load_config
from pdcd.bench.reading import format_toml
from pdcd.bench.tables import Config
from pdcd.panels.map import Map, MapMatrix
from pdcd.panels.map_file import save_maps
from tests.strangers.package.strangers_bench.facts import CAMERAS, ENGRAVED, Facts, PanelFacts
from tests.strangers.package.strangers_bench.places import Place

Floats = NDArray[np.float64]

PACKAGE = Path(__file__).resolve().parent / "package"
GRIDS = ((18, 24), (15, 20), (13, 17), (16, 22))
"""Rows and columns of cells, by seed: those that divide the panels, and others."""
CARD_ALBEDO = 1.0
"""Of the white card of the bench (`scene.Scene.albedo`), as its maker says."""
STEP_PX = 8
"""In which the field that all three share is looked for."""
SCAN_BANDS = 16
"""As a calibration has them: what is realised is worked out for each band."""
NODES = 24
"""Nodes of the smooth part of a map that is typed, along each axis."""


def install() -> None:
    """Let Python find the bench's package, as if it were installed."""
    if str(PACKAGE) not in sys.path:
        sys.path.insert(0, str(PACKAGE))


def write_bench(facts: Facts, folder: Path, *, mirrored: bool = False) -> dict[str, Path]:
    """Write the configurations "sheet" and "truth" of a bench below a folder; returns their files.

    Each has a state folder of its own, so that what one calibrates the other does not use.
    mirrored : the sheet says that the mask is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    facts.save(folder / "facts.json")
    files = {}
    sheet = _sheet(facts, folder)
    if mirrored:
        sheet["mask"]["place"] = {"flip": "horizontal"}
    for name, table in (("sheet", sheet), ("truth", _typed(facts, folder))):
        table["server"] = {"state_dir": str(folder / f"state-{name}")}
        files[name] = folder / f"{name}.toml"
        files[name].write_text(format_toml(table))
    return files


def grid_of(facts: Facts) -> tuple[int, int]:
    """Rows and columns of cells of a bench."""
    return GRIDS[(facts.seed // 2) % len(GRIDS)]


def read_config(file: Path) -> Config:
    """The configuration as pdcd reads it."""
    return load_config(file)


def true_maps(facts: Facts) -> dict[str, Map]:
    """Maps of all three devices to the field: the largest upright rectangle that all share."""
    size_px = facts.projector.size_px
    frame = CAMERAS[facts.camera][0]
    mask = Place(facts.mask_place, facts.mask.size_px, size_px)
    camera = Place(facts.camera_place, frame, size_px)
    field = shared_field(facts, mask, camera)
    left, top, right, bottom = field
    width, height = right - left, bottom - top
    matrix = np.array([[1 / width, 0, -left / width], [0, 1 / height, -top / height], [0, 0, 1]])
    return {
        "projector": Map(size_px=size_px, homography=_nine(matrix)),
        "mask": _as_map(mask, facts.mask.size_px, field),
        "camera": _as_map(camera, frame, field),
    }


def shared_field(facts: Facts, mask: Place, camera: Place) -> tuple[int, int, int, int]:
    """Left, top, right and bottom, in pixels of the projector, of the largest rectangle all of
    which lies on the mask and before the camera."""
    width, height = facts.projector.size_px
    xs, ys = np.arange(0, width + 1, STEP_PX), np.arange(0, height + 1, STEP_PX)
    points = np.stack(np.meshgrid(xs, ys), axis=-1).astype(np.float64)
    good = np.ones(points.shape[:2], dtype=np.bool_)
    for place, size in ((mask, facts.mask.size_px), (camera, CAMERAS[facts.camera][0])):
        at = place.from_scene(points)
        good &= np.all((at >= 1.0) & (at <= np.array(size) - 1.0), axis=-1)
    bad = np.pad(np.cumsum(np.cumsum(~good, axis=0), axis=1), ((1, 0), (1, 0)))
    best, found = 0, (0, 0, width, height)
    for top in range(len(ys) - 1):
        for bottom in range(top + 1, len(ys)):
            free = bad[bottom + 1, 1:] - bad[bottom + 1, :-1] - bad[top, 1:] + bad[top, :-1] == 0
            edges = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(int), [0]])))
            for left, end in zip(edges[::2], edges[1::2], strict=True):
                area = (end - 1 - left) * (bottom - top)
                if area > best:
                    best = int(area)
                    found = (int(xs[left]), int(ys[top]), int(xs[end - 1]), int(ys[bottom]))
    return found


def _nine(matrix: Floats) -> MapMatrix:
    a, b, c, d, e, f, g, h, i = (float(v) for v in matrix.ravel())
    return a, b, c, d, e, f, g, h, i


def _sheet(facts: Facts, folder: Path) -> dict[str, Any]:
    """What the data sheets say: sizes, round times, contrasts, the card; nothing of places."""
    options = {"facts": str(folder / "facts.json")}
    frame, bits, black, white, gain, read_e, full_e = CAMERAS[facts.camera]
    (folder / "sensor.toml").write_text(
        _profile(facts.camera, frame, bits, black, white, gain, read_e, full_e)
    )
    return {
        "rig": {"name": f"stranger {facts.seed}"},
        "projector": {"size_px": facts.projector.size_px, "rise_s": 0.002, "fall_s": 0.002,
                      "contrast": 1000.0},
        "mask": {"size_px": facts.mask.size_px, "rise_s": 0.004, "fall_s": 0.004,
                 "contrast": 500.0},
        "display": {"driver": "foreign", "options": options},
        "trigger": {"driver": "foreign", "options": options},
        "camera": {"driver": "foreign", "options": options, "f_number": "auto",
                   "profile": str(folder / "sensor.toml")},
        "schedule": {"grid": grid_of(facts)},
        "calibration": {"card_albedo": CARD_ALBEDO},
        "limits": {"min_free_bytes": 0},
    }  # fmt: skip


def _typed(facts: Facts, folder: Path) -> dict[str, Any]:
    found = _sheet(facts, folder)
    save_maps(folder / "maps.npz", true_maps(facts))
    frame, bits, black, white, gain, read_e, full_e = CAMERAS[facts.camera]
    (folder / "true-sensor.toml").write_text(
        _profile(facts.camera, frame, bits, black, white, gain * facts.gain,
                 read_e * facts.read_noise, full_e)
    )  # fmt: skip
    found["camera"] |= {
        "profile": str(folder / "true-sensor.toml"),
        "responsivity_e": facts.responsivity_e,
        "blur_quads": facts.blur_quads,
        "place": {"map": "maps.npz"},
        "stops": [
            {"f_number": engraved, "true": true, "sigma": 0.0}
            for engraved, true in zip(ENGRAVED, facts.stops, strict=True)
        ],
    }
    for name, panel in (("projector", facts.projector), ("mask", facts.mask)):
        found[name] |= _panel(panel) | {"place": {"map": "maps.npz"}}
    # A lag of more than half a refresh is taken out by sending the mask's pictures sooner.
    delay = -math.floor(_lag_s(facts) * 60.0 + 0.5)
    found["display"]["mask_delay_refreshes"] = delay
    found["mask"] |= {"blur_px": facts.blur_px}
    found["scene"] = {"ambient": facts.room}
    found["trigger"] |= {"lag_s": facts.lag_s, "jitter_s": facts.jitter_s}
    found["calibration"] |= {"use": "none"}
    found["schedule"] |= {"guards": "auto"}
    return found


def _lag_s(facts: Facts) -> float:
    """Of the mask in the middle of the scene, after the projector."""
    middle = [p.late_s + abs(p.scan_s) / 2.0 for p in (facts.mask, facts.projector)]
    return middle[0] - middle[1]


def _panel(panel: PanelFacts) -> dict[str, Any]:
    return {
        "skew_s": panel.late_s, "scan_s": panel.scan_s, "scan_bands": SCAN_BANDS,
        "rise_s": panel.rise_s, "fall_s": panel.fall_s, "contrast": panel.contrast,
        "gamma": panel.gamma,
    }  # fmt: skip


def _as_map(place: Place, size_px: tuple[int, int], field: tuple[int, int, int, int]) -> Map:
    """The same place as a homography and a smooth rest at nodes."""
    width, height = size_px
    nodes = np.stack(
        np.meshgrid(np.linspace(0.0, width, NODES), np.linspace(0.0, height, NODES)), axis=-1
    )
    corner, end = np.array(field[:2]), np.array(field[2:])
    wanted = (place.to_scene(nodes) - corner) / (end - corner)
    matrix = _homography(nodes.reshape(-1, 2), wanted.reshape(-1, 2))
    back = np.concatenate([wanted, np.ones((*wanted.shape[:2], 1))], axis=-1)
    back = back @ np.linalg.inv(matrix).T
    rest = back[..., :2] / back[..., 2:] - nodes
    return Map(
        size_px=size_px,
        homography=_nine(matrix),
        residual=tuple(tuple((float(x), float(y)) for x, y in row) for row in rest),
    )


def _homography(points: Floats, wanted: Floats) -> Floats:
    """The best one from points to others, by least squares of its linear equations."""
    scale = np.diag([*(1.0 / points.max(axis=0)), 1.0])
    unit = points / points.max(axis=0)
    one, none = np.ones(len(points)), np.zeros((len(points), 3))
    ahead = np.column_stack([unit, one])
    x, y = wanted[:, 0], wanted[:, 1]
    rows = np.concatenate([
        np.column_stack([ahead, none, -x[:, None] * unit]),
        np.column_stack([none, ahead, -y[:, None] * unit]),
    ])  # fmt: skip
    found = np.linalg.lstsq(rows, np.concatenate([x, y]), rcond=None)[0]
    return np.asarray(np.append(found, 1.0).reshape(3, 3) @ scale)


def _profile(name: str, frame: tuple[int, int], bits: int, black: int, white: int, gain: float,
             read_e: float, full_e: float) -> str:  # fmt: skip
    return (
        f'name = "foreign {name}"\ndescription = "the camera of a stranger"\nsource = "made up"\n'
        f"estimated = true\nbits = {bits}\nblack_dn = {black}\nwhite_dn = {white}\n"
        f"full_well_e = {full_e}\ndark_e_per_s = 0.05\nframe_quads = [{frame[0]}, {frame[1]}]\n\n"
        f"[[rows]]\niso = 100\ngain_e_per_dn = {gain}\nread_noise_e = {read_e}\n"
    )
