"""Work that is expected, done and told, and what a whole decoding tells of itself."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from pdcd.pictures.decode import decode_folder
from pdcd.protocol.events import DecodingProgress, Event
from pdcd.protocol.request import CaptureRequest
from pdcd.watch import Watch
from tests import bench_rig
from tests.taken import started


def test_pieces_count_their_signs_of_life_and_are_done_in_the_end() -> None:
    told: list[tuple[float, float]] = []
    signs: list[None] = []
    watch = Watch(lambda: signs.append(None), lambda done, total: told.append((done, total)))
    watch.expect(10.0)
    watch.did(8.0)
    with watch.piece(2.0) as alive:
        alive()
        alive()
    assert [done for done, _ in told] == pytest.approx([8.0, 8.2, 8.38, 10.0])
    watch.did(5.0)
    assert told[-1] == (10.0, 10.0)  # never more than all
    assert len(signs) == len(told)


def test_nothing_is_told_of_no_work_and_an_ear_may_end_it() -> None:
    told: list[float] = []
    Watch(step=lambda done, total: told.append(total)).did(1.0)
    assert told == []

    def enough() -> None:
        raise KeyboardInterrupt

    watch = Watch(enough)
    with pytest.raises(KeyboardInterrupt), watch.piece(1.0) as alive:
        alive()


@pytest.mark.parametrize(
    ("request_", "decodings"),
    [
        (CaptureRequest(goal="indirect", codes=8), 1 + 1),
        (CaptureRequest(goal="indirect", codes=8, black_level="none"), 1),
        (CaptureRequest(goal="direct", method="multi-image", codes=8), 1 + 1),
        (CaptureRequest(goal="indirect", codes=64, pilot=8), 2 + 1),
        (CaptureRequest(goal="indirect", codes=48, parts=6, until_error=1e-6), 6 + 1),
    ],
)
def test_every_decoding_goes_on_to_its_end(
    tmp_path: Path, request_: CaptureRequest, decodings: int
) -> None:
    events: list[Event] = []
    with started(bench_rig.config(tmp_path, grid=(8, 8))) as engine:
        result = engine.capture(request_, job="job", emit=events.append, cancelled=lambda: False)
    assert result.state == "done", result.error
    stages: list[list[DecodingProgress]] = []
    before: Event | None = None
    for event in events:
        if isinstance(event, DecodingProgress):
            if not isinstance(before, DecodingProgress):
                stages.append([])
            stages[-1].append(event)
        before = event
    assert len(stages) == decodings
    for stage in stages:
        assert len({event.total for event in stage}) == 1
        assert all(a.done <= b.done for a, b in pairwise(stage))
        assert stage[0].done < stage[0].total
        assert stage[-1].done == pytest.approx(stage[-1].total)

    told: list[tuple[float, float]] = []
    assert decode_folder(
        Path(str(result.folder)), Watch(step=lambda done, total: told.append((done, total)))
    ).identical
    assert told[-1][0] == pytest.approx(told[-1][1])
    assert len(told) > 4
