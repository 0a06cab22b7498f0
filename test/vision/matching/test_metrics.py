# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import itertools

import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.vision.descriptors.describe import empty_descriptors
from imgu_ros.vision.matching.metrics import Metric, metric_for, metric_of_rows, metrics_of
from imgu_ros.vision.methods import DESCRIPTORS

SENSIBLE = {
    "orb": {"hamming"},
    "brief": {"hamming"},
    "sift": {"euclidean", "cosine"},
    "rootsift": {"euclidean", "cosine"},
    "patch": {"ssd", "zmssd", "ncc"},
}


@pytest.mark.parametrize(("kind", "metric"), list(itertools.product(DESCRIPTORS, Metric)))
def test_sensible_pairs_pass_and_others_are_refused_with_the_reason(kind, metric):
    if metric == "auto":
        assert metric_for(kind, metric) == metrics_of(kind)[0]
    elif metric in SENSIBLE[kind]:
        assert metric_for(kind, metric) is metric
    else:
        with pytest.raises(ShapeError, match=rf"^metric {metric}: {kind} is [^\n]+; need .*{metrics_of(kind)[0]}"):
            metric_for(kind, metric)


@pytest.mark.parametrize("kind", list(DESCRIPTORS))
def test_sensible_metrics_fit_the_rows(kind):
    assert set(metrics_of(kind)) == SENSIBLE[kind]
    for metric in metrics_of(kind):
        assert metric_of_rows(empty_descriptors(kind), metric) is metric


def test_auto_of_rows():
    assert metric_of_rows(np.zeros((1, 4), np.uint8)) is Metric.HAMMING
    assert metric_of_rows(np.zeros((1, 4), np.float32)) is Metric.EUCLIDEAN


def test_unknown_names_are_refused():
    for call in (lambda: metrics_of("surf"), lambda: metric_for("orb", "l1"), lambda: metric_for("surf")):
        with pytest.raises(ShapeError, match="need one of"):
            call()
