"""Which calibration is taken, and what of the configuration its values replace."""

from __future__ import annotations

import hashlib
import math
import tomllib
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.bench import measured
from pdcd.bench.calibration import RECORD, CalibrationFile
from pdcd.bench.choosing import describe_other_bench, find_newest_calibration
from pdcd.bench.config import format_config, from_config_tables
from pdcd.bench.measured import (
    apply_calibration,
    choose_calibration_folder,
    compute_age_days,
    with_values,
)
from pdcd.bench.tables import (
    CalibrationConfig,
    CameraConfig,
    Config,
    PanelConfig,
    RigConfig,
    ScheduleConfig,
    ServerConfig,
)
from pdcd.bench.truth import restore_typed_values
from pdcd.errors import ConfigError
from pdcd.panels.map import Map
from pdcd.panels.map_file import save_maps
from pdcd.panels.placing import Placing
from pdcd.words import GuardsName
from tests.unit.bench._calibrations import entry, of_rig, record, written


def config(**calibration: Any) -> Config:
    return Config(calibration=CalibrationConfig(**calibration))


def test_the_newest_whole_calibration_of_this_rig_is_taken(tmp_path: Path) -> None:
    written(tmp_path / "2026-01-01", record())
    good = written(tmp_path / "2026-01-02", record())
    bad = written(tmp_path / "2026-01-03", record(verdict="bad"))
    written(tmp_path / "2026-01-04", record(identity=of_rig("another")))
    written(tmp_path / "2026-01-05", record(belief={"camera": {"driver": "ptp"}}))
    (written(tmp_path / "2026-01-06", record()) / RECORD).write_text("{}")
    written(tmp_path / "2026-01-07.partial", record())
    (tmp_path / "2026-01-08").mkdir()
    (tmp_path / "2026-01-09").write_text("no folder")
    assert find_newest_calibration(tmp_path, Config()) == good
    assert find_newest_calibration(tmp_path, Config(), bad=True) == bad
    elsewhere = Config(rig=RigConfig(name="another"))
    assert find_newest_calibration(tmp_path, elsewhere) == tmp_path / "2026-01-04"
    assert find_newest_calibration(tmp_path, Config(rig=RigConfig(name="a third"))) is None


def test_a_calibration_is_chosen_by_word_or_by_path(tmp_path: Path) -> None:
    state = ServerConfig(state_dir=str(tmp_path))
    one = written(tmp_path / "calibrations" / "a", record())
    assert choose_calibration_folder(Config(server=state)) == one
    assert choose_calibration_folder(config(use="none")) is None
    assert choose_calibration_folder(config(use="/some/where")) == Path("/some/where")
    nothing = Config(server=state, calibration=CalibrationConfig(use="none"))
    assert apply_calibration(nothing) is nothing


def test_what_was_taken_is_named_so_that_taking_it_again_changes_nothing(tmp_path: Path) -> None:
    told = record(measured={"mask.skew_s": entry(0.002), "trigger.lag_s": entry(0.1)})
    folder = written(tmp_path / "cal", told)
    digest = hashlib.sha256((folder / RECORD).read_bytes()).hexdigest()
    asked = config(use=str(folder), keep=("trigger.lag_s",))
    found = apply_calibration(asked)
    assert (found.mask.skew_s, found.trigger.lag_s) == (0.002, Config().trigger.lag_s)
    assert (found.calibration.use, found.calibration.sha256) == (str(folder), digest)
    assert found.calibration.keep == ("trigger.lag_s",)
    assert apply_calibration(found) == found and restore_typed_values(found).mask == asked.mask
    with pytest.raises(ConfigError, match="not the one with the digest"):
        apply_calibration(config(use=str(folder), sha256="0" * 64))


@pytest.mark.parametrize(
    ("belief", "what"),
    [
        ({"projector": {"size_px": [1, 2]}}, "projector.size_px was (1, 2) and is (1024, 768)"),
        ({"mask": {"size_px": [1600, 1201]}}, "mask.size_px was (1600, 1201) and is (1600, 1200)"),
        ({"display": {"driver": "x11"}}, "display.driver was 'x11' and is 'mock'"),
        ({"camera": {"driver": "ptp"}}, "camera.driver was 'ptp' and is 'mock'"),
        ({"mask": {"size_px": 7}}, "mask.size_px was 7 and is (1600, 1200)"),
        ({"trigger": {"driver": "serial"}}, "trigger.driver was 'serial' and is 'mock'"),
    ],
)
def test_other_panels_or_drivers_are_another_bench(belief: dict[str, Any], what: str) -> None:
    told = record(belief=belief)
    assert describe_other_bench(told, Config()) == what


def test_the_same_bench_is_none_other(tmp_path: Path) -> None:
    belief = {
        "projector": {"size_px": [1024, 768]}, "mask": {"size_px": [1600, 1200]},
        "display": {"driver": "mock"}, "camera": {"driver": "mock"}, "trigger": {"driver": "mock"},
    }  # fmt: skip
    for told in (belief, {}, {"mask": {}, "camera": {"driver": None}}):
        assert describe_other_bench(record(belief=told), Config()) == ""
    folder = written(tmp_path / "cal", record(belief={"camera": {"driver": "ptp"}}))
    with pytest.raises(ConfigError, match="another bench"):
        apply_calibration(config(use=str(folder)))


def test_values_replace_those_of_their_keys_and_no_others() -> None:
    found = with_values(
        Config(), {"mask.skew_s": 0.25, "mask.offset_px": [1, 2.5], "camera.iso": 200}, {}
    )
    assert (found.mask.skew_s, found.mask.offset_px, found.camera.iso) == (0.25, (1.0, 2.5), 200)
    typed = Config(
        mask=PanelConfig(size_px=(1600, 1200), skew_s=0.25, offset_px=(1.0, 2.5)),
        camera=found.camera,
        calibration=found.calibration,
    )
    assert found == typed and with_values(Config(), {}, {}) == Config()


def test_what_was_typed_of_devices_is_kept_beside_what_was_measured(tmp_path: Path) -> None:
    """Settings are not: what a calibration chose there is what the program does from then on."""
    placed = PanelConfig(size_px=(1600, 1200), place=Placing(turn_deg=3.0), contrast=None)
    typed = Config(mask=placed, camera=CameraConfig(responsivity_e=(1.0, 2.0, 3.0)))
    maps = {"mask": Map.filling((1600, 1200))}
    measured_ = {"camera.responsivity_e": (4.0, 5.0, 6.0), "mask.contrast": 300.0}
    settings = {"rig.settle_s": 0.2, "display.mask_delay_refreshes": -2}
    once = with_values(typed, measured_ | settings, maps)
    again = with_values(once, {"mask.contrast": 400.0, "trigger.lag_s": 0.1}, maps)
    back = msgspec.convert(msgspec.json.decode(msgspec.json.encode(again)), Config)
    assert (
        back == again and from_config_tables(tomllib.loads(format_config(again)), "again") == again
    )
    found = restore_typed_values(back)
    assert (found.mask, found.camera, found.trigger) == (placed, typed.camera, typed.trigger)
    assert (found.rig.settle_s, found.display.mask_delay_refreshes) == (0.2, -2)
    wrong = msgspec.structs.replace(typed.calibration, typed={"mask.contrast": "bright"})
    with pytest.raises(ConfigError, match=r"calibration\.typed"):
        restore_typed_values(msgspec.structs.replace(typed, calibration=wrong))


@pytest.mark.parametrize(
    "values", [{"mask.skew": 1.0}, {"masc.skew_s": 1.0}, {"mask.skew_s": "late"}]
)
def test_a_value_that_the_configuration_cannot_have_is_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="a measured value has no place in the configuration"):
        with_values(Config(), values, {})


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("mask.skew_s", "nan", "must be a finite number"),
        ("trigger.lag_s", 1e300, "more than 60 seconds"),
        ("mask.lut", [0.0, 0.9, 0.1, 1.0], "light must rise"),
        ("projector.field_px", [1000, 700, 1024, 768], "are no part of the projector's"),
        ("limits.min_free_bytes", 0, "limits.min_free_bytes is no value"),
        ("server.allow_uids", [1], "server.allow_uids is no value"),
    ],
)
def test_a_calibration_may_have_no_value_that_a_configuration_may_not_have(
    tmp_path: Path, key: str, value: Any, says: str
) -> None:
    folder = written(tmp_path / "cal", record(measured={key: entry(value)}))
    with pytest.raises(ConfigError, match=says):
        apply_calibration(config(use=str(folder)))


@pytest.mark.parametrize(
    ("key", "name"), [("mask.place.map", "maps.npz"), ("camera.profile", "sensor.toml")]
)
def test_files_of_a_calibration_that_changed_since_are_not_used(
    tmp_path: Path, key: str, name: str
) -> None:
    save_maps(tmp_path / "maps.npz", {"mask": Map.filling((1600, 1200))})
    (tmp_path / "sensor.toml").write_text("")
    data = (tmp_path / name).read_bytes()
    vouched = CalibrationFile(sha256=hashlib.sha256(data).hexdigest(), size_bytes=len(data))
    told = record(measured={key: entry(name)}, files={name: vouched})
    folder = written(tmp_path / "cal", told)
    for spoilt in (data + b" ", None):
        if spoilt is not None:
            (folder / name).write_bytes(spoilt)
        else:
            (folder / name).unlink()
        with pytest.raises(ConfigError, match=rf"not as it was written: {name}"):
            apply_calibration(config(use=str(folder)))
    (folder / name).write_bytes(data)
    assert apply_calibration(config(use=str(folder))) != config(use=str(folder))


def test_a_measured_map_that_its_file_lacks_leaves_no_typed_place_in_use(tmp_path: Path) -> None:
    told = record(measured={"mask.place.map": entry("maps.npz")})
    folder = written(tmp_path / "cal", told)
    save_maps(folder / "maps.npz", {"camera": Map.filling((100, 80))})
    with pytest.raises(ConfigError, match="no map of the mask"):
        apply_calibration(config(use=str(folder)))


def test_a_profile_lies_in_the_folder_of_its_calibration(tmp_path: Path) -> None:
    def profile(value: str, folder: Path | None) -> str:
        return with_values(Config(), {"camera.profile": value}, {}, folder=folder).camera.profile

    assert profile("sensor.toml", tmp_path) == str(tmp_path / "sensor.toml")
    assert profile("/a/sensor.toml", tmp_path) == "/a/sensor.toml"
    assert profile("modern", None) == "modern"


def test_maps_replace_the_places_that_were_measured(tmp_path: Path) -> None:
    map_ = Map.filling((1024, 768))
    maps = {"projector": map_, "mask": Map.filling((1600, 1200)), "other": map_}
    found = with_values(Config(), {"projector.place.map": "maps.npz"}, maps, folder=tmp_path)
    assert found.projector.place.map is map_ and found.mask.place == Config().mask.place
    assert found.projector.size_px == (1024, 768)
    both = with_values(Config(), {}, maps)
    assert both.projector.place.map is map_ and both.mask.place.map is maps["mask"]


def test_the_age_of_a_calibration_counts_from_its_end() -> None:
    ended = datetime.now(UTC) - timedelta(days=2.5)
    assert compute_age_days(record(finished_utc=ended.isoformat())) == pytest.approx(2.5, abs=0.01)
    assert math.isnan(compute_age_days(record(finished_utc="some day")))


def test_measured_times_make_the_schedule_go_by_the_lag() -> None:
    assert measured.with_guards(Config(), measured.TIME_KEYS).schedule.guards == "auto"
    assert measured.with_guards(Config(), measured.TIME_KEYS[1:]).schedule.guards is True
    assert measured.with_guards(Config(), ()) == Config()


@pytest.mark.parametrize("guards", [False, "full", "both", "auto"])
def test_what_was_typed_otherwise_stays(guards: bool | GuardsName) -> None:
    typed = Config(schedule=ScheduleConfig(guards=guards))
    assert measured.with_guards(typed, measured.TIME_KEYS) == typed


def test_guards_may_be_kept() -> None:
    config = Config(calibration=CalibrationConfig(keep=("schedule.guards",)))
    assert measured.with_guards(config, measured.TIME_KEYS) == config
