"""A run goes to the folder that was allowed, whatever becomes of its name, and nowhere else."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pdcd.errors import PdcdError, RequestError
from pdcd.protocol.events import Event, PicturesArchived, ShutterOpen
from pdcd.protocol.result import CaptureResult
from pdcd.runs.manifest import MANIFEST, MANIFEST_DIGEST
from pdcd.runs.place import HeldFolder
from pdcd.runs.verify import verify_run
from tests import bench_rig
from tests.taken import request_of, started


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    """Every descriptor is closed in the end."""
    before = len(list(Path("/proc/self/fd").iterdir()))
    yield
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_missing_folders_are_made_and_the_place_is_where_it_says(tmp_path: Path) -> None:
    with HeldFolder.below(tmp_path / "state", "a/b") as place:
        assert place.real == tmp_path / "state" / "a" / "b"
        (place.path / "x").touch()
        assert names(tmp_path / "state") == ["a", "a/b", "a/b/x"]
        (tmp_path / "state" / "a").rename(tmp_path / "state" / "c")
        assert place.real == tmp_path / "state" / "c" / "b"
        place.check()
    with pytest.raises(PdcdError, match="closed"):
        _ = place.fd
    place.close()


def test_the_state_folder_itself_may_be_reached_by_a_link(tmp_path: Path) -> None:
    """As /var/lib/pdcd is, where systemd gives the service a user of its own."""
    (tmp_path / "private").mkdir()
    (tmp_path / "state").symlink_to("private")
    for out in ("x", str(tmp_path / "state" / "x"), str(tmp_path / "private" / "x")):
        with HeldFolder.below(tmp_path / "state", out) as place:
            assert place.real == tmp_path / "private" / "x"


def test_links_on_the_way_are_followed_for_a_user_of_this_machine(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "link").symlink_to("there")
    with HeldFolder.at(tmp_path / "link" / "new") as place:
        assert place.real == tmp_path / "there" / "new"


@pytest.mark.parametrize("name", ["run", "run/raw", "run/new", "run/raw/new", "x.partial/new"])
def test_no_user_writes_into_a_run(tmp_path: Path, name: str) -> None:
    (tmp_path / "run" / "raw").mkdir(parents=True)
    (tmp_path / "run" / MANIFEST).touch()
    before = names(tmp_path)
    with pytest.raises(RequestError, match="another run"):
        HeldFolder.at(tmp_path / name)
    assert names(tmp_path) == before


@pytest.mark.parametrize("name", ["\0", "loop", "loop/x", "x" * 300, "file", "\ud800", "a/" * 99])
def test_what_can_be_no_folder_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "file").touch()
    before = names(tmp_path)
    for local in (True, False):
        with pytest.raises(RequestError) as told:
            HeldFolder.at(tmp_path / name) if local else HeldFolder.below(tmp_path, name)
        assert told.value.kind == "request" and told.value.hint
    assert names(tmp_path) == before


def test_an_operator_may_name_a_folder_with_control_characters(tmp_path: Path) -> None:
    with HeldFolder.at(tmp_path / "a\x1bb") as place:
        assert place.real == tmp_path / "a\x1bb"


def test_a_link_that_appears_on_the_way_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the look and the making: somebody is faster."""
    state, outside = tmp_path / "state", tmp_path / "outside"
    state.mkdir()
    outside.mkdir()

    def faster(name: str, mode: int = 0o777, *, dir_fd: int | None = None) -> None:
        if dir_fd is not None:
            (state / name).symlink_to(outside)
        raise FileExistsError

    with monkeypatch.context() as patch:
        patch.setattr(os, "mkdir", faster)
        with pytest.raises(RequestError):
            HeldFolder.below(state, "a/b")
    assert names(outside) == []


def capture(tmp_path: Path, when: type[Event], do: Callable[[Path, Path], object]) -> CaptureResult:
    """A run into state/mine, during which somebody does something to (state, outside)."""
    state, outside = tmp_path / "state", tmp_path / "outside"
    outside.mkdir()
    left = [do]

    def emit(event: Event) -> None:
        if isinstance(event, when) and left:
            left.pop()(state, outside)

    place = HeldFolder.below(state, "mine")
    with place, started(bench_rig.config(tmp_path)) as engine:
        return engine.capture(
            request_of(codes=4), job="job", emit=emit, cancelled=lambda: False, parent=place
        )


def swap(state: Path, outside: Path) -> None:
    (state / "mine").rename(state / "aside")
    (state / "mine").symlink_to(outside)


@pytest.mark.parametrize("when", [ShutterOpen, PicturesArchived])
def test_a_swapped_folder_leads_nowhere(tmp_path: Path, when: type[Event]) -> None:
    result = capture(tmp_path, when, swap)
    assert result.state == "done", result.error
    assert names(tmp_path / "outside") == []
    assert result.folder == str(tmp_path / "state" / "aside" / "job")
    assert verify_run(Path(result.folder), manifest_sha256=result.manifest_sha256).whole


def swap_run(state: Path, outside: Path) -> None:
    (state / "mine" / "job.partial").rename(state / "mine" / "other.partial")
    (state / "mine" / "job.partial").symlink_to(outside)


def copy_run(state: Path, outside: Path) -> None:
    (state / "mine" / "job.partial").rename(state / "mine" / "other.partial")
    (state / "mine" / "job.partial").mkdir()


def take_the_name(state: Path, outside: Path) -> None:
    (state / "mine" / "job").mkdir()


def move_out(state: Path, outside: Path) -> None:
    (state / "mine").rename(outside / "mine")


def move_into_a_run(state: Path, outside: Path) -> None:
    (state / "run").mkdir()
    (state / "run" / MANIFEST).touch()
    (state / "mine").rename(state / "run" / "mine")


@pytest.mark.parametrize(
    ("do", "when"),
    [
        (swap_run, ShutterOpen),
        (copy_run, PicturesArchived),
        (take_the_name, ShutterOpen),
        (move_out, ShutterOpen),
        (move_out, PicturesArchived),
        (move_into_a_run, PicturesArchived),
    ],
)
def test_a_run_that_cannot_end_where_it_was_allowed_fails(
    tmp_path: Path, when: type[Event], do: Callable[[Path, Path], object]
) -> None:
    result = capture(tmp_path, when, do)
    assert result.state == "failed" and result.error is not None
    if do in (move_out, move_into_a_run):
        assert result.error["kind"] == "request"
    assert result.folder is not None and "/proc/" not in str(result.error)
    kept = Path(result.folder)
    assert kept.name in ("job.partial", "other.partial") and (kept / "raw").is_dir()
    runs = [path for path in tmp_path.rglob("*") if path.name in (MANIFEST, MANIFEST_DIGEST)]
    assert runs in ([], [tmp_path / "state" / "run" / MANIFEST])
    if do is not move_out:
        assert names(tmp_path / "outside") == []


def test_a_name_that_is_lost_at_the_last_step_is_given_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk fails when the new name is to be made durable."""
    fsync = os.fsync

    def failing(descriptor: int) -> None:
        if (tmp_path / "state" / "mine" / "job").exists():
            raise OSError(5, "Input/output error")
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", failing)
    result = capture(tmp_path, ShutterOpen, lambda *_: None)
    assert result.state == "failed" and result.error is not None
    assert result.folder == str(tmp_path / "state" / "mine" / "job.partial")
    assert not list(tmp_path.rglob(f"{MANIFEST}*"))
