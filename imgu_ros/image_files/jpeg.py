# SPDX-License-Identifier: Apache-2.0
"""The structure of a JPEG file (ITU-T T.81 B.1): its size, whether it is whole, and what its scans cost.

What decoders disagree about is refused: a second frame header, markers without a segment, processes that few know.
"""

from __future__ import annotations

import re

from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import EncodingError
from imgu_ros.image_files.cost import PART_PX, FileKind, PictureFile, check_passes

#: A marker inside the compressed scan: not a stuffed byte (ff 00), a fill byte, or a restart (ff d0 to ff d7).
_NEXT_MARKER = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
_START, _START_OF_SCAN, _END, _NUMBER_OF_LINES = 0xD8, 0xDA, 0xD9, 0xDC
#: Start of frame, any process; c4, c8 and cc in the same range mean other things (T.81, table B.1).
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
#: Baseline, extended and progressive DCT, Huffman coded.
_KNOWN_FRAMES = (0xC0, 0xC1, 0xC2)
#: Markers that have no segment: restarts, a second start, and two that nothing uses.
_BARE = frozenset((0x00, 0x01, *range(0xD0, 0xD9)))
#: A scan costs as much as so many pixels, however few it has.
_SCAN_PX = 100_000
#: A scan of few coefficients costs as much as one of so many.
_FEWEST_COEFFICIENTS = 16


def check_jpeg(content: memoryview, limits: LimitsParameters) -> PictureFile:
    """Walk the segments to the end of the image.

    Raises
    ------
    EncodingError
        If the file is cut before its last scan begins, damaged, of a process other than baseline, extended and
        progressive DCT of 8 bits, too small for the picture that it claims to hold, or has too many scans.
    """
    frame: _Frame | None = None
    position, passes_px = 2, 0
    while True:
        # A marker may be preceded by any number of fill bytes ff.
        position = _behind_fill(content, position)
        head = content[position : position + 4]
        if len(head) >= 2 and head[0] == 0xFF and head[1] == _END:
            return _whole(frame, content, passes_px, has_end=True)
        if len(head) < 4:
            raise _cut(content)
        marker, length = head[1], int.from_bytes(head[2:4], "big")
        if head[0] != 0xFF or marker in _BARE or length < 2:
            raise EncodingError(f"no JPEG marker at byte {position}; need an undamaged file")
        segment = content[position + 4 : position + 2 + length]
        if len(segment) < length - 2:
            raise _cut(content)
        position += 2 + length
        passes_px += PART_PX
        if marker in _FRAMES:
            if frame is not None:
                raise EncodingError(f"a second JPEG frame header at byte {position}; need one")
            frame = _Frame(marker, bytes(segment))
        elif marker == _NUMBER_OF_LINES:
            raise EncodingError("a JPEG that says its height at its end; need it in the frame header")
        elif marker == _START_OF_SCAN:
            if frame is None:
                raise EncodingError("a JPEG scan before the frame header; need an undamaged file")
            passes_px += frame.add_scan(bytes(segment))
            check_passes(passes_px, f"JPEG of {frame.scans} scans", limits)
            following = _NEXT_MARKER.search(content, position)
            if following is None and frame.is_complete:
                return _whole(frame, content, passes_px, has_end=False)
            if following is None:
                raise _cut(content)
            position = following.start()


def _behind_fill(content: memoryview, position: int) -> int:
    """Return where a marker begins behind bytes ff that fill up."""
    if bytes(content[position : position + 2]) != b"\xff\xff":
        return position
    found = _NOT_FILL.search(content, position)
    return len(content) if found is None else found.start() - 1


_NOT_FILL = re.compile(rb"[^\xff]")


def _whole(frame: _Frame | None, content: memoryview, passes_px: int, *, has_end: bool) -> PictureFile:
    if frame is None or not frame.scans:
        raise EncodingError(f"a JPEG without {'a frame header' if frame is None else 'a scan'}; need an undamaged file")
    width, height = frame.width, frame.height
    if 8 * len(content) < frame.fewest_bits:  # before the cost: it may be a claim alone
        need = f"need at least {frame.fewest_bits // 8}"
        raise EncodingError(f"JPEG of {width} x {height} px in {len(content)} bytes; {need}")
    channels = 1 if frame.components == 1 else 3
    coefficients = frame.coefficient_bytes if frame.is_buffered else 0
    working = coefficients + _ROWS_BYTES * width
    passes_px += width * height
    return PictureFile(FileKind.JPEG, width, height, channels, 1, len(content), has_end, working, passes_px)


#: Bytes for each column that the decoder's buffers of rows take.
_ROWS_BYTES = 256


class _Frame:
    """A frame header, and which coefficients the scans have brought, by component (T.81 B.2.2, B.2.3, G.1.1.1)."""

    def __init__(self, marker: int, segment: bytes) -> None:
        if marker not in _KNOWN_FRAMES:
            name = "arithmetic coding" if marker > 0xC8 else "lossless or hierarchical coding"
            raise EncodingError(f"JPEG with {name} (marker ff {marker:02x}); need baseline or progressive DCT")
        if len(segment) < 6 or len(segment) != 6 + 3 * segment[5] or segment[5] not in (1, 3, 4):
            raise EncodingError(f"JPEG frame header of {len(segment)} bytes; need one of 1, 3 or 4 components")
        if segment[0] != 8:
            raise EncodingError(f"JPEG of {segment[0]} bits; need 8")
        self.height, self.width = int.from_bytes(segment[1:3], "big"), int.from_bytes(segment[3:5], "big")
        if not self.width or not self.height:
            raise EncodingError(f"{self.width} x {self.height} px; need at least 1 x 1")
        self.components, self.scans = segment[5], 0
        self._is_progressive, self._is_interleaved = marker == 0xC2, False
        samplings = {identity: (of >> 4, of & 15) for identity, of in zip(segment[6::3], segment[7::3], strict=True)}
        if len(samplings) != self.components or not all(1 <= s <= 4 for of in samplings.values() for s in of):
            raise EncodingError(f"JPEG sampling factors {segment[7::3].hex(' ')}; need 1 to 4 of different components")
        across, down = (max(of[axis] for of in samplings.values()) for axis in (0, 1))
        units = -(-self.width // (8 * across)) * -(-self.height // (8 * down))
        self._blocks = {identity: units * of[0] * of[1] for identity, of in samplings.items()}
        self._lowest_bit: dict[int, list[int | None]] = {identity: [None] * 64 for identity in samplings}

    def add_scan(self, segment: bytes) -> int:
        """Take a scan's components, and the bits of which coefficients it brings; return the pixels it goes over."""
        count = segment[0] if segment else 0
        identities = segment[1 : 2 * count + 1 : 2]
        if not 1 <= count <= 4 or len(segment) != 2 * count + 4 or not self._blocks.keys() >= set(identities):
            raise EncodingError("a JPEG scan of components that the frame header does not have; need an undamaged file")
        self.scans += 1
        if self.scans == 1:
            self._is_interleaved = count == self.components
        first, last, bits = segment[2 * count + 1 :]
        if not self._is_progressive:
            first, last, bits = 0, 63, 0
        for identity in identities:
            known = self._lowest_bit[identity]
            known[first : min(last, 63) + 1] = [bits & 15] * max(min(last, 63) + 1 - first, 0)
        coefficients = max(last + 1 - first, _FEWEST_COEFFICIENTS)
        return max(_SCAN_PX, sum(self._blocks[identity] for identity in identities) * coefficients)

    @property
    def is_complete(self) -> bool:
        """Whether every bit of every coefficient has begun to come."""
        return all(bit == 0 for bits in self._lowest_bit.values() for bit in bits)

    @property
    def is_buffered(self) -> bool:
        """Whether the decoder keeps all coefficients, for a picture does not come in one scan."""
        return self._is_progressive or not self._is_interleaved

    @property
    def coefficient_bytes(self) -> int:
        """Memory for all coefficients, of two bytes each."""
        return 128 * sum(self._blocks.values())

    @property
    def fewest_bits(self) -> int:
        """Bits of the smallest file: one for each block of the largest component."""
        return max(self._blocks.values())


def _cut(content: memoryview) -> EncodingError:
    return EncodingError(f"JPEG cut after {len(content)} bytes; need the whole file")
