"""What every recording goes through before departures are looked for: scale of its lane, yaw rate, common time step."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ldctoolkit.errors import InputError
from ldctoolkit.recordings.medians import MAX_JUMP
from ldctoolkit.recordings.recording import Recording
from ldctoolkit.recordings.resample import MAX_GAP, resample
from ldctoolkit.recordings.table import usable_samples
from ldctoolkit.recordings.yaw_from_heading import with_yaw_rate

LONGEST_GAP = 10.0
"""Longest time [s] that may be bridged; bounds the memory, too."""


@dataclasses.dataclass(frozen=True)
class Preparation:
    """How recordings are brought to a common form.

    Attributes
    ----------
    step : float [s] or None
        Time step that they are resampled to; None leaves them as recorded.
    max_gap : float [s]
        Longest time between usable samples that resampling bridges.
    nominal_lane_width : float [m] or None
        Offset and width of each recording are scaled so that its median lane width is this; None leaves them.
    yaw_rate_factor : float
        Multiplies the source's yaw rate; -1 where it is positive to the right after all.

    Raises
    ------
    InputError
        For a value outside its range.
    """

    step: float | None = None
    max_gap: float = MAX_GAP
    nominal_lane_width: float | None = None
    yaw_rate_factor: float = 1.0

    def __post_init__(self) -> None:
        def refuse(name: str, good: bool, allowed: str) -> None:
            if not good:
                raise InputError(f"{name}: {getattr(self, name)!r}; allowed: {allowed}")

        refuse("step", self.step is None or 0.01 <= self.step <= 1.0, "0.01 to 1 s, or None")
        refuse("max_gap", 0.0 < self.max_gap <= LONGEST_GAP, f"more than 0, at most {LONGEST_GAP:g} s")
        width = self.nominal_lane_width
        refuse("nominal_lane_width", width is None or 2.0 <= width <= 6.0, "2 to 6 m, or None")
        factor = self.yaw_rate_factor
        refuse("yaw_rate_factor", math.isfinite(factor) and factor != 0.0, "finite, not 0")


def prepare(recording: Recording, preparation: Preparation, max_jump: float = MAX_JUMP) -> Recording:
    """One recording in the common form.

    Parameters
    ----------
    recording : Recording
        As its reader gave it.
    preparation : Preparation
        What to do.
    max_jump : float [m]
        Offsets further apart are a jump, which resampling leaves one; a criterion of the search.

    Returns
    -------
    Recording
        Missing yaw rates filled in from the heading, scaled, then resampled; `lane_scale` tells the factor.

    Examples
    --------
    >>> t = np.arange(3) * 0.1
    >>> one = Recording("a", t, np.full(3, 0.5), np.full(3, 2.8), np.full(3, 25.0), np.ones(3, bool))
    >>> prepared = prepare(one, Preparation(step=0.1, nominal_lane_width=3.5))
    >>> prepared.lane_scale, prepared.lane_offset.tolist()
    (1.25, [0.625, 0.625, 0.625])
    """
    if recording.yaw_rate is not None and preparation.yaw_rate_factor != 1.0:
        with np.errstate(over="ignore"):
            yaw_rate = recording.yaw_rate * preparation.yaw_rate_factor
        recording = dataclasses.replace(recording, yaw_rate=yaw_rate)
    recording = with_yaw_rate(recording)
    if preparation.nominal_lane_width is not None:
        recording = scaled(recording, preparation.nominal_lane_width)
    if preparation.step is not None:
        recording = resample(recording, preparation.step, preparation.max_gap, max_jump)
    return recording


def scaled(recording: Recording, nominal: float) -> Recording:
    """Offset and width times the factor that makes the median width of the usable samples `nominal` [m]."""
    widths = recording.lane_width[usable_samples(recording)]
    if widths.size == 0:
        return recording
    factor = nominal / float(np.median(widths))
    with np.errstate(over="ignore"):  # of absurd numbers, which are not usable
        return dataclasses.replace(
            recording,
            lane_offset=recording.lane_offset * factor,
            lane_width=recording.lane_width * factor,
            lane_scale=recording.lane_scale * factor,
        )
