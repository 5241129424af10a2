"""The end of a run, when its files are hashed and made durable: that may take minutes."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.capture.engine import Engine
from pdcd.protocol.events import Event, PicturesArchived
from pdcd.protocol.request import CaptureRequest
from tests import bench_rig


class Asked:
    """Counts how often the run asks whether it is wanted, once its pictures are written."""

    def __init__(self, at_most: int) -> None:
        self.at_most = at_most
        self.archived, self.times = False, 0

    def hear(self, event: Event) -> None:
        self.archived = self.archived or isinstance(event, PicturesArchived)

    def cancelled(self) -> bool:
        self.times += self.archived
        return self.times > self.at_most


@pytest.fixture
def engine(tmp_path: Path) -> Engine:
    engine = Engine.from_config(bench_rig.config(tmp_path))
    engine.start()
    return engine


def test_a_sign_of_life_comes_for_each_file_that_is_hashed_or_made_durable(engine: Engine) -> None:
    asked = Asked(at_most=10**6)
    request = CaptureRequest(goal="indirect", codes=8)
    result = engine.capture(request, job="job", emit=asked.hear, cancelled=asked.cancelled)
    engine.stop()
    assert result.state == "done"
    # All but the manifest are hashed; its digest is made durable with them.
    assert asked.times >= 2 * (len(result.files) - 1) - 1


def test_a_run_can_be_cancelled_while_its_files_are_hashed(engine: Engine) -> None:
    asked = Asked(at_most=4)
    request = CaptureRequest(goal="indirect", codes=8)
    result = engine.capture(request, job="job", emit=asked.hear, cancelled=asked.cancelled)
    engine.stop()
    assert result.state == "cancelled" and result.folder is not None
    assert not (Path(result.folder) / "capture.json").exists()
