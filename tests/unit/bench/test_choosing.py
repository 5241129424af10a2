"""Which of the calibrations that are kept is used, and what is said of those that are not."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from pdcd.bench.calibration import (
    CALIBRATION_DIGEST,
    MAX_RECORD_BYTES,
    RECORD,
    STEP_FOLDER_PREFIX,
    CalibrationStop,
    StepRecord,
    format_digest_line,
)
from pdcd.bench.choosing import (
    CALIBRATIONS_FOLDER,
    PINNED,
    describe_other_bench,
    find_calibration,
    find_other_device,
    forget_calibration,
    hash_truth_file,
    list_candidates,
    lock_calibration,
    pin_calibration,
    read_pinned_name,
    select_mock_tables,
)
from pdcd.bench.measured import apply_calibration, choose_calibration
from pdcd.bench.tables import (
    BenchConfig,
    CalibrationConfig,
    CameraConfig,
    Config,
    RigConfig,
    SceneConfig,
    ScheduleConfig,
    ServerConfig,
)
from pdcd.cli.main import main
from pdcd.errors import BusyError, ConfigError
from tests.unit.bench._calibrations import entry, of_rig, record, written


def bench(state: Path, **tables: Any) -> Config:
    return Config(server=ServerConfig(state_dir=str(state)), **tables)


def kept_in(at: Path, name: str, **changed: Any) -> Path:
    seen = {"identity": msgspec.structs.replace(record().identity, frame_quads=None)}
    return written(
        at / CALIBRATIONS_FOLDER / name, record(**{"name": name.split("/")[0], **seen, **changed})
    )


def step(name: str, verdict: Any = "good") -> StepRecord:
    return StepRecord(
        name=name, made_utc="2026-01-01T11:00:00Z", seconds=1.0, verdict=verdict, figures=(),
        advice=(), photos=(), settings={},
    )  # fmt: skip


def test_latest_passes_over_what_cannot_be_used_and_says_why(tmp_path: Path) -> None:
    good = kept_in(tmp_path, "a1", measured={"mask.skew_s": entry(0.002)})
    kept_in(tmp_path, "a2", identity=of_rig("another"))  # of no concern to this one
    kept_in(tmp_path, "a3", belief={"mask": {"size_px": [8, 6]}})
    kept_in(tmp_path, "a4", verdict="bad")
    (kept_in(tmp_path, "a5") / RECORD).write_text("{}")
    kept_in(tmp_path, "a6", measured={"mask.place.map": entry("maps.npz")})  # which is not there
    kept_in(tmp_path, "a7", measured={"mask.warp": entry(1.0)})
    found = choose_calibration(bench(tmp_path))
    assert found.folder == good and found.config.mask.skew_s == 0.002
    names = [text.partition(":")[0] for text in found.passed]
    assert names == ["a7", "a6", "a5", "a4", "a3"]
    assert found.words.startswith("a1 is used; calibration a7: ") and "and 4 more" in found.words
    assert "\n" not in found.words and "mask.size_px was (8, 6)" in found.passed[-1]
    other = choose_calibration(bench(tmp_path, rig=RigConfig(name="another")))
    assert [text.partition(":")[0] for text in other.passed] == ["a5"]  # which may be anybody's


def test_one_that_was_named_and_does_not_fit_is_an_error(tmp_path: Path) -> None:
    kept_in(tmp_path, "a1", belief={"camera": {"driver": "ptp"}})
    config = bench(tmp_path)
    assert choose_calibration(config).folder is None
    pin_calibration(config, "a1")
    with pytest.raises(ConfigError, match=r"another bench: camera\.driver") as told:
        apply_calibration(config)
    assert "pdcd calibrate use latest" in str(told.value.hint)
    pin_calibration(config, "a0")
    with pytest.raises(ConfigError, match="no calibration is called 'a0'"):
        apply_calibration(config)
    pin_calibration(config, None)
    assert apply_calibration(config) == config


def test_what_was_named_is_used_in_the_place_of_the_latest(tmp_path: Path) -> None:
    for name, value in (("a1", 0.001), ("a2", 0.002)):
        kept_in(tmp_path, name, measured={"mask.skew_s": entry(value)})
    config = bench(tmp_path)
    assert apply_calibration(config).mask.skew_s == 0.002
    pin_calibration(config, "a1")
    assert read_pinned_name(config) == "a1" and apply_calibration(config).mask.skew_s == 0.001
    # What the configuration itself says goes first; other rigs have their own.
    typed = msgspec.structs.replace(config, calibration=CalibrationConfig(use="none"))
    assert apply_calibration(typed) is typed
    assert read_pinned_name(bench(tmp_path, rig=RigConfig(name="another"))) is None
    pin_calibration(config, "none")
    assert apply_calibration(config) is config
    pin_calibration(config, None)
    assert apply_calibration(config).mask.skew_s == 0.002


def test_a_mock_bench_that_was_moved_goes_by_one_that_was_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = bench(tmp_path)
    folder = kept_in(
        tmp_path, "a1", bench=select_mock_tables(config), measured={"mask.skew_s": entry(0.002)}
    )
    truth = tmp_path / "truth.toml"
    truth.write_text("[mask.place]\nturn_deg = 0.1\n")
    moved = bench(tmp_path, bench=BenchConfig(truth=str(truth)))
    assert choose_calibration(config).folder == folder
    assert (
        choose_calibration(moved).folder is None and "truth" in choose_calibration(moved).passed[0]
    )
    by_path = msgspec.structs.replace(moved, calibration=CalibrationConfig(use=str(folder)))
    assert apply_calibration(by_path).mask.skew_s == 0.002
    config_file = tmp_path / "bench.toml"
    config_file.write_text(f'[bench]\ntruth = "{truth}"\n[server]\nstate_dir = "{tmp_path}"\n')
    assert main(["calibrate", "use", "a1", "--config", str(config_file)]) == 0
    assert "in use:" in capsys.readouterr().out
    assert choose_calibration(moved).folder == folder


def test_a_file_of_names_that_is_none_is_refused_and_mended(tmp_path: Path) -> None:
    kept_in(tmp_path, "a1")
    path, config = tmp_path / CALIBRATIONS_FOLDER / PINNED, bench(tmp_path)
    for wrong in (b"[1]", b"{", b"[" * 10**5, b" " * 2**21):
        path.write_bytes(wrong)
        with pytest.raises(ConfigError, match="cannot be read"):
            apply_calibration(config)
        pin_calibration(config, None)
        assert choose_calibration(config).folder is not None
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(ConfigError, match="cannot be read"):
        apply_calibration(config)


def test_of_a_mock_bench_only_its_scene_and_its_schedule_may_change(tmp_path: Path) -> None:
    truth = tmp_path / "truth.toml"
    truth.write_text("[mask]\nskew_s = 0.001\n")
    config = bench(tmp_path, bench=BenchConfig(truth=str(truth)))
    seen = msgspec.structs.replace(
        record().identity, frame_quads=None, truth=hash_truth_file(config)
    )
    told = record(identity=seen, bench=select_mock_tables(config))
    assert describe_other_bench(told, config) == ""
    free = msgspec.structs.replace(
        config, scene=SceneConfig(kind="wax-disk"), schedule=ScheduleConfig(window="whole")
    )
    assert describe_other_bench(told, free) == ""
    changed = msgspec.structs.replace(config, camera=CameraConfig(noise="none", iso=200))
    assert describe_other_bench(told, changed) == "camera.iso was unset and is 200"
    truth.write_text("[mask]\nskew_s = 0.002\n")
    assert "truth" in describe_other_bench(told, config)
    # A bench that was bumped, to whoever names its calibration.
    assert (
        describe_other_bench(told, config, named=True)
        == describe_other_bench(told, changed, named=True)
        == ""
    )
    # Once it was taken, measured values stand in the configuration.
    table = CalibrationConfig(use="x", sha256="0" * 64)
    assert describe_other_bench(told, msgspec.structs.replace(changed, calibration=table)) == ""


def test_a_mock_bench_of_another_frame_is_another_one() -> None:
    """The map of its camera would fit no photo."""
    seen = msgspec.structs.replace(record().identity, frame_quads=(400, 267))
    assert describe_other_bench(record(identity=seen), Config()) == (
        "its camera has 400 x 267 pixels, and this one 64 x 48"
    )
    assert "400 x 267" in describe_other_bench(record(identity=seen), Config(), named=True)
    fits = Config(camera=CameraConfig(frame_quads=(400, 267)))
    assert describe_other_bench(record(identity=seen), fits) == ""


def test_devices_that_are_open_may_be_others(tmp_path: Path) -> None:
    """A real camera tells its name only then: nobody named the calibration, so that it is passed
    over for one that fits."""
    old = kept_in(tmp_path, "a1")
    kept_in(tmp_path, "a2", identity=msgspec.structs.replace(record().identity, camera_serial="t"))
    camera: Any = SimpleNamespace(model="m", serial="s", frame_quads=None)
    found = choose_calibration(bench(tmp_path), camera)
    assert found.folder == old and found.passed == (
        "a2: calibration a2 is of m t, and this is m s",
    )
    camera.frame_quads = (300, 200)
    seen = msgspec.structs.replace(record().identity, frame_quads=(600, 400))
    other = find_other_device(record(identity=seen), camera, None)
    assert other == ("camera", "calibration cal is of photos of 600 x 400 pixels, not 300 x 200")


def test_rates_by_modes_count_for_more_than_measured_ones() -> None:
    """A measured rate scatters by more than modes differ, where times are not those of a screen."""
    fast: Any = SimpleNamespace(refresh_hz=60.1, identity={})
    other = find_other_device(record(), None, fast)
    assert other is not None and "panels run at 60.1 Hz" in other[1]
    fast.identity = {"projector": "A: 60.0000 Hz", "mask": "B: 60.0000 Hz"}
    seen = msgspec.structs.replace(record().identity, **fast.identity)
    assert find_other_device(record(identity=seen), None, fast) is None
    fast.identity["mask"] = "B: 59.9400 Hz"
    other = find_other_device(record(identity=seen), None, fast)
    assert other is not None and other[0] == "mask"


def test_hostile_folders_are_passed_over_and_nothing_is_waited_for(tmp_path: Path) -> None:
    good = kept_in(tmp_path, "a0", measured={"mask.skew_s": entry(0.002)})
    folder = tmp_path / CALIBRATIONS_FOLDER
    (folder / "b1").symlink_to(folder / "b1")
    kept_in(tmp_path, "c9").rename(folder / ".c9.forgotten")  # whose removal was cut short
    (folder / "b2").symlink_to(folder / "gone")
    os.mkfifo(folder / "b3")
    (folder / "b4").write_text("a file")
    os.mkfifo(kept_in(tmp_path, "b5") / "x")  # which nobody reads
    for name, file in (("b6", RECORD), ("b7", CALIBRATION_DIGEST)):
        path = kept_in(tmp_path, name) / file
        path.unlink()
        os.mkfifo(path)
    (kept_in(tmp_path, "b8") / RECORD).write_bytes(b" " * (MAX_RECORD_BYTES + 1))
    deep = kept_in(tmp_path, "b9")
    data = b'{"measured":' + b"[" * 10**5
    (deep / RECORD).write_bytes(data)
    (deep / CALIBRATION_DIGEST).write_bytes(format_digest_line(data))
    os.mkfifo(kept_in(tmp_path, "c1", measured={"mask.place.map": entry("maps.npz")}) / "maps.npz")
    half = kept_in(tmp_path, "c2") / RECORD
    half.write_bytes(half.read_bytes()[:-100])
    (kept_in(tmp_path, "c3") / CALIBRATION_DIGEST).unlink()
    found = choose_calibration(bench(tmp_path))
    assert found.folder == tmp_path / CALIBRATIONS_FOLDER / "b5"
    assert [text.partition(":")[0] for text in found.passed] == [
        "c3",
        "c2",
        "c1",
        "b9",
        "b8",
        "b7",
        "b6",
    ]
    forget_calibration(bench(tmp_path), tmp_path / CALIBRATIONS_FOLDER / "b5")
    found = choose_calibration(bench(tmp_path))
    assert found.folder == good and {"b1", "b2"} <= {t.partition(":")[0] for t in found.passed}


def test_what_is_bad_of_a_calibration_does_not_spoil_the_rest(tmp_path: Path) -> None:
    one = kept_in(
        tmp_path, "a1", verdict="bad", state="done", left_out={"timing": "bad"},
        steps=(step("meter"), step("geometry"), step("timing", "bad")),
    )  # fmt: skip
    kept_in(
        tmp_path, "a2", verdict="bad", state="done", left_out={"check": "bad"},
        steps=(step("meter"), step("check", "bad")),
    )  # fmt: skip
    found = choose_calibration(bench(tmp_path))
    assert found.folder == one and found.passed == ("a2: its verdict is bad",)


def test_what_a_killed_one_had_kept_is_used_but_not_while_it_is_made(tmp_path: Path) -> None:
    steps = (step("meter"), step("geometry"))
    stopped = CalibrationStop(step="timing", kind="calibration", message="too bright")
    kept_in(tmp_path, "a0", state="failed", steps=steps, stopped=stopped)
    for number in (1, 2):
        kept_in(tmp_path, f"a1.partial/{STEP_FOLDER_PREFIX}0{number}", state="running", steps=steps)
    (
        tmp_path / CALIBRATIONS_FOLDER / f"a1.partial/{STEP_FOLDER_PREFIX}03.new"
    ).mkdir()  # cut short in the middle of this
    (tmp_path / CALIBRATIONS_FOLDER / "a2.partial" / "raw").mkdir(parents=True)
    config, at = bench(tmp_path), tmp_path / CALIBRATIONS_FOLDER / "a1.partial"
    assert choose_calibration(config).folder == at / f"{STEP_FOLDER_PREFIX}02"
    assert [one.name for one in list_candidates(config)] == ["a1", "a0"]
    assert find_calibration(config, "a1") == at
    maker = os.open(at, os.O_RDONLY)
    fcntl.flock(maker, fcntl.LOCK_EX)
    try:
        assert choose_calibration(config).folder == tmp_path / CALIBRATIONS_FOLDER / "a0"
        with pytest.raises(BusyError):
            forget_calibration(config, at)
    finally:
        os.close(maker)
    forget_calibration(config, at)
    assert (
        not at.exists()
        and choose_calibration(config).folder == tmp_path / CALIBRATIONS_FOLDER / "a0"
    )


def test_one_is_forgotten_unless_it_is_in_use_and_never_what_a_link_leads_to(
    tmp_path: Path,
) -> None:
    config = bench(tmp_path)
    one, elsewhere = kept_in(tmp_path, "a1"), written(tmp_path / "out" / "a2", record())
    (one / "outside").symlink_to(elsewhere)
    (tmp_path / CALIBRATIONS_FOLDER / "a2").symlink_to(elsewhere)
    pin_calibration(config, "a1")
    used = lock_calibration(one)
    with pytest.raises(BusyError, match="in use"):
        forget_calibration(config, one)
    assert used is not None
    os.close(used)
    forget_calibration(config, one)
    assert not one.exists() and read_pinned_name(config) is None and (elsewhere / RECORD).exists()
    forget_calibration(config, find_calibration(config, "a2"))
    assert (elsewhere / RECORD).exists() and not (
        tmp_path / CALIBRATIONS_FOLDER / "a2"
    ).is_symlink()
    written(tmp_path / CALIBRATIONS_FOLDER / "a" / "b", record())
    for wrong in ("..", "a/b", "", ".a1.forgotten", PINNED):
        with pytest.raises(ConfigError, match="no calibration is called"):
            find_calibration(config, wrong)
