# SPDX-License-Identifier: Apache-2.0
"""What decoding a picture file costs, from what its structure says, and the refusal of what costs too much."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import EncodingError

#: Pixels that as much time is spent on as on one part (segment, chunk, strip) of a file, whatever it holds.
PART_PX = 10_000


class FileKind(StrEnum):
    """Picture files that a CompressedImage may hold."""

    JPEG = "jpeg"
    PNG = "png"


@dataclass(frozen=True, slots=True)
class PictureFile:
    """What the structure of a file tells.

    Attributes
    ----------
    kind : name of the format, for people
    width, height : of the picture, px
    channels, value_bytes : that the decoder gives, at most
    size : bytes of the file
    has_end : the end marker is there; a JPEG without one may be cut, or lack only that
    working_bytes : that the decoder takes beside file and picture
    passes_px : pixels that it goes over
    """

    kind: str
    width: int
    height: int
    channels: int
    value_bytes: int
    size: int
    has_end: bool = True
    working_bytes: int = 0
    passes_px: int = 0

    @property
    def memory_bytes(self) -> int:
        """The memory that decoding takes at its peak.

        The picture exists twice when OpenCV hands it to numpy, and when it is composed or turned; a file without an
        end is decoded twice, from two copies of its bytes.
        """
        picture = self.width * self.height * self.channels * self.value_bytes
        if self.has_end:
            return self.size + picture + max(picture, self.working_bytes)
        return 3 * self.size + 2 * picture + max(picture, self.working_bytes)


def check_cost(file: PictureFile, limits: LimitsParameters, pixel_bytes: int = 0) -> None:
    """Raise EncodingError when a picture is none, or costs more than the limits allow.

    Parameters
    ----------
    file : what its structure tells
    limits : what it may cost
    pixel_bytes : bytes that the caller will need for each pixel
    """
    pixels = file.width * file.height
    said = f"{file.width} x {file.height} px"
    if pixels <= 0:
        raise EncodingError(f"{said}; need at least 1 x 1")
    check_memory(max(file.memory_bytes, pixels * pixel_bytes), f"{file.kind.upper()} of {said}", limits)
    check_passes(max(file.passes_px, pixels), f"{file.kind.upper()} of {said}", limits)


def check_memory(needed: int, what: str, limits: LimitsParameters) -> None:
    """Raise EncodingError when `needed` bytes are more than a picture may take; `what` needs them."""
    if needed > limits.picture_mb * 1_000_000:
        need = f"need at most {limits.picture_mb} (limits.picture_mb)"
        raise EncodingError(f"{what}: needs {-(-needed // 1_000_000)} MB; {need}")


def check_passes(passes_px: int, what: str, limits: LimitsParameters) -> None:
    """Raise EncodingError when the pixels that are gone over are more than a picture may have; `what` has them."""
    if passes_px > limits.picture_megapixels * 1_000_000:
        need = f"need at most {limits.picture_megapixels} (limits.picture_megapixels)"
        raise EncodingError(f"{what}: {-(-passes_px // 1_000_000)} megapixels with all its passes; {need}")
