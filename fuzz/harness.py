# SPDX-License-Identifier: Apache-2.0
"""Read one case as users would, and judge what came of it: `fuzz_one`."""

from __future__ import annotations

import os
import re
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import cv2
import numpy as np

from fuzz.kinds import CAMERA, PARAMETERS, PICTURE, RECORDING
from fuzz.messages import recorded
from fuzz.scan import Identity, Messages, identity, scanned, unpacked_identity
from imgu_ros.bags.reading import open_bag
from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.parameters import Parameters, TargetsParameters
from imgu_ros.errors import ImguError
from imgu_ros.files.camera_info_file import read_camera_info, read_description
from imgu_ros.files.target_images import load_target_images
from imgu_ros.image_files.images import read_image_file
from imgu_ros.messages.compressed_image import decode_compressed_image
from imgu_ros.replay.replay import replay
from imgu_ros.shown_text import shown

#: Characters that a terminal acts upon; a line of a message is one line.
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")
#: A refusal by a declared bound.
_LIMIT = "(limits."


@dataclass(slots=True)
class Verdict:
    """What came of a case.

    Attributes
    ----------
    failures : invariants that do not hold, a line each, the invariant's name first; empty: all hold
    read : it could be read, at least in part
    limited : a bound of `limits` refused some of it
    messages : of a recording, as it was read
    said : errors, warnings and remarks
    details : a traceback
    """

    failures: list[str] = field(default_factory=list)
    read: bool = False
    limited: bool = False
    messages: int = 0
    said: list[str] = field(default_factory=list)
    details: str = ""


@dataclass(slots=True)
class Reading:
    """What a reader gave: the messages as recorded, those with what they decode to, and all it says."""

    raw: Messages = field(default_factory=Messages)
    said: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    pristine: Counter[tuple[str, int]] = field(default_factory=Counter)
    decoded: Counter[tuple[str, int]] = field(default_factory=Counter)
    promised: int = 0


def fuzz_one(reader: str, path: Path, deep: bool = False) -> tuple[Verdict, Callable[[], None]]:
    """Read a case.

    Parameters
    ----------
    reader : RECORDING, PICTURE, CAMERA or PARAMETERS
    path : what is opened
    deep : also run the whole command on it

    Returns
    -------
    the verdict, and what completes it by the independent scan, whose memory is not the reader's
    """
    verdict, reading = Verdict(), Reading()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        steps = [_STEPS[reader], *([_DEEP[reader]] if deep and reader in _DEEP else [])]
        for step in steps:
            try:
                step(path, reading)
                verdict.read = True
            except ImguError as error:
                reading.said.append(str(error))
                reading.errors.append(str(error))
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt):
                    raise
                verdict.failures.append(f"traceback: {type(error).__name__}: {str(error)[:200]!r}")
                verdict.details += traceback.format_exc()
    ours = [w for w in caught if not issubclass(w.category, ResourceWarning | DeprecationWarning)]
    verdict.failures += [
        f"warning: {w.category.__name__}: {w.message} ({Path(w.filename).name}:{w.lineno})" for w in ours[:3]
    ]
    # Warnings are shown by commands and nodes through `shown`; what an error says is safe by itself.
    errors, told = set(reading.errors), [line for line in reading.said if line not in reading.errors]
    lines = [*errors, *map(shown, told)]
    verdict.failures += [f"text: {line[:200]!r}" for line in lines if _CONTROL.search(line)][:3]
    verdict.failures += [f"text: a line of {len(line)} characters" for line in reading.said if len(line) > 5000][:1]
    verdict.limited = any(_LIMIT in line for line in reading.said)
    verdict.messages = reading.raw.total()
    verdict.said = [line[:1000] for line in reading.said]
    return verdict, lambda: _complete(verdict, reading, reader, path)


def _complete(verdict: Verdict, reading: Reading, reader: str, path: Path) -> None:
    """Compare what was read with what is there."""
    if reader != RECORDING:
        return
    # A file that metadata.yaml does not name is no part of the recording; that it is not read is said.
    is_passed_over = any("and not read: " in line for line in reading.said)
    missing = Messages() if verdict.limited or is_passed_over else scanned(path) - reading.raw
    if missing:
        total = missing.total() + reading.raw.total()
        verdict.failures.append(
            f"lost: {missing.total()} messages that a scan finds, {total} in all; said: {reading.said[:3]}"
        )
    undecoded = reading.pristine - reading.decoded
    if undecoded:
        verdict.failures.append(f"undecoded: {undecoded.total()} whole messages; said: {reading.said[:3]}")
    if not reading.said and not reading.promised <= reading.raw.total() <= reading.decoded.total():
        counts = f"{reading.promised} announced, {reading.raw.total()} read, {reading.decoded.total()} decoded"
        verdict.failures.append(f"silent: {counts}, and no warning")


@cache
def _pristine() -> set[tuple[str, str, Identity]]:
    """Return type, definition and identity of the seeds' messages."""
    return {
        (m.type_name, m.definition, unpacked_identity(m.time_ns, m.data)) for ros in (1, 2) for m in recorded(3, ros)
    }


def _read_recording(path: Path, reading: Reading) -> None:
    with open_bag([path]) as bag:
        try:
            reading.promised = bag.message_count
            assert bag.start_ns <= bag.end_ns
            for raw in bag.raw_messages():
                reading.raw[identity(raw.time_ns, raw.data)] += 1
                key = (raw.channel.type_name, raw.channel.schema, unpacked_identity(raw.time_ns, raw.data))
                reading.pristine[raw.channel.topic, raw.time_ns] += key in _pristine() and _serialization_fits(raw)
            for message in bag.messages():
                reading.decoded[message.topic, message.time_ns] += 1
            for _ in bag.cdr_messages():
                pass
        finally:
            reading.said += bag.warnings


def _serialization_fits(raw: object) -> bool:
    channel = raw.channel  # type: ignore[attr-defined]
    return (channel.serialization, channel.schema_format) in (("cdr", "ros2msg"), ("ros1", "ros1msg"))


def _read_picture(path: Path, reading: Reading) -> None:
    content = path.read_bytes() if os.path.isfile(path) else b""
    if content.startswith((b"\xff\xd8\xff", b"\x89PNG")):
        message = SimpleNamespace(format="", data=np.frombuffer(content, np.uint8))
        try:
            reading.said.append(decode_compressed_image(message).remark)
        except ImguError as error:
            reading.said.append(str(error))
    reading.said += read_image_file(path).notes


def _read_target(path: Path, reading: Reading) -> None:
    load_target_images(TargetsParameters(images=(str(path),), widths_m=(0.2,)), reading.said.append)


def _read_camera(path: Path, reading: Reading) -> None:
    try:
        read_description(path)
    except ImguError as error:
        reading.said.append(str(error))
    read_camera_info(path)


def _read_parameters(path: Path, reading: Reading) -> None:
    read_parameter_file(path)


def _replay(path: Path, reading: Reading) -> None:
    with TemporaryDirectory() as folder:
        target = Path(folder) / "target.png"
        target.write_bytes(_target())
        parameters = Parameters(targets=TargetsParameters(images=(str(target),), widths_m=(0.2,)))
        replay([path], Path(folder) / "out", parameters, on_warning=reading.said.append)


@cache
def _target() -> bytes:
    pixels = np.random.default_rng(1).integers(0, 256, (12, 16), dtype=np.uint8)
    return cv2.imencode(".png", cv2.resize(pixels, (320, 240), interpolation=cv2.INTER_NEAREST))[1].tobytes()


_STEPS: dict[str, Callable[[Path, Reading], None]] = {
    RECORDING: _read_recording,
    PICTURE: _read_picture,
    CAMERA: _read_camera,
    PARAMETERS: _read_parameters,
}
_DEEP: dict[str, Callable[[Path, Reading], None]] = {RECORDING: _replay, PICTURE: _read_target}
