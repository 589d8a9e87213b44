"""A part of a source as executors run it."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

from ldctoolkit.errors import LdcError
from ldctoolkit.recordings.extract_part import extract_part
from ldctoolkit.recordings.find_departures import Criteria
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.result import PartResult
from ldctoolkit.recordings.sources import RecordingPart

PACKAGES: Final = ("numpy", "polars", "numba")
"""Packages that read files or decide numbers."""


@dataclasses.dataclass(frozen=True)
class Unread:
    """Why nothing came out of a part.

    Attributes
    ----------
    reason : str
        One sentence.
    """

    reason: str


@dataclasses.dataclass(frozen=True, eq=False)
class PartWork:
    """Reads one part and finds its departures.

    Attributes
    ----------
    number : int
        Place of the part in its source.
    part : RecordingPart
        What is read.
    criteria : Criteria
        What counts as a departure.
    preparation : Preparation
        How recordings are brought to a common form.
    time_limit : float [s]
        None: how long a file takes depends on the disk.
    """

    number: int
    part: RecordingPart
    criteria: Criteria
    preparation: Preparation
    time_limit: float = 0.0

    def make_ready(self, kept: dict[str, Any]) -> None:
        """Nothing is needed."""

    def run(self, kept: dict[str, Any]) -> PartResult | Unread:  # noqa: ARG002
        """Read the part; a fault in it, or in its reader, ends this part alone."""
        try:
            return extract_part(self.part, self.criteria, self.preparation)
        except LdcError as error:
            return Unread(str(error))
        except Exception as error:  # a reader may be anybody's code
            return Unread(f"{type(error).__name__}: {error}")


@dataclasses.dataclass(frozen=True, eq=False)
class Probe:
    """Does nothing: tells whether workers live at all.

    Attributes
    ----------
    number : int
        Of no part.
    time_limit : float [s]
        None.
    """

    number: int
    time_limit: float = 0.0

    def make_ready(self, kept: dict[str, Any]) -> None:
        """Nothing is needed."""

    def run(self, kept: dict[str, Any]) -> bool:  # noqa: ARG002
        """Say so."""
        return True
