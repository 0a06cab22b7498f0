# SPDX-License-Identifier: Apache-2.0
"""The errors of the package: one base, one class for each kind of cause.

A message gives the name of the thing, what was got, and what is needed, on one line.
"""

from imgu_ros.shown_text import shown


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
    """An estimator has no answer for its input; the chain turns it into a status."""


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


class NotConverged(EstimationError):
    """An iteration ended without reaching its tolerance."""
