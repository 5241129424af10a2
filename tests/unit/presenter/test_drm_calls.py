"""Layouts and numbers of the kernel's calls, and the seam on files that are no cards."""

from __future__ import annotations

import ctypes
import errno
import os
from pathlib import Path

import pytest

from pdcd.presenter import drm_calls
from pdcd.presenter.drm_calls import Linux
from tests import fake_drm

# Bytes, and offsets of what is used: a C compiler's sizeof and offsetof on libdrm 2.4.114's drm.h.
LAYOUTS: list[tuple[type[ctypes.Structure], int, dict[str, int]]] = [
    (drm_calls.GetSequence, 24, {"crtc_id": 0, "active": 4, "sequence": 8, "sequence_ns": 16}),
    (drm_calls.QueueSequence, 24, {"crtc_id": 0, "flags": 4, "sequence": 8, "user_data": 16}),
    (
        drm_calls.SequenceEvent,
        32,
        {"type": 0, "length": 4, "user_data": 8, "time_ns": 16, "sequence": 24},
    ),
    (drm_calls.ModeInfo, 68, {"hdisplay": 4, "vdisplay": 14}),
    (drm_calls.GetResources, 64, {"connector_id_ptr": 16, "count_connectors": 40}),
    (drm_calls.GetCrtc, 104, {"crtc_id": 12, "mode_valid": 32, "mode": 36}),
    (drm_calls.GetEncoder, 20, {"encoder_id": 0, "crtc_id": 8}),
    (
        drm_calls.GetConnector,
        80,
        {
            "modes_ptr": 8, "props_ptr": 16, "prop_values_ptr": 24, "count_modes": 32,
            "count_props": 36, "encoder_id": 44, "connector_id": 48, "connection": 60,
        },
    ),
    (drm_calls.GetProperty, 64, {"prop_id": 16, "name": 24}),
    (drm_calls.GetBlob, 16, {"blob_id": 0, "length": 4, "data": 8}),
]  # fmt: skip


@pytest.mark.parametrize(("layout", "size", "offsets"), LAYOUTS)
def test_layouts_are_those_of_the_header(
    layout: type[ctypes.Structure], size: int, offsets: dict[str, int]
) -> None:
    assert ctypes.sizeof(layout) == size
    assert {name: getattr(layout, name).offset for name in offsets} == offsets


# As the same compiler printed them.
NUMBERS = {
    "DROP_MASTER": 0x641F,
    "GET_SEQUENCE": 0xC018643B,
    "QUEUE_SEQUENCE": 0xC018643C,
    "GET_RESOURCES": 0xC04064A0,
    "GET_CRTC": 0xC06864A1,
    "GET_ENCODER": 0xC01464A6,
    "GET_CONNECTOR": 0xC05064A7,
    "GET_PROPERTY": 0xC04064AA,
    "GET_BLOB": 0xC01064AC,
}


@pytest.mark.parametrize(("name", "number"), NUMBERS.items())
def test_request_numbers_are_those_of_the_header(name: str, number: int) -> None:
    assert getattr(drm_calls, name) == number
    assert getattr(fake_drm, name) == number


def test_a_file_that_is_no_card_refuses_the_call() -> None:
    linux = Linux()
    fd = linux.open(os.devnull)
    try:
        with pytest.raises(OSError) as caught:
            linux.call(fd, drm_calls.GET_SEQUENCE, drm_calls.GetSequence(crtc_id=1))
        assert caught.value.errno == errno.ENOTTY
        with pytest.raises(OSError):
            linux.call(fd, drm_calls.DROP_MASTER)
    finally:
        linux.close(fd)


def test_reading_waits_no_longer_than_asked() -> None:
    out, into = os.pipe()
    os.set_blocking(out, False)
    try:
        assert Linux().read(out, 0.01) == b""
        os.write(into, b"event")
        assert Linux().read(out, 5.0) == b"event"
    finally:
        os.close(into)
        Linux().close(out)


def test_nodes_are_cards_and_no_renderers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drm_calls, "FOLDER", tmp_path / "dri")
    assert Linux().nodes() == ()
    (tmp_path / "dri").mkdir()
    for name in ("card1", "card0", "renderD128", "by-path"):
        (tmp_path / "dri" / name).touch()
    assert [Path(node).name for node in Linux().nodes()] == ["card0", "card1"]
