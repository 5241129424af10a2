"""Parts of a run one by one: its pictures by name, its patterns, and its previews in a notebook."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from pdcd.api import html
from pdcd.api import run as module
from pdcd.api.run import Run
from pdcd.errors import DecodeError
from pdcd.panels.patterns import pack_bits
from tests.unit.api.test_tasks import run_of


def files(*names: str) -> Any:
    return dict.fromkeys(names)


def probed(monkeypatch: pytest.MonkeyPatch, **arrays: Any) -> Run:
    monkeypatch.setattr(Run, "checked", lambda self, name: Path("/checked") / name)
    monkeypatch.setattr(module, "read_stored_arrays", lambda path: arrays)
    return run_of(files=files("probe.npz"))


def test_a_picture_is_over_the_cells_of_its_run(monkeypatch: pytest.MonkeyPatch) -> None:
    image, sigma = np.zeros((2, 3, 3)), np.ones((2, 3, 3))
    run = probed(monkeypatch, image=image, sigma=sigma, other=np.zeros(4))
    assert run.image is image and run.sigma is sigma
    assert probed(monkeypatch, image=image).image is image
    wrongs: tuple[dict[str, Any], ...] = (
        {"image": np.zeros((3, 2, 3))}, {"image": np.zeros((2, 3, 1))}, {"sigma": np.zeros((2, 3))}
    )  # fmt: skip
    for wrong in wrongs:
        with pytest.raises(DecodeError, match="not over the run's cells") as caught:
            _ = probed(monkeypatch, **{"image": image, "sigma": sigma, **wrong}).image
        assert caught.value.hint == "see pdcd verify"


def shown(monkeypatch: pytest.MonkeyPatch, shots: list[tuple[str, Any]], **stored: Any) -> Any:
    monkeypatch.setattr(Run, "checked", lambda self, name: Path("/checked") / name)
    monkeypatch.setattr(module, "read_patterns", lambda folder: stored)
    run = run_of(files=files("codes.npz"))
    made: Any = run.manifest.run
    made.shots = [SimpleNamespace(name=name, window=window) for name, window in shots]
    return run


def test_a_program_without_its_mask_is_damaged(monkeypatch: pytest.MonkeyPatch) -> None:
    run = shown(
        monkeypatch, [("coded", "whole")], **{"coded.primal": pack_bits(np.ones((4, 6), bool))}
    )
    with pytest.raises(DecodeError, match=r"codes.npz is damaged: .*coded.dual") as caught:
        _ = run.codes
    assert caught.value.hint == "restore it from a copy"


def test_previews_are_at_most_320_pixels_wide() -> None:
    for shape, wanted in (((480, 640), (240, 320)), ((100, 320), (100, 320)), ((1, 999), (1, 320))):
        png = cv2.imencode(".png", np.full((*shape, 3), 100, np.uint8))[1].tobytes()
        data = html._small("a", png)
        small = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert small is not None and small.shape == (*wanted, 3)
