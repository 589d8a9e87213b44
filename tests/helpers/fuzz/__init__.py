"""Recordings to be read by every reader, sound at first and then damaged, and what must hold whatever comes of it."""

from helpers.fuzz.check import check
from helpers.fuzz.damage import WORDS, files_changed, write
from helpers.fuzz.sound import DEPARTURES, SOUND

__all__ = ["DEPARTURES", "SOUND", "WORDS", "check", "files_changed", "write"]
