"""Parts of a run one by one: its pictures by name, its patterns, and its previews in a notebook."""

from __future__ import annotations

import base64
import re
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
from pdcd.protocol.result import Quality
from tests.unit.api.test_tasks import run_of


def files(*names: str) -> Any:
    return dict.fromkeys(names)


def test_pictures_are_read_once_each_when_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[Path] = []

    def read_tiff(path: Path) -> str:
        read.append(path)
        return f"picture {len(read)}"

    monkeypatch.setattr("pdcd.pictures.written.picture_files.read_tiff", read_tiff)
    monkeypatch.setattr(Run, "checked", lambda self, name: Path("/checked") / name)
    names = ("linear/a.tif", "linear/b.c.tif", "other/d.tif", "linear/e.png", "linear.tif")
    pictures: Any = run_of(files=files(*names)).pictures
    assert [*pictures] == ["a", "b.c"] and len(pictures) == 2
    assert repr(pictures) == "<pictures a, b.c>"
    assert read == []
    assert [pictures["b.c"], pictures["a"], pictures["b.c"]] == [
        "picture 1", "picture 2", "picture 1",
    ]  # fmt: skip
    assert read == [Path("/checked/linear/b.c.tif"), Path("/checked/linear/a.tif")]
    for name in ("d", "e", "linear/a"):
        with pytest.raises(KeyError, match=name):
            pictures[name]


def probed(monkeypatch: pytest.MonkeyPatch, **arrays: Any) -> Run:
    monkeypatch.setattr(Run, "checked", lambda self, name: Path("/checked") / name)
    monkeypatch.setattr(module, "read_stored_arrays", lambda path: arrays)
    return run_of(files=files("probe.npz"))


def test_a_picture_is_over_the_cells_of_its_run(monkeypatch: pytest.MonkeyPatch) -> None:
    image, sigma = np.zeros((2, 3, 3)), np.ones((2, 3, 3))
    run = probed(monkeypatch, image=image, sigma=sigma, other=np.zeros(4))
    assert run.image is image and run.sigma is sigma
    assert probed(monkeypatch, image=image).image is image
    for wrong in ({"image": np.zeros((3, 2, 3))}, {"sigma": np.zeros((2, 3))}):
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


def test_codes_are_told_by_program_and_panel(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(7)
    bright, dark = (rng.random((4, 6)) < 0.5 for _ in range(2))
    levels = np.arange(18.0).reshape(3, 6) / 17.0
    stored = {
        "coded.primal": pack_bits(bright), "coded.dual": pack_bits(dark),
        "grey.primal": levels, "grey.dual": levels[:, ::-1],
    }  # fmt: skip
    run = shown(monkeypatch, [("coded.1", "whole"), ("grey.1", "whole")], **stored)
    assert [*run.codes] == ["coded", "grey"]
    for found, wanted in ((run.codes["coded"].projector, bright), (run.codes["coded"].mask, dark)):
        assert found.dtype == np.bool_ and np.array_equal(found, wanted.reshape(4, 2, 3))
    grey = run.codes["grey"]
    assert np.allclose(grey.projector, levels.reshape(3, 2, 3))
    assert np.allclose(grey.mask, levels[:, ::-1].reshape(3, 2, 3))


def test_a_program_without_its_mask_is_damaged(monkeypatch: pytest.MonkeyPatch) -> None:
    run = shown(
        monkeypatch, [("coded", "whole")], **{"coded.primal": pack_bits(np.ones((4, 6), bool))}
    )
    with pytest.raises(DecodeError, match=r"codes.npz is damaged: .*coded.dual") as caught:
        _ = run.codes
    assert caught.value.hint == "restore it from a copy"


def test_patterns_that_fit_no_window_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    odd = np.zeros((2, 50), np.float64)
    run = shown(monkeypatch, [("coded", "whole")], **{"coded.primal": odd, "coded.dual": odd})
    assert run.codes["coded"].projector.shape == (0, 2, 3)
    assert run.codes["coded"].mask.dtype == np.bool_


def small(image: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    data = html._small("a", cv2.imencode(".png", image)[1].tobytes())
    assert data.startswith(b"\xff\xd8")  # JPEG
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))


@pytest.mark.parametrize(
    ("shape", "wanted"),
    [
        ((480, 640), (240, 320)), ((100, 320), (100, 320)), ((100, 321), (100, 320)),
        ((50, 40), (50, 40)), ((1, 1000), (1, 320)), ((9, 1280), (2, 320)),
    ],
)  # fmt: skip
def test_previews_are_at_most_320_pixels_wide(
    shape: tuple[int, int], wanted: tuple[int, int]
) -> None:
    found = small(np.full((*shape, 3), 100, np.uint8))
    assert found.shape == (*wanted, 3)


def test_a_small_preview_is_made_of_all_pixels() -> None:
    stripes = np.zeros((16, 1280, 3), np.uint8)
    stripes[:, ::4] = 200  # one of the four columns that become one
    assert abs(float(small(stripes).mean()) - 50.0) < 3.0


@pytest.mark.parametrize("data", [b"", b"no picture", b"\x89PNG\r\n\x1a\n" + bytes(40)])
def test_a_preview_that_is_no_picture_is_told_apart(data: bytes) -> None:
    with pytest.raises(DecodeError, match=r"a is (no picture|damaged)"):
        html._small("a", data)


def test_the_answer_of_a_run_is_shown_in_so_many_pictures(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(Run, "checked", lambda self, name: tmp_path / Path(name).name)
    monkeypatch.setattr(html, "_small", lambda name, content: content)
    names = ("preview/a.png", "preview/b.png", "preview/transport.png", "preview/odd.png",
             "preview/c.jpg", "views/d.png")  # fmt: skip
    run: Any = run_of(summary={"picture": "b"}, files=files(*names))
    run.pictures = dict.fromkeys("abcd")
    for name in ("a", "b", "transport"):
        (tmp_path / f"{name}.png").write_text(name)
    shown = run._repr_html_()
    found = re.findall(r'<img src="data:image/jpeg;base64,([^"]*)" alt="(\w+)" title="(\w+)"'
                       r' width="320">', shown)  # fmt: skip
    assert found == [
        (base64.b64encode(name.encode()).decode(), name, name) for name in ("b", "a", "transport")
    ]
    assert shown.startswith("<div><p><b>white</b> <code>j</code></p><p><img ")


def test_what_is_to_be_known_of_a_run_is_listed_in_order() -> None:
    quality = Quality(verdict="doubtful", reasons=("r",), remarks=("<m>",))
    summary: Any = {
        "quality": quality,
        "codes": 8,
        "parts": 2,
        "rms_sigma": 0.5,
        "rms_error_quads": 0.012345,
        "exposure_s": 1.23456,
        "missed_refreshes": 0,
    }
    shown = run_of(summary=summary, folder=Path("/elsewhere/j"))._repr_html_()
    assert "<ul><li>r</li><li>&lt;m&gt;</li><li>&lt;w&gt;</li></ul></div>" in shown
    rows = (("codes", "8"), ("parts", "2"), ("exposure", "1.23 s"), ("RMS sigma", "50 %"),
            ("RMS error of quads", "1.23 %"), ("folder", "/elsewhere/j"))  # fmt: skip
    body = "".join(f"<tr><td>{name}</td><td>{value}</td></tr>" for name, value in rows)
    assert f"<th>verdict</th><th>doubtful</th></tr></thead><tbody>{body}</tbody>" in shown
    bare: Any = run_of(folder=Path("/elsewhere/j"))
    bare.manifest.warnings = ()
    assert "<ul>" not in bare._repr_html_() and "<th>good</th>" in bare._repr_html_()
