# SPDX-License-Identifier: Apache-2.0
"""The first signal stops a command, where it does no harm; those after it change nothing."""

from __future__ import annotations

import os
import signal

import pytest

from imgu_ros.stop_signals import HeldExitStack, Stopped, held, requested, stop_signals


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_first_signal_is_raised_and_no_other(number: int) -> None:
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt) as stopped, stop_signals():
        try:
            os.kill(os.getpid(), number)
        finally:
            os.kill(os.getpid(), signal.SIGTERM)
            assert requested() == number
    assert isinstance(stopped.value, Stopped)
    assert stopped.value.number == number
    assert signal.getsignal(number) == before


def test_a_signal_waits_for_the_end_of_what_is_held() -> None:
    done = []
    with pytest.raises(Stopped), stop_signals():
        with held():
            with held():
                os.kill(os.getpid(), signal.SIGTERM)
                done.append(1)
            done.append(2)
        done.append(3)
    assert done == [1, 2]


def test_a_clean_up_is_not_interrupted() -> None:
    done = []
    with pytest.raises(Stopped), stop_signals(), HeldExitStack() as stack:
        stack.callback(done.append, 2)
        stack.callback(lambda: (os.kill(os.getpid(), signal.SIGTERM), done.append(1)))
    assert done == [1, 2]


def test_what_was_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stop_signals():
            os.kill(os.getpid(), signal.SIGHUP)
            assert not requested()
    finally:
        signal.signal(signal.SIGHUP, before)
