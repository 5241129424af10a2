"""Frames that a stream is measured with are those of the mock bench.

They were made beforehand of what two virtual DMDs showed. Another bench, in which no DMD ever was,
sees what their mirrors did live, and a sum over all pairs of cells and moments sees it once more.
"""

from __future__ import annotations

from random import Random

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.panels.patterns import Patterns
from tests.stream_bench.recorded import (
    MASK_SKEW_S,
    MirrorLight,
    MirrorTimes,
    make_request,
    record_stream,
)


def list_moments(
    patterns: Patterns, shown: NDArray[np.int32], at_ns: NDArray[np.int64], cells: int
) -> list[tuple[float, NDArray[np.float64]]]:
    """When a panel took each plane, in seconds, and how bright its cells were from then on."""
    dark, lit = np.zeros(cells), np.ones(cells)
    planes = np.unpackbits(np.asarray(patterns, np.uint8), axis=1)[:, :cells].astype(np.float64)
    return [
        (1e-9 * at, dark if one == -1 else lit if one == -2 else planes[one])
        for at, one in zip(at_ns.tolist(), shown.tolist(), strict=True)
    ]


def realise(mirrors: MirrorTimes, cells: int) -> NDArray[np.float64]:
    """How long each cell of the mask was open while each of the projector was lit, (cells, cells)
    seconds."""
    frames, log = mirrors.frames, mirrors.log
    end_s = 1e-9 * mirrors.close_ns
    sides = (
        list_moments(frames.primal_patterns, frames.primal_index, log.primal_ns, cells),
        list_moments(frames.dual_patterns, frames.dual_index, log.dual_ns, cells),
    )
    sides = sides[0], [(at_s + MASK_SKEW_S, plane) for at_s, plane in sides[1]]
    matrix, now = np.zeros((cells, cells)), [np.zeros(cells), np.zeros(cells)]
    changes = sorted(
        ((at_s, side, plane) for side in (0, 1) for at_s, plane in sides[side]), key=lambda c: c[0]
    )
    for n, (at_s, side, plane) in enumerate(changes):
        now[side] = plane
        until_s = min(end_s, changes[n + 1][0] if n + 1 < len(changes) else end_s)
        if until_s > max(at_s, 0.0):
            matrix += (until_s - max(at_s, 0.0)) * np.outer(now[1], now[0])
    return matrix


@pytest.mark.whole
@pytest.mark.parametrize("size", ["small", "cells"])
def test_frames_made_beforehand_are_those_that_are_seen_live(size: str) -> None:
    recorded, live = record_stream(make_request(32), size), MirrorLight(size)
    scene = live.scene
    one, none, each = np.ones((1, scene.cells)), np.zeros(scene.cells), np.eye(scene.cells)
    columns = [scene.photo(one, lit[None], lit, none) for lit in each]
    transport = np.stack(columns, axis=1)  # of the camera, of the projector, colour
    coded = [photo for photo in recorded.photos if photo.light.any()]
    # DMDs never answer an edge alike.
    assert len({photo.mirrors.log.primal_ns.tobytes() for photo in coded}) > 50
    for photo in Random(5).sample(coded, 20):
        least = 1e-9 * photo.light.max()
        np.testing.assert_allclose(live.see(photo.mirrors), photo.light, rtol=1e-9, atol=least)
        if size == "cells":  # others see more within each cell
            matrix = realise(photo.mirrors, scene.cells)
            summed = np.einsum("ij,ijc->ic", matrix, transport).reshape(photo.light.shape)
            np.testing.assert_allclose(summed, photo.light, rtol=1e-9, atol=least)
