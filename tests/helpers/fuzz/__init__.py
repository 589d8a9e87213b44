"""Recordings to be read by every reader, sound at first and then damaged, and what must hold whatever comes of it."""

from helpers.fuzz.check import check, recognise
from helpers.fuzz.damage import WORDS, damaged, files_changed
from helpers.fuzz.sound import DEPARTURES, SOUND
from helpers.fuzz.write import PATHS, PLACES, open_again, put_places, write
from ldctoolkit.recordings import extract_departures, open_recordings

__all__ = [
    "DEPARTURES", "PATHS", "PLACES", "SOUND", "WORDS", "check", "damaged", "extract_departures", "files_changed",
    "open_again", "open_recordings", "put_places", "recognise", "write",
]  # fmt: skip
