# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from imgu_ros.replay.statistics import ReasonCounts


def test_reasons_that_differ_in_numbers_count_as_one() -> None:
    reasons = ReasonCounts()
    assert reasons.add("lost", "7 inliers; need 12")
    assert not reasons.add("lost", "9 inliers; need 12")
    assert reasons.add("degenerate", "7 inliers; need 12")
    assert [(r.status, r.reason, r.count) for r in reasons.counted()] == [
        ("lost", "7 inliers; need 12", 2),
        ("degenerate", "7 inliers; need 12", 1),
    ]


def test_bounded() -> None:
    reasons = ReasonCounts()
    for i in range(500):
        reasons.add("rejected", "x" * i)
    counted = reasons.counted()
    assert len(counted) <= 102
    assert sum(reason.count for reason in counted) == 500
