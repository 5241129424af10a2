"""Files of a virtual camera that wait for what the panels show."""

from __future__ import annotations

from drivers.virtual_camera.develop import develop_after


def test_a_file_is_made_once_when_nothing_is_waited_for_any_more() -> None:
    waits, made = [True], []

    def make() -> bytes:
        made.append(1)
        return b"file"

    file = develop_after(lambda: waits[0])(make)
    assert not file.done() and not made
    waits[0] = False
    assert file.done() and file.done() and made == [1]
    assert file.result() == b"file"


def test_where_nothing_is_waited_for_it_is_there_at_once() -> None:
    assert develop_after(lambda: False)(lambda: b"file").done()
