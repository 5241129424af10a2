"""docs/calibration.md holds what it says of maps: its picture is theirs, its examples are read.
docs/safety.md says how often the light of each schedule changes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pdcd.bench import config
from pdcd.bench.placed import make_camera_map, panels_of
from pdcd.panels.map import Map
from pdcd.panels.map_file import save_maps
from pdcd.panels.schedule import SLOTS
from tests.bench.field_picture import picture

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "calibration.md").read_text(encoding="utf-8")
FIELD = PAGE.partition("## The field, and maps to it")[2]
EXAMPLES = re.findall(r"(?:^    (?!from |save).*\n)+", FIELD, re.MULTILINE)


def test_the_picture_is_that_of_the_maps() -> None:
    assert (DOCS / "field.svg").read_text(encoding="utf-8") == picture()


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_is_read(tmp_path: Path, example: str) -> None:
    save_maps(tmp_path / "maps.npz", {"mask": Map.filling((1600, 1200))})
    path = tmp_path / "rig.toml"
    path.write_text(example, encoding="utf-8")
    found = config.load_config(path)
    panels_of(found)
    make_camera_map(found, (200, 300))


def test_the_keystone_is_the_one_that_is_told(tmp_path: Path) -> None:
    (example,) = (text for text in EXAMPLES if "homography" in text)
    path = tmp_path / "rig.toml"
    path.write_text(example, encoding="utf-8")
    map_ = panels_of(config.load_config(path)).mask.map
    left, right = map_.to_field([[0, 1200], [1600, 1200]])
    assert right - left == pytest.approx([0.9, 0.0])
    assert map_.to_field([1600, 0]) == pytest.approx([1.0, 0.0])


def test_the_flicker_of_every_schedule_is_that_of_its_refreshes() -> None:
    page = (DOCS / "safety.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?) \| (\d+) \| ([\d.]+) Hz \| (.*?) \|$", page, re.MULTILINE)
    told = {name: row[1:] for row in rows for name in re.findall(r"`(\w+)`", row[0])}
    told.pop("auto", None)
    assert told.keys() == SLOTS.keys()
    for name, (lit, _) in SLOTS.items():
        codes, alternations, picture = told[name]
        assert int(codes) == 60 / len(lit)
        # Between codes a projector that stays lit goes bright and dark over two of them at most.
        assert float(alternations) == int(codes) * (0.5 if all(lit) else 1)
        flashes = re.findall(r"flashes (\d+) times a second", picture)
        assert flashes == ([] if all(lit) else [codes])
