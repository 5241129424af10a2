"""A run that looks finished is on the disk: everything is made durable before it gets its name."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from pdcd.errors import NoSpaceError
from pdcd.pictures.written.picture_files import write_png
from pdcd.runs.manifest import MANIFEST, MANIFEST_DIGEST
from tests import bench_rig
from tests.taken import take

Step = tuple[str, Path]


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[Step]:
    """What was made durable or renamed, in order; "name" tells of the new name."""
    found: list[Step] = []
    fsync, rename = os.fsync, os.rename

    def noted(handle: int) -> None:
        found.append(("sync", Path(f"/proc/self/fd/{handle}").readlink()))
        fsync(handle)

    def renamed(source: str | Path, target: str | Path, **at: int) -> None:
        folder = Path(f"/proc/self/fd/{at['dst_dir_fd']}") if at else Path(target).parent
        found.append(("name", folder.resolve() / Path(target).name))
        rename(source, target, **at)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(os, "rename", renamed)
    return found


def test_files_before_the_manifest_folders_before_the_name(
    tmp_path: Path, steps: list[Step]
) -> None:
    final = take(bench_rig.config(tmp_path), codes=4).folder.resolve()
    partial = final.with_name(f"{final.name}.partial")
    files = {partial / p.relative_to(final) for p in final.rglob("*") if p.is_file()}
    folders = {partial / p.relative_to(final) for p in final.rglob("*") if p.is_dir()}

    named = steps.index(("name", partial / MANIFEST))
    finished = steps.index(("name", final))
    before_manifest = {path for what, path in steps[:named] if what == "sync"}
    assert files - {partial / MANIFEST} <= before_manifest
    assert {partial / f"{MANIFEST}.new", partial / MANIFEST_DIGEST} <= before_manifest
    after_manifest = {path for what, path in steps[named:finished] if what == "sync"}
    assert folders | {partial} <= after_manifest
    assert steps[finished + 1 :] == [("sync", final.parent)]


def test_a_full_quota_is_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.EDQUOT, "full")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(NoSpaceError):
        write_png(tmp_path / "a.png", np.zeros((2, 2, 3), dtype=np.uint8))
