"""Places on the field as a configuration says them: from files, on a part, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from pdcd.bench import checks, config
from pdcd.bench.placed import make_camera_map, map_plane_to_field, panels_of
from pdcd.bench.tables import Config
from pdcd.capture.rig import Rig
from pdcd.cli.main import main
from pdcd.errors import ConfigError
from pdcd.panels.atoms import ATOMS_PER_CELL, find_atoms
from pdcd.panels.map import Map
from pdcd.panels.map_file import save_maps
from pdcd.panels.placing import Placing, project_points

MASK = Map.filling((1600, 1200)).then([[0.9, 0.02, 0.03], [0.01, -0.95, 0.98], [0.0, 0.01, 1.0]])


def write(folder: Path, text: str) -> Path:
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


def with_mask(place: Placing) -> Config:
    base = Config()
    return msgspec.structs.replace(base, mask=msgspec.structs.replace(base.mask, place=place))


def test_a_file_of_maps_is_found_beside_the_configuration(tmp_path: Path) -> None:
    camera = Map.filling((32, 20)).then(np.diag([0.5, 0.7, 1.0]))
    (tmp_path / "etc").mkdir()
    save_maps(tmp_path / "etc" / "maps.npz", {"mask": MASK, "camera": camera})
    text = "[mask.place]\nmap = 'maps.npz'\n[camera.place]\nmap = 'maps.npz'\n"
    found = config.load_config(write(tmp_path / "etc", text))
    assert panels_of(found).mask.map == MASK
    assert make_camera_map(found, (20, 32)) == camera
    with pytest.raises(ConfigError, match="camera of 32 x 20 pixels, this one has 33 x 20"):
        make_camera_map(found, (20, 33))
    # What was read stays, whatever becomes of the file, and goes with the configuration.
    (tmp_path / "etc" / "maps.npz").unlink()
    assert panels_of(found).mask.map == MASK
    again = config.load_config(write(tmp_path, config.format_config(found)))
    assert again == found


def test_a_file_may_be_named_in_python(tmp_path: Path) -> None:
    path = str(tmp_path / "maps.npz")
    save_maps(Path(path), {"mask": MASK, "camera": Map.filling((2136, 1424))})
    assert panels_of(with_mask(Placing(map=path))).mask.map == MASK
    camera = msgspec.structs.replace(Config().camera, place=Placing(map=path))
    assert checks.check_config(msgspec.structs.replace(Config(), camera=camera)) == []


@pytest.mark.parametrize(
    ("text", "starts", "says"),
    [
        ("[mask.place]\nmap = 'text.npz'", "mask.place.map: ", "damaged"),
        ("[projector.place]\nmap = 'maps.npz'", "projector.place.map: ", "but of mask"),
        ("[mask.place]\nmap = 'maps.npz'\nturn_deg = 3", "mask.place: ", "so does turn_deg"),
        ("[mask]\nsize_px = [800, 600]\nplace.map = 'maps.npz'", "mask.place: ", "1600 x 1200"),
        ("[mask.place]\nradial = [-0.9, 0.0]", "mask.place: ", "folds"),
        ("[mask.place]\nhomography = [1, 2, 0, 2, 4, 0, 0, 0, 1]", "mask.place: ", "singular"),
        (
            "[mask.place]\nflip = 'vertical'\nhomography = [1, 0, 0, 0, 1, 0, 0, 0, 1]",
            "mask.place: ",
            "homography says .* so does flip",
        ),
        (
            "[mask.place]\nhomography = [nan, 0, 0, 0, 1, 0, 0, 0, 1]",
            "mask.place.homography[0]: ",
            "finite",
        ),
        ("[mask.place]\noffset_px = [2000.0, 0.0]", "mask.place: ", "beside the field"),
        ("[projector.place]\nscale = 0.25", "projector.place: ", "6.2% of the field only; 25%"),
        ("[camera.place]\noffset_px = [0.0, 900.0]", "camera.place: ", "beside the field"),
        ("[mask.place.map]\nsize_px = [4, 4]", "mask.place.map: ", "homography"),
    ],
)
def test_a_place_that_cannot_be_is_one_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, starts: str, says: str
) -> None:
    save_maps(tmp_path / "maps.npz", {"mask": MASK})
    (tmp_path / "text.npz").write_text(
        "no archive at all, however long it may be", encoding="utf-8"
    )
    path = write(tmp_path, text)
    with pytest.raises(ConfigError, match=says) as caught:
        config.load_config(path)
    first, *lines = caught.value.message.splitlines()
    assert first.startswith("1 fault in")
    assert len(lines) == 1
    assert lines[0].strip().startswith(starts)
    assert main(["config", "check", "--config", str(path)]) != 0
    assert lines[0].strip() in capsys.readouterr().err


KEYSTONE = "[0.0125, 0.012, 0, 0, 0.028, 0, 0, 0.0113, 1]"
"""Of 80 x 60 pixels: the upper edge fills the field's, the lower one is squeezed to half of it."""


SMALL = "[mask]\nsize_px = [80, 60]\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f"{SMALL}place.scale = 2.0", "0.625 pixels a cell on the mask; 1 are needed"),
        (f"{SMALL}place.homography = {KEYSTONE}", "pixels a cell on the mask; 1 are needed"),
        (
            "[schedule]\nwindow = 'quarter'\n[projector.place]\nscale = 4.5",
            "3.56 pixels a cell on the projector; 4 are needed by the quarter window",
        ),
    ],
)
def test_cells_smaller_than_the_pixels_of_a_placed_panel_are_one_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, says: str
) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        config.load_config(path)
    first, line = caught.value.message.splitlines()
    assert first.startswith("1 fault in")
    assert line.strip().startswith("scene.grid: ") and says in line
    assert main(["config", "check", "--config", str(path)]) != 0
    assert line.strip() in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("scale = 1.0", ""),
        ("scale = 1.05\nturn_deg = 2.0", ""),
        ("scale = 0.99", "about 2% of the field has no pixel of the mask"),
        ("turn_deg = 0.2", "less than 1% of the field has no pixel of the mask"),
        ("scale = 0.95", "220 of 48 x 64 cells have no pixel on the mask"),
        ("offset_px = [0.0, 20.0]", "64 of 48 x 64 cells have no pixel on the mask"),
    ],
)
def test_a_panel_that_leaves_part_of_the_field_dark_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, says: str
) -> None:
    path = write(tmp_path, f"[mask.place]\n{text}")
    config.load_config(path)  # the display refuses what it cannot show
    assert (main(["config", "check", "--config", str(path)]) == 0) == (not says)
    told = capsys.readouterr().err.splitlines()[1:]
    assert [line.strip().startswith(f"mask.place: {says}") for line in told] == [True] * bool(says)


def test_no_rig_is_made_with_a_place_that_cannot_be() -> None:
    wrong = with_mask(Placing(offset_px=(5000.0, 0.0)))
    assert [line for line in checks.check_config(wrong) if line.startswith("mask.place: ")]
    with pytest.raises(ConfigError, match="beside the field"):
        Rig(wrong)
    with pytest.raises(ConfigError, match="finite"):
        Rig(with_mask(Placing(turn_deg=math.nan)))


FIELD = (100, 60, 800, 600)


def on_a_part(**tables: Placing) -> Config:
    """The field a part of the projector's picture of 1024 x 768, devices where they are said."""
    found = Config()
    for name, place in tables.items():
        table = msgspec.structs.replace(getattr(found, name), place=place)
        found = msgspec.structs.replace(found, **{name: table})
    projector = msgspec.structs.replace(found.projector, field_px=FIELD)
    return msgspec.structs.replace(found, projector=projector)


def test_all_maps_lead_to_the_part_of_the_picture_that_is_the_field() -> None:
    left, top, wide, high = FIELD
    made = on_a_part(mask=Placing(map=MASK), camera=Placing(turn_deg=3.0))
    whole = msgspec.structs.replace(
        made, projector=msgspec.structs.replace(made.projector, field_px=None)
    )
    points = np.random.default_rng(1).random((40, 2))
    picture = points * (wide, high) + (left, top)  # the same places in projector pixels
    parts, wholes = panels_of(made), panels_of(whole)
    assert parts.projector.map.from_field(points) == pytest.approx(picture)
    for one, other in (
        (parts.mask.map, wholes.mask.map),
        (make_camera_map(made, (20, 32)), make_camera_map(whole, (20, 32))),
    ):
        assert one.from_field(points) == pytest.approx(other.from_field(picture / (1024, 768)))
    assert made.projector.field_size_px == (800, 600)
    assert whole.projector.field_box_px == (0, 0, 1024, 768)


def test_edges_of_the_projectors_pixels_stay_whole() -> None:
    """A field of 800 x 600 pixels in 30 x 40 cells has 20 pixels to a cell, from its left and upper
    edge on, and is black around."""
    found = find_atoms(panels_of(on_a_part()).projector, (30, 40)) // ATOMS_PER_CELL
    left, top, wide, high = FIELD
    x, y = np.arange(1024), np.arange(768)
    inside = ((x >= left) & (x < left + wide)) & ((y >= top) & (y < top + high))[:, None]
    assert ((found[..., 0] >= 0) == inside).all()
    wanted = np.broadcast_to((x - left) // 20, (768, 1024))
    assert (found[..., 0][inside] == wanted[inside]).all()
    assert (found[..., 1][inside] == ((y - top) // 20)[:, None].repeat(1024, 1)[inside]).all()


def test_a_plane_is_that_of_the_field() -> None:
    """Points of the field go where the picture's plane sends them."""
    projector = on_a_part().projector
    plane = (1.02, 0.01, 0.03, -0.02, 0.98, 0.01, 0.05, -0.02, 1.0)
    assert map_plane_to_field(plane, Config().projector) == plane
    points = np.random.default_rng(2).random((20, 2))
    size, (left, top, wide, high) = np.array([1024, 768]), FIELD
    picture = (points * (wide, high) + (left, top)) / size
    wanted = (project_points(plane, picture) * size - (left, top)) / (wide, high)
    assert project_points(map_plane_to_field(plane, projector), points) == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("table", "field_px", "words"),
    [
        ("projector", (0, 0, 1025, 768), "no part of the projector's 1024 x 768"),
        ("projector", (0, 400, 900, 400), "900 x 400 pixels at (0, 400) are no part of"),
        ("mask", (0, 0, 10, 10), "set projector.field_px"),
    ],
)
def test_a_field_lies_in_the_projectors_picture(
    table: str, field_px: tuple[int, int, int, int], words: str
) -> None:
    plain = Config()
    changed = msgspec.structs.replace(getattr(plain, table), field_px=field_px)
    (found,) = checks.check_config(msgspec.structs.replace(plain, **{table: changed}))
    assert found.startswith(f"{table}.field_px: ") and words in found
