# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
import signal
import threading
import time

import pytest

from imgu_ros.ros.stopping import StopRequested, StopSignal


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_sets_the_flag_wakes_and_does_not_raise(number):
    before = signal.getsignal(number)
    woken = threading.Event()
    with StopSignal() as stop:
        stop.on_request(woken.set)
        assert not stop.wait(0.01)
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)
        assert woken.wait(2)
        assert stop.requested
        assert stop.wait(0)
        with pytest.raises(StopRequested), stop.interruptible():
            pytest.fail("a phase began after the request")
    assert signal.getsignal(number) is before


def test_a_signal_ends_an_interruptible_phase_at_once():
    with StopSignal() as stop:
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
        started = time.monotonic()
        with pytest.raises(StopRequested), stop.interruptible():
            time.sleep(5)
        assert time.monotonic() - started < 2
        time.sleep(0.05)  # no longer interruptible


def test_what_an_interrupted_import_makes_of_the_signal_is_a_stop_too():
    with pytest.raises(StopRequested), StopSignal() as stop, stop.interruptible():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)
        except StopRequested:
            raise ImportError("librcl.so: initialization failed", name="rclpy") from None


def test_other_errors_of_an_interruptible_phase_stay_what_they_are():
    with pytest.raises(ImportError, match="no rclpy"), StopSignal() as stop, stop.interruptible():
        raise ImportError("no rclpy")


def test_sleeping_is_ended_by_the_signal():
    with StopSignal() as stop:
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
        started = time.monotonic()
        assert stop.wait(5)
        assert time.monotonic() - started < 2


def test_other_signals_do_not_stop():
    previous = signal.signal(signal.SIGUSR1, lambda *_: None)
    try:
        with StopSignal() as stop:
            os.kill(os.getpid(), signal.SIGUSR1)
            assert not stop.wait(0.1)
    finally:
        signal.signal(signal.SIGUSR1, previous)
