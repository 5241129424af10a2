"""The configuration: round trip, every kind of fault, where files and folders are looked for."""

from __future__ import annotations

import json
import os
import stat
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.bench import checks, config, folders, tables
from pdcd.bench.reading import format_toml
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError
from tests.places import ROOT

MOCK_TOML = ROOT / "config" / "mock.toml"
BENCH_TOML = ROOT / "config" / "bench.toml"


@pytest.fixture(autouse=True)
def _no_place_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Hide the user's own folders and those of a service manager; the tests name theirs."""
    for name in ("CONFIGURATION", "STATE", "RUNTIME"):
        monkeypatch.delenv(f"{name}_DIRECTORY", raising=False)
    for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


def write(folder: Path, text: str, name: str = "rig.toml") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


# --- round trip ---------------------------------------------------------------------------------

plain_text = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
numbers = st.floats(allow_nan=False, allow_infinity=False)
small = st.floats(0.0, 1e-3)
toml_values: st.SearchStrategy[Any] = st.recursive(
    st.booleans()
    | st.integers(-(2**53) + 1, 2**53 - 1)
    | numbers
    | plain_text
    | st.dates()
    | st.datetimes()
    | st.times(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(plain_text, inner, max_size=3),
    max_leaves=8,
)
options = st.dictionaries(plain_text, toml_values, max_size=3)


@st.composite
def configs(draw: st.DrawFn) -> Config:
    """Sound configurations that differ from the default in every table."""
    rate_hz = draw(st.floats(20.0, 2000.0))

    def panel(offset: tuple[float, float]) -> tables.PanelConfig:
        return tables.PanelConfig(
            size_px=(draw(st.integers(300, 4000)), draw(st.integers(300, 4000))),
            refresh_hz=rate_hz,
            phase_s=draw(st.floats(-5e-4, 5e-4)),
            skew_s=draw(st.floats(-60.0, 60.0)),
            rise_s=draw(small),
            contrast=draw(st.none() | st.floats(1.5, 1e6)),
            offset_px=offset,
        )

    refreshes = st.integers(0, 10**6)
    return Config(
        rig=tables.RigConfig(name=draw(plain_text), settle_s=draw(small)),
        projector=panel((0.0, 0.0)),
        mask=panel((draw(small), draw(small))),
        display=tables.DisplayConfig(
            driver=draw(plain_text),
            faults=tables.FaultsConfig(
                late=draw(st.dictionaries(refreshes.map(str), st.integers(1, 9), max_size=3)),
                dropped=tuple(draw(st.lists(refreshes, max_size=3))),
            ),
            options=draw(options),
        ),
        camera=tables.CameraConfig(
            iso=draw(st.none() | st.integers(1, 10**6)),
            f_number=draw(st.sampled_from(("auto", 0.5, 2.8, 64.0))),
            responsivity_e=draw(st.none() | st.just((1.0, 2.5, 1e9))),
            options=draw(options),
        ),
        scene=tables.SceneConfig(
            kind="matrix", path=str(MOCK_TOML), grid=draw(st.none() | st.just((5, 7)))
        ),
        schedule=tables.ScheduleConfig(
            codes=draw(st.integers(1, 65536)), guards=draw(st.booleans())
        ),
        server=tables.ServerConfig(
            socket="/run/lab.sock",
            allow_uids=tuple(draw(st.lists(refreshes, max_size=2))),
            look=tables.RoleConfig(
                groups=tuple(draw(st.lists(refreshes | plain_text, max_size=2)))
            ),
        ),
    )


@given(configs())
@settings(max_examples=20)
def test_what_show_prints_loads_as_the_same_rig(
    tmp_path_factory: pytest.TempPathFactory, rig: Config
) -> None:
    path = write(tmp_path_factory.mktemp("shown"), config.format_config(rig))
    assert config.load_config(path) == rig


@given(options)
@settings(max_examples=50)
def test_emitted_text_parses_to_the_same_table(table: dict[str, Any]) -> None:
    assert tomllib.loads(format_toml(table)) == table


# --- files that come with pdcd ------------------------------------------------------------------


def test_mock_toml_is_the_default_rig() -> None:
    assert config.load_config(MOCK_TOML) == Config()


def test_mock_toml_names_every_key() -> None:
    lines = MOCK_TOML.read_text(encoding="utf-8").splitlines()
    table = ""
    named: set[str] = set()
    for line in lines:
        if line.startswith("["):
            table = line[1 : line.index("]")]
        elif " = " in line:
            named.add(f"{table}.{line.removeprefix('# ').split(' = ')[0]}")

    def keys(part: msgspec.Struct, where: str) -> set[str]:
        found: set[str] = set()
        for field in msgspec.structs.fields(part):
            value = getattr(part, field.name)
            name = f"{where}.{field.name}".lstrip(".")
            if isinstance(value, msgspec.Struct):
                found |= keys(value, name)
            elif field.name != "options":
                found.add(name)
        return found

    assert named == keys(Config(), "")


def test_bench_toml_is_sound() -> None:
    bench = config.load_config(BENCH_TOML)
    assert (bench.display.driver, bench.camera.driver, bench.trigger.driver) == (
        "x11",
        "ptp",
        "serial",
    )
    assert checks.check_config(bench) == []


# --- what is filled in --------------------------------------------------------------------------


def test_paths_are_meant_from_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home, here = tmp_path / "rigs", tmp_path / "here"
    path = write(
        home,
        "[scene]\nkind = 'matrix'\npath = 'a.npz'\n[camera]\nprofile = 'my/own'\n"
        "[server]\nsocket = 's.sock'\nstate_dir = '~/runs'",
    )
    for folder in (home, here):
        write(folder, "", "a.npz")
    write(here / "my", "", "own")
    monkeypatch.chdir(here)
    rig = config.load_config(path)
    assert rig.scene.path == str(home / "a.npz")
    assert rig.camera.profile == str(here / "my" / "own"), "found only in the current folder"
    assert rig.server.socket == str(home / "s.sock")
    assert rig.server.state_dir == str(tmp_path / "home" / "runs")

    (home / "a.npz").unlink()
    assert config.load_config(path).scene.path == str(here / "a.npz")


def test_search_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def name() -> str:
        return config.load_config().rig.name

    def place(folder: Path, label: str) -> None:
        write(folder, f"[rig]\nname = '{label}'", "pdcd.toml")

    assert config.find_config_file() is None
    assert config.load_config() == Config()
    place(tmp_path / "home" / ".config" / "pdcd", "home")
    assert name() == "home"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "xdg"))
    assert name() == "mock bench", "XDG_CONFIG_HOME replaces ~/.config"
    place(tmp_path / "xdg" / "pdcd", "xdg")
    assert name() == "xdg"
    monkeypatch.setenv("CONFIGURATION_DIRECTORY", str(tmp_path / "etc"))
    assert name() == "xdg", "systemd sets the variable even when the folder is empty"
    place(tmp_path / "etc", "etc")
    assert name() == "etc"
    assert config.load_config(MOCK_TOML).rig.name == "mock bench"
    assert config.find_config_file() == tmp_path / "etc" / "pdcd.toml"


def test_search_survives_a_process_without_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HOME")
    monkeypatch.setenv("XDG_CONFIG_HOME", "relative/is/ignored")
    assert config.find_config_file() is None


# --- socket and state folder --------------------------------------------------------------------


def test_socket_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    private = tmp_path / f"pdcd-{os.getuid()}"
    assert folders.find_socket_path(Config()) == private / "pdcd.sock"
    assert stat.S_IMODE(private.stat().st_mode) == 0o700
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/5")
    assert folders.find_socket_path(Config()) == Path("/run/user/5/pdcd.sock")
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/pdcd:/run/other")
    assert folders.find_socket_path(Config()) == Path("/run/pdcd.sock")
    rig = Config(server=tables.ServerConfig(socket="/a/b.sock"))
    assert folders.find_socket_path(rig) == Path("/a/b.sock")


def test_state_dir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert folders.find_state_dir(Config()) == tmp_path / ".local" / "state" / "pdcd"
    monkeypatch.setenv("XDG_STATE_HOME", "/home/x/.local/state")
    assert folders.find_state_dir(Config()) == Path("/home/x/.local/state/pdcd")
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/pdcd:/var/lib/other")
    assert folders.find_state_dir(Config()) == Path("/var/lib/pdcd")
    rig = Config(server=tables.ServerConfig(state_dir="/data"))
    assert folders.find_state_dir(rig) == Path("/data")


def test_a_user_without_a_home_is_told_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HOME")
    monkeypatch.setattr("os.getuid", lambda: 2**31 - 7)  # of no user that has a name
    with pytest.raises(ConfigError, match="uid 2147483641 has no home folder") as caught:
        folders.find_state_dir(Config())
    assert "XDG_STATE_HOME" in str(caught.value.hint)


def test_stand_in_folder_of_somebody_else_is_refused(tmp_path: Path) -> None:
    private = tmp_path / f"pdcd-{os.getuid()}"
    (tmp_path / "trap").mkdir(mode=0o700)
    private.symlink_to(tmp_path / "trap")
    with pytest.raises(ConfigError, match="not a private folder"):
        folders.find_socket_path(Config())
    private.unlink()
    private.mkdir()
    private.chmod(0o755)
    with pytest.raises(ConfigError, match="not a private folder"):
        folders.find_socket_path(Config())
    private.rmdir()
    private.write_text("in the way")
    with pytest.raises(ConfigError, match="cannot make the folder"):
        folders.find_socket_path(Config())


def test_schema_describes_every_table() -> None:
    schema = json.loads(json.dumps(config.make_config_schema()))
    tables = schema["$defs"]["Config"]["properties"]
    assert set(tables) == {field.name for field in msgspec.structs.fields(Config)}
    assert schema["$defs"]["ScheduleConfig"]["properties"]["codes"]["minimum"] == 1
