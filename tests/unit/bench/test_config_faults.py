"""What a configuration file may get wrong: every fault by its key, and all of them at once."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.bench import checks, config
from pdcd.bench.reading import format_toml
from pdcd.bench.tables import Config
from pdcd.cli.main import main
from pdcd.errors import ConfigError
from tests.hostile import files

plain_text = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
values: st.SearchStrategy[Any] = (
    st.booleans() | st.integers() | st.floats() | plain_text | st.dates() | st.lists(st.integers())
)


def write(folder: Path, text: str) -> Path:
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


def fault_lines(path: Path) -> list[str]:
    """The faults that loading reports, without the line that counts them."""
    with pytest.raises(ConfigError) as caught:
        config.load_config(path)
    first, *lines = caught.value.message.splitlines()
    count = len(lines)
    assert first == f"{count} fault{'s' if count > 1 else ''} in {path}:"
    return [line.strip() for line in lines]


@pytest.mark.parametrize(
    ("text", "starts", "says"),
    [
        ("foo = 1", "foo: ", "no such key"),
        ("[camrea]", "camrea: ", "is camera meant"),
        ("rig = 3", "rig: ", "must be a table"),
        ("[display.faults]\nlat = {}", "display.faults.lat: ", "is late meant"),
        ("[camera]\nfetch_timeout_s = '3'", "camera.fetch_timeout_s: ", "expected float, got str"),
        ("[camera]\nfetch_timeout_s = 1e30", "camera.fetch_timeout_s: ", "more than 3600 seconds"),
        ("[schedule]\ncodes = 0", "schedule.codes: ", ">= 1"),
        ("[schedule]\ncodes = 8.5", "schedule.codes: ", "expected int"),
        ("[schedule]\nfamily = 'x'", "schedule.family: ", "bernoulli, rademacher, balanced"),
        ("[camera]\nf_number = 'f8'", "camera.f_number: ", "auto, a number"),
        ("[projector]\nsize_px = [1024, 0]", "projector.size_px[1]: ", ">= 1"),
        ("[display.faults]\nlate = {4 = 'x'}", "display.faults.late: ", "expected int"),
        ("[display.faults]\nlate = {'\u00b2' = 1}", "display.faults.late: ", "counted"),
        *[(f"[display.faults]\n{name} = [-1]", f"display.faults.{name}: ", "counted 0, 1, 2")
          for name in ("dropped", "stale_mask", "stale_projector")],
        ("[mask]\noffset_px = [0, -inf]", "mask.offset_px[1]: ", "finite"),
        ("[scene.options]\na = [{b = nan}]", "scene.options.a[0].b: ", "finite"),
        ("[camera]\nseed = 9007199254740992", "camera.seed: ", "2**53"),
        ("[projector]\nrefresh_hz = 75\n[display]\ndriver = 'x11'", "mask.refresh_hz: ",
         "one rate"),
        ("[mask]\ncontrast = 1.0", "mask.contrast: ", "exceeds 1"),
        ("[rig]\nplane = [1, 0, 0, 0, 1, 0, 0, 0, 1]", "rig.plane: ", "off-axis"),
        ("[projector]\noffset_px = [1, 0]", "projector.offset_px: ", "mask.offset_px"),
        ("[projector]\nblur_px = 0.6", "projector.blur_px: ", "is the light on the mask"),
        ("[scene]\nkind = 'matrix'\npath = 3", "scene.path: ", "expected str | null, got int"),
        ("[scene]\npath = 'rig.toml'", "scene.path: ", "belongs to"),
        ("[scene]\nkind = 'matrix'\npath = '/dev/zero'", "scene.path: ", "is no regular file"),
        ("[scene]\ngrid = [48, 2000]", "scene.grid: ", "on the projector"),
        ("[camera]\niso = 0", "camera.iso: ", "at least 1"),
        ("[rig]\nsettle_s = 300", "rig.settle_s: ", "max_exposure_s"),
        ("[server]\nallow_uids = [-1]", "server.allow_uids: ", "not negative"),
        *[(f"[server.{role}]\n{who} = [7, -1]", f"server.{role}.{who}: ", "not negative")
          for role in ("look", "shoot", "administer") for who in ("uids", "groups")],
        ("[server.shoot]\ngroups = [1.5]", "server.shoot.groups", "int"),
        ("[server.shout]\nuids = []", "server.shout", ""),
        ("[limits]\nidle_s = 0", "limits.idle_s", ""),
    ],
)  # fmt: skip
def test_fault_is_named_by_its_key(tmp_path: Path, text: str, starts: str, says: str) -> None:
    line, *more = fault_lines(write(tmp_path, text))
    assert line.startswith(starts)
    assert says in line
    # A grid too fine for the projector may be too fine for the mask as well, nothing else doubles.
    assert all(other.startswith("scene.grid: ") for other in more)


def test_all_faults_are_reported_at_once(tmp_path: Path) -> None:
    text = """
        colour = "red"
        [rig]
        on_miss = "panic"
        settle_s = -1
        [projector]
        refresh_hz = 75
        [mask]
        skew_s = nan
        [camera]
        iso = "high"
        nois = "none"
        [display]
        driver = "x11"
        [display.faults]
        late = {soon = 1}
        [scene]
        kind = "matrix"
    """
    assert [line.split(":")[0] for line in fault_lines(write(tmp_path, text))] == [
        "colour",
        "rig.on_miss",
        "rig.settle_s",
        "camera.iso",
        "camera.nois",
        "mask.skew_s",
        "mask.refresh_hz",
        "scene.path",
        "display.faults.late",
    ]


field_names = st.sampled_from(
    sorted(
        {
            field.name
            for part in (Config(), Config().display, Config().display.faults, Config().camera)
            for field in msgspec.structs.fields(part)
        }
    )
)
any_tables = st.recursive(values, lambda x: st.dictionaries(field_names, x, max_size=6))


@given(st.dictionaries(field_names, any_tables, max_size=6))
@settings(max_examples=50)
def test_any_table_is_either_sound_or_a_configuration_error(
    tmp_path_factory: pytest.TempPathFactory, table: dict[str, Any]
) -> None:
    path = write(tmp_path_factory.mktemp("any"), format_toml(table))
    try:
        loaded = config.load_config(path)
    except ConfigError as err:
        assert err.message.startswith(("1 fault in", f"{err.message.count(chr(10))} faults in"))
    else:
        assert checks.check_config(loaded) == []


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("x = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("x = " + "{a=" * 5000 + "1" + "}" * 5000, "nested too deeply"),
        ("a" + ".a" * 5000 + " = 1", "nested too deeply"),
        ("[rig]\nretries = " + "9" * 5000, "is not TOML"),
        ("[rig]\nsettle_s = 1" + "0" * 400, "rig.settle_s: a number has more"),
        ("[scene]\noptions = {a = [1, {b = 18446744073709551616}]}", "scene.options.a.b: a num"),
    ],
)
def test_numbers_and_depths_beyond_all_measure_are_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, what: str
) -> None:
    assert main(["config", "check", "--config", str(write(tmp_path, text))]) == 2
    said = capsys.readouterr().err
    assert what in said and len(said.splitlines()) <= 2 and len(said) < 400


def test_a_matrix_file_that_is_none_ends_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(tmp_path / "fifo.npz")
    (tmp_path / "bomb.npz").write_bytes(files._bomb())
    (tmp_path / "crowd.npz").write_bytes(files._crowd())
    (tmp_path / "cut.npz").write_bytes(files._bomb()[:1000])
    for name in ("fifo", "bomb", "crowd", "cut"):
        text = f'[scene]\nkind = "matrix"\npath = "{name}.npz"'
        command = ["plan", "white", "--local", "--config", str(write(tmp_path, text))]
        assert main(command) == 2
        *_, line = said = capsys.readouterr().err.splitlines()
        assert f"{name}.npz" in line and len(said) <= 2


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"cannot read .*gone\.toml: No such file"):
        config.load_config(tmp_path / "gone.toml")
    with pytest.raises(ConfigError, match="it is a folder"):
        config.load_config(tmp_path)
    with pytest.raises(ConfigError, match=r"is not TOML: .*line 2, column"):
        config.load_config(write(tmp_path, "[rig]\nname = ?"))
    latin = tmp_path / "latin.toml"
    latin.write_bytes(b'[rig]\nname = "\xe9"')
    with pytest.raises(ConfigError, match="is not TOML"):
        config.load_config(latin)
