# SPDX-License-Identifier: Apache-2.0
"""Results -> messages, with the state that some topics keep; used by the live nodes and by replay."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from imgu_ros.config.components import OutputParameters
from imgu_ros.messages import results
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header
from imgu_ros.messages.output_topic import ConvertedFrame, OutputContext, OutputTopic, Scope
from imgu_ros.messages.status import held_up_message
from imgu_ros.pose.map_pose import map_places
from imgu_ros.result import Result
from imgu_ros.types import Image
from imgu_ros.vision.camera.rigid import rigid_transforms


@dataclass(frozen=True, slots=True, eq=False)
class TopicMessage:
    """A message, and the topics that it is for: a target's own, and that of the first target without a prefix."""

    topics: tuple[str, ...]
    message: Any


class ResultConverter:
    """Makes the messages of a node's or a replay's output topics.

    Parameters
    ----------
    make : makes messages
    draw : draws a result over its image, for `debug_image`
    target_names : in the order of `targets.images`
    parameters : those of the outputs

    Raises
    ------
    ImguError
        If `targets.poses` holds no poses.
    """

    def __init__(
        self,
        make: MessageFactory,
        draw: Callable[[Result], Image],
        target_names: Sequence[str],
        parameters: OutputParameters,
    ) -> None:
        self._make, self._draw = make, draw
        self._states: dict[str, Any] = {}
        self.adapt(target_names, parameters)

    def adapt(self, target_names: Sequence[str], parameters: OutputParameters) -> None:
        """Use other targets or parameters; topics that stay keep their state.

        Raises
        ------
        ImguError
            As at construction; then nothing changes.
        """
        poses = rigid_transforms(parameters.targets.poses, "targets.poses")
        self._places = map_places(target_names, poses)
        self._names, self._parameters = tuple(target_names), parameters

    @property
    def has_map(self) -> bool:
        """Whether the targets' places in the map are known."""
        return bool(self._places)

    def reset(self) -> None:
        """Forget earlier frames: paths restart."""
        self._states.clear()

    def topics(self) -> Mapping[str, OutputTopic]:
        """Return every topic, relative to the node, with its row of the table."""
        found: dict[str, OutputTopic] = {}
        for row in results.OUTPUTS:
            if row.scope is Scope.LEVEL:
                found |= {f"{row.name}{level}": row for level in range(self._parameters.pyramid.levels)}
            elif row.scope is Scope.TARGET:
                found |= {prefix + row.name: row for prefix in ("", *(f"targets/{name}/" for name in self._names))}
            elif row.scope is not Scope.MAP or self._places:
                found[row.name] = row
        return found

    def frame(self, result: Result) -> ConvertedFrame:
        """Return a frame's result as its topics see it."""
        camera = self._parameters.frames.camera
        if camera:
            result = replace(result, frame=replace(result.frame, frame_id=camera))
        return ConvertedFrame(self._make, result, self._parameters, self._places, self._draw)

    def messages(self, frame: ConvertedFrame, is_wanted: Callable[[str], bool]) -> Iterator[TopicMessage]:
        """Yield the messages of a frame for the topics that are wanted.

        Parameters
        ----------
        frame : of `frame`
        is_wanted : tells by a topic's name whether its message is to be made
        """
        for row in results.OUTPUTS:
            if row.scope is Scope.LEVEL:
                for level in range(self._parameters.pyramid.levels):
                    yield from self._made(row, OutputContext(frame, level=level), is_wanted, f"{row.name}{level}")
            elif row.scope is Scope.TARGET:
                for target in frame.result:
                    unprefixed = (row.name,) if target.number == 0 else ()
                    names = (f"targets/{target.name}/{row.name}", *unprefixed)
                    yield from self._made(row, OutputContext(frame, target), is_wanted, *names)
            elif row.scope is not Scope.MAP or self._places:
                yield from self._made(row, OutputContext(frame), is_wanted, row.name)

    def held_up(self, header: Header, text: str) -> Any:
        """Return a message for `status` that says that a frame, of this header, takes long."""
        header = replace(header, frame_id=self._parameters.frames.camera or header.frame_id)
        return held_up_message(self._make, header, self._names, text)

    def _made(
        self, row: OutputTopic, context: OutputContext, is_wanted: Callable[[str], bool], *names: str
    ) -> Iterator[TopicMessage]:
        topics = tuple(name for name in names if is_wanted(name))
        if not topics:
            return
        if row.state is not None:
            if names[0] not in self._states:
                self._states[names[0]] = row.state(self._make)
            context = replace(context, state=self._states[names[0]])
        message = row.message(context)
        if message is not None:
            yield TopicMessage(topics, message)
