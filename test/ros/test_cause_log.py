# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from imgu_ros.ros.causes import Cause, CauseKind, CauseLog

NOBODY = Cause(CauseKind.NO_PUBLISHER, "no publisher on /a")
IDLE = Cause(CauseKind.IDLE, "idle")
UNSEEN = Cause(CauseKind.NOT_SEEN, "target not seen: best so far 3")


def test_each_cause_is_news_once_and_again_after_a_minute_without_it():
    log = CauseLog()
    assert list(log.news([NOBODY, IDLE], 0.0)) == [NOBODY]
    assert list(log.news([NOBODY, UNSEEN], 0.5)) == [UNSEEN]
    # It lasts, with other figures.
    for second in range(1, 200):
        assert not list(log.news([NOBODY, Cause(CauseKind.NOT_SEEN, f"best so far {second}")], float(second)))
    assert not list(log.news([], 230.0))
    assert not list(log.news([NOBODY], 250.0))
    assert list(log.news([NOBODY], 320.0)) == [NOBODY]
    log.clear()
    assert list(log.news([NOBODY], 320.5)) == [NOBODY]


def test_cases_of_one_kind_are_told_apart():
    log = CauseLog()
    zero, falling = (Cause(CauseKind.STAMPS, text, case=text) for text in ("are 0", "fall"))
    assert list(log.news([zero], 0.0)) == [zero]
    assert list(log.news([zero, falling], 1.0)) == [falling]
    assert not list(log.news([zero, falling], 2.0))
