# SPDX-License-Identifier: Apache-2.0
"""The errors of the package: one base, one class for each kind of cause; the nearest known name for their messages.

A message gives the name of the thing, what was got, and what is needed, on one line.
"""

import difflib
from collections.abc import Iterable

from imgu_ros.shown_text import shown

#: Names come from outside: of a longer one only the start is compared.
_LONGEST = 80


class ImguError(Exception):
    """Base of every error that this package raises on purpose.

    The names in its message come from outside: it is made fit for terminals and logs, see `shown`.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(shown(message))


class ShapeError(ImguError, ValueError):
    """An array has the wrong shape, data type or content."""


class EncodingError(ImguError, ValueError):
    """Image data do not fit the encoding, size or row length that they claim."""


class ParameterError(ImguError, ValueError):
    """A parameter is unknown, has the wrong type, or lies outside its range."""


class BagError(ImguError):
    """A bag cannot be opened, read or written."""


class FrameError(ImguError):
    """Two coordinate frames are not connected, or not at that time."""


class FileError(ImguError):
    """A file other than a bag cannot be read or written."""


class EstimationError(ImguError):
    """An estimator has no answer for its input; the pipeline turns it into a status."""


class TooFewPoints(EstimationError):
    """Fewer points than the model needs."""


class DegenerateConfiguration(EstimationError):
    """The points do not determine the model (collinear, coincident, mirrored)."""


class NoConsensus(EstimationError):
    """No model agrees with enough of the points.

    Attributes
    ----------
    inliers : the most that agreed with one, where they were counted; else 0
    """

    def __init__(self, message: str = "", inliers: int = 0) -> None:
        super().__init__(message)
        self.inliers = inliers


class NotConfirmed(NoConsensus):
    """What was found does not look as it should.

    Attributes
    ----------
    share : of what was compared, the part that looks as it should, 0 to 1
    """

    def __init__(self, message: str = "", share: float = 0.0) -> None:
        super().__init__(message)
        self.share = share


class Undetermined(EstimationError):
    """What agrees does not determine the answer to the accuracy that is needed."""


class LooksAlike(Undetermined):
    """Several answers fit alike.

    Attributes
    ----------
    share : of what was compared, the part that looks as it should, 0 to 1; None: not known
    """

    def __init__(self, message: str = "", share: float | None = None) -> None:
        super().__init__(message)
        self.share = share


class NotConverged(EstimationError):
    """An iteration ended without reaching its tolerance."""


def nearest_name(name: object, known: Iterable[str]) -> str:
    """Return the known name nearest to `name`, ignoring case; empty when none is near.

    Parameters
    ----------
    name : as given; any other object is compared by its text
    known : the names that are accepted

    Examples
    --------
    >>> nearest_name("BAYER_RGBG8", ["mono8", "bayer_rggb8"])
    'bayer_rggb8'
    >>> nearest_name("h264", ["mono8", "bayer_rggb8"])
    ''
    """
    by_folded: dict[str, str] = {}
    for candidate in known:
        by_folded.setdefault(candidate.casefold(), candidate)
    near = difflib.get_close_matches(str(name)[:_LONGEST].casefold(), by_folded, n=1)
    return by_folded[near[0]] if near else ""
