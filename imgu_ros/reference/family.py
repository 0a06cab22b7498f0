# SPDX-License-Identifier: Apache-2.0
"""All markers of a family: each id becomes a reference of its own when it is seen for the first time."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import ReferenceParameters
from imgu_ros.frame import Frame
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.pose.planar_pose import Located
from imgu_ros.reasons import NOT_IN_VIEW
from imgu_ros.reference.marker import MarkerImage, MarkerReference, marker_image, marker_reference
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.self_similarity import Copy
from imgu_ros.reference.templates import TargetImage
from imgu_ros.result import ReferenceResult, Status
from imgu_ros.vision.markers import marker_count, marker_distance

#: Most ids that are references at once. Each has a row in every frame, a track, and topics.
MOST_MEMBERS = 256


@dataclass(frozen=True, slots=True, eq=False)
class FamilyImage(TargetImage):
    """What is known of all markers of a family; the picture is that of its first marker.

    Attributes
    ----------
    width_m : of the black square of each; 0: unknown
    first : its first marker
    taken : ids of other targets, which are none of its references
    first_number : the number of id 0, which messages carry; the other ids follow
    """

    kind: ClassVar[str] = "family"

    first: MarkerImage = field(kw_only=True)
    taken: frozenset[int] = field(kw_only=True)
    first_number: int = field(kw_only=True)

    @property
    def family(self) -> str:
        """Name of the family."""
        return self.first.layout.markers[0].family

    def member_name(self, marker: int) -> str:
        """Return the name of the reference of an id."""
        return f"{self.name}_{marker}"

    def has(self, marker: int) -> bool:
        """Return whether an id becomes a reference: it can be told from the others, and belongs to no other target."""
        return marker not in self.taken and marker_distance(self.family, marker) > 0


def family_image(name: str, family: str, width_m: float, taken: frozenset[int], first_number: int) -> FamilyImage:
    """Return what is known of all markers of a family.

    Parameters
    ----------
    name : a reference is named by it and the id, `name_7`
    family : a key of `MARKER_FAMILIES`
    width_m, taken, first_number : see `FamilyImage`

    Raises
    ------
    ShapeError
        If there is no such family, or OpenCV has no aruco module.
    """
    first = marker_image(name, family, 0, width_m)
    return FamilyImage(name, first.pixels, width_m, is_linear=True, first=first, taken=taken, first_number=first_number)


class FamilyReference(Reference):
    """All markers of a family, of which those that were seen are references, its members.

    Parameters
    ----------
    number, image : see `Reference` and `FamilyImage`
    first : the reference of its first marker
    parameters : those of references
    """

    kind = "marker"

    def __init__(
        self, number: int, image: FamilyImage, first: MarkerReference, parameters: ReferenceParameters
    ) -> None:
        super().__init__(image.name, number, first.plane, first.templates, first.light)
        self.image, self.codes = image, first.codes
        self._first, self._parameters = first, parameters
        ids = (marker for marker in range(marker_count(image.family)) if marker not in image.taken)
        self._names = (self.name, *(image.member_name(marker) for marker in ids))
        # By id; the one seen last is the last.
        self._members: dict[int, MarkerReference] = {}
        self._parts: tuple[MarkerReference, ...] = ()

    @property
    def parts(self) -> tuple[MarkerReference, ...]:
        """See `Reference.parts`: its members, by their ids."""
        return self._parts

    @property
    def shown(self) -> tuple[Reference, ...]:
        """See `Reference.shown`: its members; itself as long as there is none."""
        return self._parts or (self,)

    @property
    def names(self) -> tuple[str, ...]:
        """See `Reference.names`: those of all ids, and its own."""
        return self._names

    def sought(self, found: Container[str]) -> tuple[Reference, ...]:
        """See `Reference.sought`: there may always be more of it in view."""
        return (self, *(part for part in self._parts if part.name not in found))

    def unseen(self, marker: int) -> MarkerReference | None:
        """Return the reference of an id that is no member; None where it is one, or must not become one."""
        image = self.image
        if marker in self._members or not image.has(marker):
            return None
        known = marker_image(image.member_name(marker), image.family, marker, image.width_m)
        return marker_reference(known, image.first_number + marker, self._parameters, BuildCache())

    def take(self, found: Mapping[str, ReferenceResult]) -> bool:
        """Make members of ids that were found; return whether members changed.

        Where there are more than `MOST_MEMBERS`, those that were not seen for longest are forgotten.
        """
        before, count = self._parts, marker_count(self.image.family)
        numbers = (result.number - self.image.first_number for result in found.values() if result.status.found)
        seen = sorted(marker for marker in numbers if 0 <= marker < count)
        for marker in seen:
            member = self._members.pop(marker, None) or self.unseen(marker)
            if member is not None:
                self._members[marker] = member
        for marker in list(self._members)[: max(len(self._members) - MOST_MEMBERS, 0)]:
            del self._members[marker]
        return self._set_parts() != before

    def take_over(self, before: Reference | None) -> None:
        """Have the members of another reference of the same family."""
        if isinstance(before, FamilyReference) and before.image.family == self.image.family:
            for marker in before._members:
                member = self.unseen(marker)
                if member is not None:
                    self._members[marker] = member
            self._set_parts()

    def forget(self) -> None:
        """Have no members."""
        self._members = {}
        self._set_parts()

    def _set_parts(self) -> tuple[MarkerReference, ...]:
        # Read by other threads, too: a tuple that never changes.
        self._parts = tuple(self._members[marker] for marker in sorted(self._members))
        return self._parts

    def prepare(self, linear: bool) -> None:
        """See `Reference.prepare`: nothing."""

    def copies(self, linear: bool) -> tuple[Copy, ...]:
        """See `Reference.copies`: the codes tell how a marker is turned."""
        return ()

    def has_template_of(self, other: Reference) -> bool:
        """See `Reference.has_template_of`."""
        return isinstance(other, FamilyReference) and self.image.family == other.image.family

    def pose(
        self, found: ReferenceResult, located: Located, frame: Frame, check: CalibrationCheck | None = None
    ) -> ReferenceResult:
        """See `Reference.pose`: that of a marker of the same size."""
        return self._first.pose(found, located, frame, check)

    def results(self, found: Mapping[str, ReferenceResult], frame: Frame) -> tuple[ReferenceResult, ...]:
        """See `Reference.results`."""
        if self._parts:
            return tuple(found[part.name] for part in self._parts)
        return (ReferenceResult(self.name, self.number, Status.LOST, reason=NOT_IN_VIEW),)


def family_reference(
    image: FamilyImage, number: int, parameters: ReferenceParameters, cache: BuildCache
) -> FamilyReference:
    """Return the reference of a family: a new one each time, because its members are its own.

    Parameters
    ----------
    image, number : of the reference
    parameters : those of references
    cache : keeps what is computed; what was computed before of the same image and equal values is used again
    """
    return FamilyReference(number, image, marker_reference(image.first, number, parameters, cache), parameters)
