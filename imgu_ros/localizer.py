# SPDX-License-Identifier: Apache-2.0
"""The pipeline: one frame in, one result out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from imgu_ros.build_cache import BuildCache
from imgu_ros.camera_memory import CameraMemories, CameraMemory
from imgu_ros.config.components import DetectionParameters, DevelopmentParameters, FeatureParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.detect.bundle_parts import parts_beside
from imgu_ros.detect.copies import PERFECT, require_no_better_copy, still_alike
from imgu_ros.detect.features import Features, find_features
from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.detect.rivals import Rivals
from imgu_ros.errors import EstimationError, ImguError, ParameterError
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import Development, FrameImage, develop_frame
from imgu_ros.pose.map_pose import told_apart
from imgu_ros.pose.planar_pose import distorting_camera
from imgu_ros.reasons import NOT_DUE, UNLIKELY, unusable_frame
from imgu_ros.reference.family import FamilyReference
from imgu_ros.reference.features import extractor_options
from imgu_ros.reference.marker import MarkerReference
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import make_detectors, prepare_references
from imgu_ros.result import ReferenceResult, Result, Stage, StageClock, Status, by_name
from imgu_ros.track.tracker import follow, followed_result
from imgu_ros.vision.camera.rigid import rigid_transforms
from imgu_ros.vision.descriptors.extractor import make_extractor

#: While one reference is tracked, every so many searches for a few missing ones are thorough.
_THOROUGH_EVERY = 6
#: While so many parts are tracked, a search for further markers takes a small part of a frame's time, and more of them
#: come into view. Measured: benchmarks/many_markers.py.
_MANY_MARKERS = 12
#: Observations of a track that is not new.
_NEW = 3


class Localizer:
    """From raw frames to poses of known references.

    Frames are expected in temporal order; where stamps do not rise, frames count as evenly spaced. A backward jump in
    time of more than a second resets what is remembered (a recording played in a loop); a single stamp of 0 among
    others does not. Frames of several cameras, identified by their frame_id, may alternate: each has its own memory.

    Parameters
    ----------
    parameters : all parameters
    references : made with the same parameters, with unique names
    cache : keeps what is computed; what was computed before of the same references is used again
    """

    def __init__(
        self, parameters: Parameters, references: Iterable[Reference], cache: BuildCache | None = None
    ) -> None:
        self._parameters = parameters
        self._development = DevelopmentParameters.of(parameters)
        self._features = FeatureParameters.of(parameters)
        self._cache = BuildCache() if cache is None else cache
        self._cameras = CameraMemories()
        self._extractor = self._cache.make(make_extractor, extractor_options(self._features))
        self._know(references)

    @property
    def references(self) -> tuple[Reference, ...]:
        """The known references."""
        return tuple(self._references.values())

    def add(self, reference: Reference) -> None:
        """Know one more reference, or another one of the same name, from the next frame on; other tracks continue."""
        known = self._references.get(reference.name)
        if known is not None and not reference.has_template_of(known):
            self._cameras.keep(self._parts.keys() - {part.name for part in known.parts})
        self._change([*(each for each in self.references if each.name != reference.name), reference])

    def remove(self, name: str) -> None:
        """Forget a reference; other tracks continue."""
        self._change([each for each in self.references if each.name != name])

    def prepare(self) -> None:
        """Compute what some frame would have to wait for, some tenths of a second for each reference."""
        for detector in self._detectors.values():
            detector.prepare()
        # The frames' encoding is not known yet: raw ones are the likeliest.
        for reference in self.references:
            reference.prepare(linear=self._parameters.raw.transfer != "srgb")

    def reset(self) -> None:
        """Forget everything that earlier frames told."""
        self._cameras = CameraMemories()
        for each in self._families:
            each.forget()
        self._know_parts()

    def continue_from(self, before: Localizer) -> None:
        """Take over what another localizer remembers; tracks of references with the same name and template continue.

        Tracks are in template px, whatever the references' widths and all parameters are. The calibration check
        continues until the camera changes.
        """
        for each in self._families:
            each.take_over(before._references.get(each.name))
        self._know_parts()
        self._cameras = before._cameras.copy()
        known = before._parts
        same = {name for name, each in self._parts.items() if name in known and each.has_template_of(known[name])}
        self._cameras.keep(same if self._parameters.tracking.enabled else set())

    def process(self, frame: Frame, with_keypoints: bool = False, development: Development | None = None) -> Result:
        """Process one frame: develop it, follow tracks, detect missing references, estimate poses, update the tracks.

        A frame that cannot be used is rejected in the result, with the reason; nothing is raised for it.

        Parameters
        ----------
        frame : the frame
        with_keypoints : detect keypoints even when all references are tracked without them
        development : of this frame, with the same parameters, when it was made ahead (see `develop_frame`)
        """
        memory = self._cameras.of(frame.frame_id, frame.stamp_ns)
        time_ns = memory.time_of(frame.stamp_ns)
        context = FrameContext(frame, development or develop_frame(frame, self._development), self._extract)
        try:
            image = context.image
            if image.may_have_curve:
                image.curve = memory.transfer.curve
            image.row_time_ns = 1000 * self._parameters.camera.row_time_us
            results = self._follow(context, memory, time_ns)
            missing = [
                part
                for each in self.references
                if not any(part.name in results for part in each.parts)
                for part in each.parts
            ]
            if self._families:
                missing = [part for each in self.references for part in each.sought(results)]
            is_due = self._search_is_due(memory, missing, len(results))
            if is_due:
                results |= self._detect(context, memory, missing, results.values())
                if self._families:
                    results = self._with_members(results)
            results |= self._beside(context, results)
            results = self._rivals.settled(context, results, is_due)
            features = context.features if with_keypoints else context.computed_features
            if self._places:
                results, turned = told_apart(results, self._planes, self._places, frame.camera)
                memory.forget(turned)
            results = {name: results.get(name) or _lost(each, is_due) for name, each in self._parts.items()}
            self._remember(memory, results, time_ns)
            memory.frames_without_search = 0 if is_due or not missing else memory.frames_without_search + 1
            results = (
                self._combined(results, frame)
                if self._families
                else {each.name: each.combined(results, frame) for each in self.references}
            )
            results = memory.calibration.examined(frame.camera, results)
        except ImguError as error:
            return context.timed(rejected(frame, self.references, str(error)))
        return context.timed(
            Result(
                frame,
                results,
                developed=image,
                pyramid=features.pyramid if features else None,
                keypoints=features.described.keypoints if features else None,
                descriptors=features.described.descriptors if features else None,
                calibration=None if frame.camera is None else memory.calibration.finding,
                transfer=memory.transfer.curve.kind if memory.transfer.is_settled and memory.transfer.curve else None,
            )
        )

    def _extract(self, image: FrameImage, clock: StageClock) -> Features:
        return find_features(image, self._features, self._extractor, clock)

    def _change(self, references: Iterable[Reference]) -> None:
        """Know other references; what was computed for those that are gone is let go."""
        self._cache = BuildCache(self._cache)
        self._know(references)
        self._cache.settle()

    def _know(self, references: Iterable[Reference]) -> None:
        references = tuple(references)
        self._references = {reference.name: reference for reference in references}
        if len(self._references) < len(references):
            names = ", ".join(reference.name for reference in references)
            raise ParameterError(f"references: {names}; need unique names")
        self._families = [each for each in references if isinstance(each, FamilyReference)]
        sought = tuple(part for reference in references for part in reference.sought(()))
        self._detectors = make_detectors(sought, self._parameters, self._cache)
        self._rivals = Rivals((), DetectionParameters.of(self._parameters))
        self._know_parts()

    def _know_parts(self) -> None:
        references = self.references
        self._parts = {part.name: part for reference in references for part in reference.parts}
        self._planes = {name: part.plane for name, part in self._parts.items()}
        poses = rigid_transforms(self._parameters.targets.poses, "targets.poses")
        # A reference has the place of its number in the lists.
        self._places = {
            part.name: poses[each.number].after(each.place_of(part.name))
            for each in references
            for part in each.parts
            if each.number < len(poses)
        }
        self._rivals.know(self._parts)
        self._cameras.keep(self._parts.keys())

    def _follow(self, context: FrameContext, memory: CameraMemory, time_ns: int) -> dict[str, ReferenceResult]:
        """Return the parts of references whose tracks hold, by name."""
        found: dict[str, ReferenceResult] = {}
        frame, options, fewest = context.frame, self._parameters.refinement, self._parameters.homography.min_inliers
        for name, track in memory.tracks.items():
            reference = self._parts[name]
            try:
                with context.clock.measures(Stage.REFINE):
                    followed = follow(reference, track, context.image, time_ns, frame.camera, options, fewest)
                    # A new track may have begun at the wrong place.
                    if followed.confirmed_share < PERFECT or len(track.observations) < _NEW:
                        lens = distorting_camera(frame.camera)
                        require_no_better_copy(context.image, reference, followed.alignment, lens)
                    if track.alike:
                        located = replace(followed.alignment, alike=track.alike)
                        alike = still_alike(context.image, reference, located, distorting_camera(frame.camera))
                        followed = replace(followed, alignment=replace(located, alike=alike))
            except EstimationError:
                continue
            samples = followed.alignment.samples
            if context.image.may_have_curve and samples is not None and not memory.transfer.is_settled:
                memory.transfer.add(samples())
            with context.clock.measures(Stage.POSE):
                found[name] = reference.pose(
                    followed_result(reference, followed, Status.TRACKED), followed.alignment, frame, memory.calibration
                )
        return found

    def _detect(
        self,
        context: FrameContext,
        memory: CameraMemory,
        missing: Sequence[Reference],
        tracked: Iterable[ReferenceResult],
    ) -> dict[str, ReferenceResult]:
        """Return what became of the parts of references that are missing and were looked for, by name."""
        memory.searches += 1
        thorough = memory.searches % _THOROUGH_EVERY == 0
        covered = [result.outline for result in tracked if result.outline is not None]
        found: dict[str, ReferenceResult] = {}
        for kind, detector in self._detectors.items():
            wanted = [part for part in missing if part.kind == kind]
            if wanted:
                found |= by_name(detector.detect(context, wanted, covered, thorough))
        for samples in context.curve_samples:
            if not memory.transfer.is_settled:
                memory.transfer.add(samples())
        return found

    def _beside(self, context: FrameContext, results: Mapping[str, ReferenceResult]) -> dict[str, ReferenceResult]:
        """Return what else is found of rigid things, where the parts that were found say that it should be, by name."""
        found: dict[str, ReferenceResult] = {}
        for reference in self.references:
            if len(reference.parts) > 1:
                with context.clock.measures(Stage.REFINE):
                    found |= by_name(parts_beside(context, reference, results, self._parameters))
        return found

    def _with_members(self, results: Mapping[str, ReferenceResult]) -> dict[str, ReferenceResult]:
        """Make references of members of families that were seen for the first time; return the results of all parts."""
        changed = [family for family in self._families if family.take(results)]
        if changed:
            self._know_parts()
        return {name: result for name, result in results.items() if name in self._parts}

    def _combined(self, found: Mapping[str, ReferenceResult], frame: Frame) -> dict[str, ReferenceResult]:
        """Return the results of all references, by name, in their order: those of families are several."""
        return by_name(one for each in self.references for one in each.results(found, frame))

    def _search_is_due(self, memory: CameraMemory, missing: Sequence[Reference], tracked: int) -> bool:
        """Return whether to search: at once when a track was just lost or none is left, else now and then.

        Markers are searched for in every frame where many are tracked.
        """
        if not missing:
            return False
        just_lost = any(part.name in memory.tracks for part in missing)
        waited = memory.frames_without_search + 1
        if just_lost or not tracked or waited >= self._parameters.tracking.search_every:
            return True
        return tracked >= _MANY_MARKERS and all(part.kind == MarkerReference.kind for part in missing)

    def _remember(self, memory: CameraMemory, results: Mapping[str, ReferenceResult], time_ns: int) -> None:
        if self._parameters.tracking.enabled:
            for name, result in results.items():
                memory.remember(self._parts[name], result, time_ns)


def rejected(frame: Frame, references: Iterable[Reference], reason: str) -> Result:
    """Return the result of a frame that cannot be used, for `reason`."""
    words = unusable_frame(reason)
    shown = (one for each in references for one in each.shown)
    results = (ReferenceResult(each.name, each.number, Status.REJECTED, reason=words) for each in shown)
    return Result(frame, by_name(results), reason=reason)


def _lost(reference: Reference, is_due: bool) -> ReferenceResult:
    return ReferenceResult(reference.name, reference.number, Status.LOST, reason=UNLIKELY if is_due else NOT_DUE)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedLocalizer:
    """A localizer that is ready for its first frame, and what it was made of.

    Attributes
    ----------
    localizer : as made
    images, parameters : of these
    cache : what a localizer with other parameters can use again
    """

    localizer: Localizer
    images: tuple[TargetImage, ...]
    parameters: Parameters
    cache: BuildCache

    @property
    def references(self) -> tuple[Reference, ...]:
        """The known references."""
        return self.localizer.references


def prepare_localizer(
    images: Iterable[TargetImage], parameters: Parameters, before: PreparedLocalizer | None = None
) -> PreparedLocalizer:
    """Return a localizer that is ready for its first frame.

    Parameters
    ----------
    images : of the references
    parameters : all parameters
    before : what was computed for it of the same images and equal values is used again

    Raises
    ------
    ImguError
        If an image cannot serve as a target.
    """
    images = tuple(images)
    cache = BuildCache(None if before is None else before.cache)
    localizer = Localizer(parameters, prepare_references(images, parameters, cache), cache)
    # Now, before frames come: later the first thorough search would delay them.
    localizer.prepare()
    cache.settle()
    return PreparedLocalizer(localizer, images, parameters, cache)
