# SPDX-License-Identifier: Apache-2.0
"""Picture files as a recording: one image topic, with times from the files' names, from Exif, or evenly spaced."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

from imgu_ros.bags.frame_files import FRAME_CHANNEL, FRAME_ID, UnreadableFrame, frame_message
from imgu_ros.bags.messages import make_message
from imgu_ros.bags.storage import Channel, MessageBlock, RawMessage, WarningLog
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError, EncodingError, FileError
from imgu_ros.image_files.images import read_image_file
from imgu_ros.messages.encodings import encoding_for
from imgu_ros.messages.header import Header, header_message

#: Pictures a second when neither their names nor Exif nor `rate_hz` says more.
_USUAL_RATE_HZ = 30.0
_SECOND = 10**9
#: The seconds of a message's stamp have 31 bits.
_MOST_NS = 2**31 * _SECOND
#: A time since 1970 in a name: in ns, us or ms by its number of digits, or in seconds with a fraction (years 2001 on).
_STAMP = re.compile(r"(?<!\d)(?:\d{19}|\d{16}|\d{13}|(\d{10})[._](\d{1,9}))(?!\d)")
#: As phones and cameras name pictures: `PXL_20240131_120000123.jpg`, `IMG_20240131_120000.jpg`.
_DATE = re.compile(r"(?<!\d)((?:19|20)\d{6})[-_T]?(\d{6})(\d{0,3})(?!\d)")
_EXIF_IFD, _TAKEN, _FRACTION, _ZONE = 0x8769, 0x9003, 0x9291, 0x9011


class PictureStorage:
    """Picture files as a storage of the image topic.

    Parameters
    ----------
    paths : the files, in order
    rate_hz : pictures a second; 0: times from the names (since 1970: `1403636579763555584.png` in ns, us or ms,
        `1305031102.175304.png` in s), else those of Exif, else 30 a second; these must be there in all, and rise
    warnings : takes what is odd about files
    limits : what decoding may cost

    Raises
    ------
    BagError
        If `rate_hz` is not 0 or more.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        rate_hz: float,
        warnings: WarningLog,
        limits: LimitsParameters = DEFAULT_LIMITS,
    ) -> None:
        if not 0 <= rate_hz <= 1e6:
            raise BagError(f"rate: {rate_hz:g} Hz; need more than 0, at most 1e6")
        self._paths, self._warnings, self._limits = tuple(paths), warnings, limits
        self._times_ns = _times_ns(self._paths, rate_hz, warnings)
        self.counts: dict[Channel, int] = {FRAME_CHANNEL: len(self._paths)}
        self.start_ns, self.end_ns = self._times_ns[0], self._times_ns[-1]

    def parts(self, topics: Collection[str] | None) -> Iterator[MessageBlock]:
        """Yield one part: all pictures."""
        if topics is None or FRAME_CHANNEL.topic in topics:
            yield MessageBlock(self.start_ns, self._messages)

    def close(self) -> None:
        """Do nothing: each file is open only while it is read."""

    def _messages(self) -> Iterator[RawMessage]:
        for path, time_ns in zip(self._paths, self._times_ns, strict=True):
            try:
                file = read_image_file(path, limits=self._limits)
                for note in file.notes:
                    self._warnings.add(f"{path}: {note}", note)
                channels = 1 if file.pixels.ndim == 2 else file.pixels.shape[2]
                message = frame_message(time_ns, file.pixels, encoding_for(file.pixels.dtype, channels))
            except (FileError, EncodingError) as error:
                why = str(error).removeprefix(f"{path}: ")
                header = header_message(make_message, Header(time_ns, FRAME_ID))
                message = UnreadableFrame(header, f"{path.name}: {why}")
            yield RawMessage(FRAME_CHANNEL, time_ns, b"", message)


def _times_ns(paths: Sequence[Path], rate_hz: float, warnings: WarningLog) -> tuple[int, ...]:
    if not rate_hz:
        for times in (_of_names, _of_exif):
            found = times(paths)
            if found is not None:
                return found
        if len(paths) > 1:
            warnings.add(
                f"{paths[0].parent or '.'}: neither names nor Exif of the pictures tell when they were taken: "
                f"{_USUAL_RATE_HZ:g} a second; set --rate"
            )
    step = _SECOND / (rate_hz or _USUAL_RATE_HZ)
    return tuple(round(index * step) for index in range(len(paths)))


def _of_names(paths: Sequence[Path]) -> tuple[int, ...] | None:
    return _rising(map(_named_ns, paths))


def _named_ns(path: Path) -> int | None:
    date = _DATE.search(path.name)
    if date is not None:
        try:
            whole = datetime.strptime(date[1] + date[2], "%Y%m%d%H%M%S").replace(tzinfo=UTC)
        except ValueError:
            return None
        return int(whole.timestamp()) * _SECOND + int(date[3].ljust(9, "0"))
    stamp = _STAMP.search(path.name)
    if stamp is None:
        return None
    if stamp[1]:
        return int(stamp[1]) * _SECOND + int(stamp[2].ljust(9, "0"))
    return int(stamp[0].ljust(19, "0"))


def _of_exif(paths: Sequence[Path]) -> tuple[int, ...] | None:
    return _rising(map(_exif_ns, paths))


def _exif_ns(path: Path) -> int | None:
    """Return DateTimeOriginal with its fraction (Exif 2.32, 4.6.5); without a time zone it counts as UTC."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as picture:
            tags = picture.getexif().get_ifd(_EXIF_IFD)
        zone = str(tags.get(_ZONE, "+00:00")).strip("\0 ") or "+00:00"
        text = f"{str(tags[_TAKEN]).strip(chr(0) + ' ')}{zone}"
        whole = datetime.strptime(text, "%Y:%m:%d %H:%M:%S%z").astimezone(UTC)
        fraction = str(tags.get(_FRACTION, "")).strip("\0 ")
        return int(whole.timestamp()) * _SECOND + int(fraction[:9].ljust(9, "0") if fraction.isdigit() else 0)
    # Damaged tags of any kind count as missing.
    except (OSError, UnidentifiedImageError, KeyError, ValueError, TypeError, SyntaxError, OverflowError):
        return None
    except Image.DecompressionBombError:
        return None


def _rising(times: Iterator[int | None]) -> tuple[int, ...] | None:
    """Return the times, if all are known and each is later than the one before."""
    found: list[int] = []
    for time_ns in times:
        if time_ns is None or not 0 <= time_ns < _MOST_NS or (found and time_ns <= found[-1]):
            return None
        found.append(time_ns)
    return tuple(found)
