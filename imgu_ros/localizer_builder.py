# SPDX-License-Identifier: Apache-2.0
"""A chain that is ready for its first frame, made of as much of an earlier one as stays the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.parameters import Parameters
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references


@dataclass(frozen=True, slots=True, eq=False)
class Built:
    """A chain, and what it was made of.

    Attributes
    ----------
    chain, references : what was made
    images, parameters : of these
    parts : what a chain for other parameters can use again
    """

    chain: Localizer
    references: tuple[Reference, ...]
    images: tuple[TargetImage, ...]
    parameters: Parameters
    parts: BuildCache


def build(images: Sequence[TargetImage], parameters: Parameters, before: Built | None = None) -> Built:
    """Make a chain that is ready for its first frame.

    Parameters
    ----------
    images : what is looked for
    parameters : all parameters
    before : its parts are used again where they were made of the same images and equal values

    Raises
    ------
    ImguError
        If an image cannot serve as a target.
    """
    images = tuple(images)
    parts = BuildCache(None if before is None else before.parts)
    references = prepare_references(images, parameters, parts)
    chain = Localizer(parameters, references, parts)
    # Now, before frames come: later the first thorough search would hold them up.
    chain.prepare()
    parts.settle()
    return Built(chain, references, images, parameters, parts)
