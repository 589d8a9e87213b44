"""Recordings to be read by every reader, sound at first and then damaged, and what must hold whatever comes of it."""

from __future__ import annotations

from recordings_fuzz_making.check import check, recognise
from recordings_fuzz_making.damage import WORDS, damaged, files_changed
from recordings_fuzz_making.sound import DEPARTURES, SOUND
from recordings_fuzz_making.write import PATHS, PLACES, open_again, put_places, write

from ldctoolkit.recordings import extract_departures, open_recordings

__all__ = [
    "DEPARTURES",
    "PATHS",
    "PLACES",
    "SOUND",
    "WORDS",
    "check",
    "damaged",
    "extract_departures",
    "files_changed",
    "open_again",
    "open_recordings",
    "put_places",
    "recognise",
    "write",
]
