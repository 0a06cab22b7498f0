# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from imgu_ros.ros.meters import LatencyMeter, RateMeter


def test_the_rate_is_that_of_the_window():
    meter = RateMeter(window_s=2.0)
    assert meter.rate_hz(0.0) == 0.0
    for time_s in np.arange(0, 10, 0.1):
        meter.tick(float(time_s))
    assert meter.rate_hz(9.9) == pytest.approx(10.0)
    for time_s in np.arange(10, 14, 0.5):
        meter.tick(float(time_s))
    assert meter.rate_hz(13.5) == pytest.approx(2.0)
    assert meter.rate_hz(30.0) == 0.0
    assert meter.count == 108


def test_percentiles_are_of_the_last_values():
    meter = LatencyMeter(size=100)
    assert meter.percentiles_ms() == []
    for value in range(1000):
        meter.add(value / 1000)
    assert meter.percentiles_ms((0, 50, 100)) == pytest.approx([900.0, 949.5, 999.0])


def test_events_at_once_count_each():
    meter = RateMeter(window_s=2.0)
    meter.tick(1.0, 5)
    meter.tick(2.0)
    assert (meter.count, meter.recent(2.5), meter.recent(3.5), meter.recent(9.0)) == (6, 6, 1, 0)
    meter.tick(10.0, 10**9)
    assert meter.count == 10**9 + 6
    assert meter.recent(10.0) == 1000
