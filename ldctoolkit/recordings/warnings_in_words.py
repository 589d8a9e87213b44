"""What looked wrong with recordings, in words."""

from __future__ import annotations

from typing import Final

import numpy as np

from ldctoolkit.recordings.evidence import TURN_WINDOW, Evidence
from ldctoolkit.recordings.units import unit_warnings

FEWEST_TURNS: Final = 100
"""Windows that it takes to compare yaw rate and heading."""

LEAST_TURNING: Final = 0.02 * TURN_WINDOW
"""Root mean square of the turns by heading [rad in a window] above which they must agree: smaller ones may be noise."""

LEAST_USABLE: Final = 0.25
"""A smaller share of usable samples is worth a warning: cameras often see no lane, but not nearly always."""

TWINS_NAMED: Final = 5

PLAUSIBLE_WIDTHS: Final = (2.8, 4.3)
"""Median lane widths [m] that roads are built with, country road and motorway, and a little more."""

METRES: Final = (1.5, 6.0)
"""Median lane widths that may be in metres at all."""

UNEVEN: Final = 1.25
"""A larger ratio of the recordings' median lane widths is one of scale, not of roads, if some are odd in themselves."""

EDGE: Final = 0.05
"""Share of the recordings at either end that may have odd lane widths."""


def warnings_in_words(
    evidence: Evidence,
    vehicle_width: float,
    nominal_lane_width: float | None,
    *,
    yaw_rate_factor: float = 1.0,
    labelled: bool = True,
) -> tuple[str, ...]:
    """Warnings about units, signs, scale, curvature and repeated recordings; none when everything is plausible.

    Parameters
    ----------
    evidence : Evidence
        Of all recordings.
    vehicle_width : float [m]
        Width that was taken.
    nominal_lane_width : float [m] or None
        Lane width that recordings were scaled to.
    yaw_rate_factor : float
        Factor that yaw rates were multiplied with.
    labelled : bool
        The format has a place for the label of the lane, so that it can be missed.

    Returns
    -------
    tuple of str
        One sentence each.
    """
    found = unit_warnings(dict(evidence.units), vehicle_width)
    if "none" in evidence.kinds:
        where = "" if evidence.kinds == ("none",) else " in some recordings"
        found.append(f"no column 'curvature' or 'yaw_rate'{where}: the lane's curvature is taken as 0 (c_0 = dc = 0)")
    if labelled and not evidence.lanes:
        found.append("no column 'lane': a lane change is seen only as a jump of the offset by about a lane width")
    found += _turning(evidence, yaw_rate_factor)
    if evidence.bends[0] > 1000 and evidence.bends[1] < 0.001 * evidence.bends[0] and evidence.kinds != ("none",):
        found.append("the lane is straight in nearly all samples: c_0 and dc tell nothing")
    told = any("lane_width" in words or "vehicle width" in words for words in found)
    if nominal_lane_width is None and not told:
        found += _scale(evidence)
    found += _twins(evidence)
    total = evidence.names.size
    found += [f"{note}: {count} of {total} recordings" for note, count in evidence.notes]
    return tuple(found)


def few_usable(samples: int, usable: int) -> tuple[str, ...]:
    """A warning where most of what was read cannot be used."""
    if samples == 0 or usable >= LEAST_USABLE * samples:
        return ()
    return (
        f"only {usable:,} of {samples:,} samples can be used ({usable / samples:.1%}): in the others the lane, the "
        "speed or the yaw rate is missing, or the source itself distrusts them",
    )


def _turning(evidence: Evidence, factor: float) -> list[str]:
    """Yaw rate against heading; the evidence is of yaw rates that were multiplied with `factor`."""
    windows, hh, hr, rr = evidence.turns
    if windows < FEWEST_TURNS:
        return []
    likeness = hr / max(np.sqrt(hh * rr), 1e-300)
    if abs(likeness) < 0.5:
        if hh < LEAST_TURNING**2 * windows:
            return []
        return [f"yaw rate and GPS heading do not agree (correlation {likeness:.2f}): curvatures are doubtful"]
    # the true ratio lies between the two regressions, the first if all noise is the yaw rate's, the second if it is
    # all the heading's
    low, high = abs(hr) / hh, rr / abs(hr)
    scale = 1.0 if low < 1.25 and high > 0.8 else float(np.sqrt(rr / hh))
    times = "" if scale == 1.0 else f", and {scale:.3g} times as much: another unit?"
    rate, recorded = "the yaw rate", "it"
    if factor != 1.0:
        rate, recorded = f"the yaw rate times {factor:.3g}, as given,", "without the factor it"
    if likeness < 0.0:
        return [
            f"{rate} turns against the GPS heading (correlation {likeness:.2f}){times}; {recorded} is positive to the "
            f"{'right' if factor > 0.0 else 'left'}: give --yaw-rate-factor {-factor / scale:.3g}, or all curvatures "
            "have the wrong sign"
        ]
    if scale != 1.0:
        return [
            f"{rate} is {scale:.3g} times what the GPS heading turns: another unit? "
            f"(--yaw-rate-factor {factor / scale:.3g} would make them agree)"
        ]
    return []


def _scale(evidence: Evidence) -> list[str]:
    widths = evidence.median_widths[np.isfinite(evidence.median_widths)]
    if widths.size == 0:
        return []
    low, middle, high = (float(value) for value in np.quantile(widths, [EDGE, 0.5, 1.0 - EDGE]))
    if not METRES[0] < middle < METRES[1]:
        return []  # another unit, of which the check of units tells
    odd = low < PLAUSIBLE_WIDTHS[0] or high > PLAUSIBLE_WIDTHS[1]
    uneven = widths.size >= 3 and odd and high > UNEVEN * low
    if PLAUSIBLE_WIDTHS[0] <= middle <= PLAUSIBLE_WIDTHS[1] and not uneven:
        return []
    return [
        f"the median lane width of a recording runs from {widths.min():.2f} to {widths.max():.2f} m (middle "
        f"{middle:.2f}): the scale of offset and width is doubtful, as with a single camera; --nominal-lane-width 3.5 "
        "scales each recording"
    ]


def _twins(evidence: Evidence) -> list[str]:
    known = np.flatnonzero(evidence.fingerprints != "")
    _, inverse, count = np.unique(evidence.fingerprints[known], return_inverse=True, return_counts=True)
    groups = [known[inverse == i] for i in np.flatnonzero(count > 1)]
    if not groups:
        return []
    groups.sort(key=lambda group: int(group[0]))
    named = "; ".join(" = ".join(str(evidence.names[i]) for i in group[:3]) for group in groups[:TWINS_NAMED])
    more = f"; and {len(groups) - TWINS_NAMED} more" if len(groups) > TWINS_NAMED else ""
    repeated = sum(group.size - 1 for group in groups)
    repeat = "recording repeats" if repeated == 1 else "recordings repeat"
    return [f"{repeated} {repeat} another's samples, and the departures count twice: {named}{more}"]
