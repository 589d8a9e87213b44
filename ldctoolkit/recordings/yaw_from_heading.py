"""A yaw rate from the GPS heading where a source has none: a departure is not lost for a sensor that was off."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from ldctoolkit.recordings.recording import Recording
from ldctoolkit.recordings.signals_in_time import local_slope, merge_repeated, values_at
from ldctoolkit.recordings.table import LARGEST

HALF_WINDOW: Final = 1.0
"""Half the window of the slope [s]: a heading is coarse."""

LONGEST: Final = 1.5
"""Longest time [s] between headings that is bridged; GPS receivers give one a second at least."""

WORTH_TELLING: Final = 0.01
"""Share of the valid samples above which it is told."""

FILLED: Final = "the yaw rate is missing in places, and comes from the GPS heading there"
NONE: Final = "no yaw rate: the lane counts as straight"


def with_yaw_rate(recording: Recording) -> Recording:
    """The recording with the heading's slope for missing yaw rates.

    Parameters
    ----------
    recording : Recording
        Its `yaw_rate` may hold NaN; None, or a recorded curvature, leaves it as it is.

    Returns
    -------
    Recording
        With a note if anything was filled in, and `yaw_rate_measured` False there. Without a single yaw rate in the end
        it has none, and says so.

    Examples
    --------
    >>> t, one = np.arange(40) * 0.1, np.ones(40)
    >>> recording = Recording("a", t, 0 * one, 3.6 * one, 25 * one, one > 0, yaw_rate=np.nan * one, heading=0.02 * t)
    >>> with_yaw_rate(recording).yaw_rate.round(6)[:2].tolist()
    [0.02, 0.02]
    """
    rate = recording.yaw_rate
    if rate is None or recording.curvature is not None:
        return recording
    missing = ~(np.abs(rate) < LARGEST)
    if not missing.any():
        return recording
    notes, measured = recording.notes, recording.yaw_rate_measured
    if recording.heading is not None:
        known = np.abs(recording.heading) < LARGEST
        t, heading = merge_repeated(recording.t[known], np.unwrap(recording.heading[known]))
        slope = local_slope(t, heading, half=HALF_WINDOW, longest=LONGEST)
        sure = np.isfinite(slope)
        found = values_at(recording.t[missing], t[sure], slope[sure], longest=LONGEST, beyond=HALF_WINDOW)
        rate = rate.copy()
        rate[missing] = found
        measured = ~missing if measured is None else measured & ~missing
        filled = np.isfinite(found) & recording.valid[missing]
        told_already = any("yaw rate" in note for note in notes)  # by the reader
        if not told_already and np.count_nonzero(filled) > WORTH_TELLING * np.count_nonzero(recording.valid):
            notes = (*notes, FILLED)
    # where the lane or the speed is not known either, the recording is of no use anyway
    if not (np.abs(rate) < LARGEST).any() and (recording.valid & np.isfinite(recording.speed)).any():
        return dataclasses.replace(recording, yaw_rate=None, yaw_rate_measured=None, notes=(*notes, NONE))
    return dataclasses.replace(recording, yaw_rate=rate, yaw_rate_measured=measured, notes=notes)
