"""The world that tests live in: where it is, who shares it, and that it goes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from pdcd.bench.config import find_config_file
from pdcd.bench.folders import find_socket_path, find_state_dir
from pdcd.bench.tables import Config
from tests import world
from tests.places import ROOT

TOLD = "import json, os; from tests import world; world.enter(); "
SAY = "print(json.dumps(dict(os.environ)))"


def environment_of(code: str, **variables: str) -> dict[str, str]:
    """What a process that enters finds around it, and tells."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTEST_", "PDCD_"))}
    told = subprocess.run(
        [sys.executable, "-c", code], env=kept | variables, cwd=ROOT, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    found: dict[str, str] = json.loads(told.stdout)
    return found


def inside(variables: dict[str, str]) -> list[Path]:
    return [Path(variables[name]) for name in world.FOLDERS]


def test_tests_live_in_it() -> None:
    mine = Path(os.environ[world.MARK])
    assert not set(world.ABSENT) & set(os.environ)
    assert find_config_file() is None
    for path in (find_socket_path(Config()), find_state_dir(Config()), Path(tempfile.gettempdir())):
        assert path.is_relative_to(mine)


def test_what_a_machine_says_of_itself_leads_nowhere(tmp_path: Path) -> None:
    said = dict.fromkeys((*world.ABSENT, *world.FOLDERS), str(tmp_path))
    found = environment_of(TOLD + SAY, **said)
    made = Path(found[world.MARK])
    assert made.parent == tmp_path and not set(world.ABSENT) & set(found)
    assert all(folder.parent == made for folder in inside(found))
    assert found[world.PYTEST_FILES] == str(tmp_path)
    assert not made.exists(), "whoever made it removes it"


def test_a_forked_child_leaves_it_to_its_maker() -> None:
    fork = "pid = os.fork(); _ = os.waitpid(pid, 0) if pid else exit(); "
    found = environment_of(TOLD + fork + "assert os.path.exists(os.environ['HOME']); " + SAY)
    assert not Path(found["HOME"]).exists()


def test_programs_that_tests_start_share_it() -> None:
    found = environment_of(TOLD + SAY, **{world.MARK: os.environ[world.MARK]})
    assert inside(found) == inside(dict(os.environ))
    assert Path(found["HOME"]).is_dir()


def test_each_worker_has_one_of_its_own_with_the_caches_of_all(tmp_path: Path) -> None:
    outer = {world.MARK: str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    found = environment_of(TOLD + SAY, PYTEST_XDIST_WORKER="gw7", **outer)
    assert found[world.MARK] == str(tmp_path / "gw7")
    assert found["XDG_CACHE_HOME"] == outer["XDG_CACHE_HOME"]
    own = [path for path in inside(found) if path.parent == tmp_path / "gw7"]
    assert len(own) == len(world.FOLDERS) - 1 and all(path.is_dir() for path in own)


def test_what_a_test_leaves_at_home_is_gone_for_the_next() -> None:
    left = [Path.home() / name / "left" for name in world.SWEPT]
    for path in left:
        path.mkdir(parents=True)
    world.sweep()
    world.sweep()
    assert not any(path.exists() for path in left)
