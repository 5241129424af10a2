"""An engine of a mock bench, started."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from pdcd.capture.engine import Engine
from tests import bench_rig


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    engine = Engine.from_config(bench_rig.config(tmp_path))
    engine.start()
    yield engine
    engine.stop()
