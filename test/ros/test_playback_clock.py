# SPDX-License-Identifier: Apache-2.0
"""When recorded messages are published: as recorded, and not all at once after a hold-up."""

from __future__ import annotations

import pytest

from imgu_ros.ros.playback_timing import PlaybackClock

PERIOD_S = 0.01
START_NS = 1_600_000_000_000_000_000


class Played:
    """A player without messages; `hold_ups`: before the frame of that number, s."""

    def __init__(self, rate: float, times_s: list[float], hold_ups: dict[int, float] | None = None) -> None:
        self.now = 100.0
        self.at_s: list[float] = []
        self.late_s: list[float] = []
        pace = PlaybackClock(rate, clock=lambda: self.now)
        assert not pace.has_begun
        for index, seconds in enumerate(times_s):
            time_ns = START_NS + round(seconds * 1e9)
            self.now += (hold_ups or {}).get(index, 0.0)
            self.now = max(self.now, pace.earliest(time_ns))
            assert pace.has_begun
            self.late_s.append(pace.published(time_ns))
            self.at_s.append(self.now - 100.0)


@pytest.mark.parametrize("rate", [0.5, 1.0, 3.0])
def test_messages_are_published_as_they_were_recorded(rate):
    times_s = [0.0, 0.0, 0.01, 0.035, 0.035, 0.2]
    played = Played(rate, times_s)
    assert played.at_s == pytest.approx([seconds / rate for seconds in times_s], abs=1e-6)
    assert max(played.late_s) == pytest.approx(0, abs=1e-6)


def test_what_was_held_up_comes_at_twice_the_speed_until_it_is_made_good():
    played = Played(1.0, [PERIOD_S * i for i in range(40)], {10: 0.105})
    gaps = [after - before for before, after in zip(played.at_s, played.at_s[1:], strict=False)]
    assert gaps[9] == pytest.approx(0.105)
    assert played.late_s[10] == pytest.approx(0.095)
    # 95 ms are made good by 5 ms a frame.
    assert gaps[10:29] == pytest.approx([PERIOD_S / 2] * 19, abs=1e-6)
    assert gaps[29:] == pytest.approx([PERIOD_S] * len(gaps[29:]), abs=1e-6)
    assert played.late_s[28] > 0
    assert played.late_s[29:] == pytest.approx([0] * 11, abs=1e-6)


def test_messages_of_one_time_stay_together_when_they_are_late():
    played = Played(1.0, [0.0, 0.0, 0.01, 0.01, 0.02, 0.02], {2: 0.5})
    assert played.at_s == pytest.approx([0, 0, 0.5, 0.5, 0.505, 0.505])


def test_a_time_that_jumps_back_waits_for_nothing():
    played = Played(1.0, [0.0, 0.1, 0.05, 0.1])
    assert played.at_s == pytest.approx([0, 0.1, 0.1, 0.125])
