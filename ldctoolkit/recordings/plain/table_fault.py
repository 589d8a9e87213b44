"""What is wrong with a recording table, and the columns that every one has."""

from __future__ import annotations

from typing import Final

from ldctoolkit.errors import RecordingError

REQUIRED: Final = ("recording", "t", "lane_offset", "lane_width", "speed")
NO_ROWS: Final = "a header but no rows; at least one sample is needed"


class TableFault(RecordingError):
    """What is wrong with a recording table, and where: "line 7", or empty for the file as a whole."""

    def __init__(self, place: str, what: str) -> None:
        super().__init__(f"{place}: {what}" if place else what)
        self.place, self.what = place, what
