"""Interrupts while a job runs: held back, told of, and delivered when it is over."""

from __future__ import annotations

import signal
import threading

import pytest

from pdcd.api.signals import hold_signals


def test_interrupts_are_held_back_and_delivered_after() -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        got: list[int] = []

        def note(came: int, frame: object, got: list[int] = got) -> None:
            got.append(came)

        before = signal.signal(number, note)
        try:
            with hold_signals() as came:
                assert not came()
                signal.raise_signal(number)
                assert came() and got == []
                with pytest.raises(KeyboardInterrupt):
                    signal.raise_signal(number)  # who asks twice does not want to wait
            assert got == [number]
            with hold_signals(delivers=False):
                signal.raise_signal(number)
            assert got == [number]
            with hold_signals(raises=True), pytest.raises(KeyboardInterrupt):
                signal.raise_signal(number)
            assert got == [number] * 2
            with hold_signals():
                pass
            assert got == [number] * 2
        finally:
            signal.signal(number, before)


def test_in_another_thread_nothing_is_held_back() -> None:
    found: list[bool] = []

    def body() -> None:
        with hold_signals() as came:
            found.append(came())

    thread = threading.Thread(target=body)
    thread.start()
    thread.join()
    assert found == [False]


def test_a_terminal_that_closes_is_not_heard_where_it_is_not_to_be() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    try:
        with hold_signals() as came:
            signal.raise_signal(signal.SIGHUP)
            assert not came()
    finally:
        signal.signal(signal.SIGHUP, before)
