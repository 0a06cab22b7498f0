# SPDX-License-Identifier: Apache-2.0
"""The parameters that each component takes are parts of the whole tree, with its names and types."""

from __future__ import annotations

import inspect
from dataclasses import fields, replace
from typing import get_type_hints

import pytest

from imgu_ros.config import components
from imgu_ros.config.components import (
    ComponentParameters,
    DetectionParameters,
    DevelopmentParameters,
    FeatureParameters,
)
from imgu_ros.config.parameters import Parameters, declarations
from imgu_ros.config.values import parameters_from

KINDS = [
    kind
    for _, kind in inspect.getmembers(components, inspect.isclass)
    if issubclass(kind, ComponentParameters) and kind is not ComponentParameters
]


@pytest.mark.parametrize("kind", KINDS)
def test_fields_are_those_of_the_tree(kind: type[ComponentParameters]) -> None:
    whole, part = get_type_hints(Parameters), get_type_hints(kind)
    assert part
    assert part == {name: whole[name] for name in part}


@pytest.mark.parametrize("kind", KINDS)
def test_a_selection_changes_with_its_own_parameters_and_no_others(kind: type[ComponentParameters]) -> None:
    before, names = kind.of(Parameters()), kind.names()
    for known in declarations():
        *groups, leaf = known.name.split(".")
        changed = {leaf: object()}
        for group in groups:
            changed = {group: replace(getattr(Parameters(), group), **changed)}
        assert (kind.of(replace(Parameters(), **changed)) != before) == (known.name in names), known.name


def test_a_detection_is_given_where_features_are_enough() -> None:
    parameters = parameters_from({"keypoints.max_count": 700, "seed": 3})
    detection = DetectionParameters.of(parameters)
    assert isinstance(detection, FeatureParameters)
    assert (detection.keypoints.max_count, detection.seed) == (700, 3)
    assert "seed" in DetectionParameters.names() and "seed" not in FeatureParameters.names()
    assert set(DevelopmentParameters.names()) == {
        known.name for known in declarations() if known.name.startswith(("raw.", "demosaic."))
    }
    assert [field.name for field in fields(DevelopmentParameters)] == ["raw", "demosaic"]
