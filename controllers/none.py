"""No control: the departure runs as it was recorded. The baseline of every study."""

import dataclasses
from typing import ClassVar, final

from ldctoolkit.control import Controller, RecordedPath
from ldctoolkit.vehicle.bicycle import Plant


@final
@dataclasses.dataclass(frozen=True)
class NoControl(Controller):
    """No control acts; S equals S_uncorrected to the bit.

    Examples
    --------
    >>> NoControl().gains()
    ()
    """

    name: ClassVar[str] = "none"
    title: ClassVar[str] = "No control"

    def prepare(self, plant: Plant) -> RecordedPath:
        """Return the law that leaves the recorded path alone."""
        return RecordedPath()
