"""Preparation of recordings: resampling, gaps, lane widths and yaw rates; signals in time."""

import bisect
import dataclasses
import itertools
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.declared import check_declared, declared
from ldctoolkit.errors import CheckedArguments, InputError, RecordingError
from ldctoolkit.recordings.recording import (
    LARGEST,
    MAX_LANE_WIDTH,
    MIN_LANE_WIDTH,
    Recording,
    changed_columns,
    usable_samples,
)

ROUNDING: Final = 1e-6  # times [s] are compared with this allowance: 10.1 - 7.6 is not quite 2.5

MOST_NEIGHBOURS: Final = 50
"""A slope takes at most so many samples to either side; it bounds the work for absurd clocks."""

LEAST_SPREAD: Final = 1e-4
"""Sum of squared distances [s^2] from the mean time that a slope needs: two samples 0.014 s apart."""


def merge_repeated(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """One sample a time: the mean of those that share it."""
    if t.size < 2 or (t[1:] > t[:-1]).all():
        return t, values
    first = np.flatnonzero(np.append(True, t[1:] > t[:-1]))
    return t[first], np.add.reduceat(values, first) / np.diff(np.append(first, t.size))


def values_at(times: FloatArray, t: FloatArray, values: FloatArray, *, longest: float, beyond: float) -> FloatArray:
    """Values at some times, interpolated linearly between samples (t, values) that are `longest` apart at most.

    Next to a longer gap, and beyond the ends, the nearest sample is held for the time `beyond`; else it is NaN.
    """
    if t.size == 0:
        return np.full(times.shape, np.nan)
    right = np.searchsorted(t, times, side="right")
    left = np.maximum(right - 1, 0)
    right = np.minimum(right, t.size - 1)
    within = (t[left] <= times) & (times <= t[right]) & (t[right] - t[left] <= longest + ROUNDING)
    nearest = np.where(np.abs(times - t[left]) <= np.abs(t[right] - times), left, right)
    held = np.abs(times - t[nearest]) <= beyond + ROUNDING
    return np.where(within, np.interp(times, t, values), np.where(held, values[nearest], np.nan))


def local_slope(t: FloatArray, values: FloatArray, *, half: float, longest: float) -> FloatArray:
    """Slope of the straight line, by least squares, through the samples around each sample."""
    gap = np.diff(t) > longest + ROUNDING
    stretch = np.append(0, np.cumsum(gap)) if t.size else np.empty(0, dtype=np.int64)
    count = np.ones(t.size)
    sums = np.zeros((4, t.size))  # of s, y, s s, s y; s and y are distances from the sample itself

    # of samples closer than that every second one, or third, ...: the window is the same
    stride = max(1, round(half / (MOST_NEIGHBOURS * max(float(np.median(np.diff(t))), 1e-6)))) if t.size > 1 else 1
    for lag in range(stride, min(stride * MOST_NEIGHBOURS, t.size - 1) + 1, stride):
        s = t[lag:] - t[:-lag]
        near = (s <= half + ROUNDING) & (stretch[lag:] == stretch[:-lag])
        if not near.any():
            break
        s, y = np.where(near, s, 0.0), np.where(near, values[lag:] - values[:-lag], 0.0)
        for rows, sign in ((slice(None, -lag), 1.0), (slice(lag, None), -1.0)):
            count[rows] += near
            sums[:, rows] += sign * s, sign * y, s * s, s * y
    spread = sums[2] - sums[0] ** 2 / count
    enough: BoolArray = spread > LEAST_SPREAD
    return np.where(enough, (sums[3] - sums[0] * sums[1] / count) / np.where(enough, spread, 1.0), np.nan)


def rising_rows(t: FloatArray) -> BoolArray:
    """As many rows as possible whose times do not fall; of several choices the one with the earliest rows."""
    keep = np.ones(t.size, dtype=bool)
    if (t[1:] >= t[:-1]).all():
        return keep
    # a row that is in order with every other one is in each longest choice; only the rest needs the search, which is
    # patience sorting from the end
    doubtful = np.flatnonzero((t < np.maximum.accumulate(t)) | (t > np.minimum.accumulate(t[::-1])[::-1]))
    times = t[doubtful].tolist()
    latest: list[float] = []  # minus the latest time that a choice of each length can begin with
    lengths = []  # of the longest choice that begins with the row; from the end
    for time in reversed(times):
        length = bisect.bisect_right(latest, -time)
        lengths.append(length + 1)
        latest[length : length + 1] = [-time]
    needed, before = len(latest), -float("inf")
    for row, time, length in zip(doubtful.tolist(), times, reversed(lengths), strict=True):
        keep[row] = length == needed and time >= before
        if keep[row]:
            needed, before = needed - 1, time
    return keep


MOST_DROPPED: Final = 0.05
"""A larger share of rows whose times fall is another drive, not single rows in disorder."""


def rows_in_order(t: FloatArray) -> tuple[BoolArray, int, str]:
    """Which rows of a trip to keep so that its times do not fall, none if its clock starts again.

    Also the first row that is left out, or where the clock starts again, and a sentence about it.
    """
    keep = rising_rows(t)
    if keep.all():
        return keep, 0, ""
    count, fall = np.count_nonzero(~keep), int(np.argmax(t[1:] < t[:-1]))
    words = f"the time runs backwards from {t[fall]:.12g} to {t[fall + 1]:.12g}"
    if count > MOST_DROPPED * t.size:
        words += f", and {count} of {t.size} lines are out of order (allowed: {100 * MOST_DROPPED:g} %)"
        return np.zeros_like(keep), fall + 1, f"{words}; the trip is left out"
    return keep, int(np.argmin(keep)), f"{words}; {'the line is' if count == 1 else f'{count} lines are'} left out"


MOST_CLOCKS: Final = 20  # more stretches than these mean that the rows are not in the order of time at all


def clock_stretches(t: FloatArray) -> list[IntArray]:
    """Rows of each stretch of times that do not fall: single rows in disorder are left out, a clock that starts again
    begins another stretch.
    """
    keep = rising_rows(t)
    if np.count_nonzero(~keep) <= MOST_DROPPED * t.size:
        return [np.flatnonzero(keep)]
    falls = np.flatnonzero(t[1:] < t[:-1]) + 1
    if falls.size > MOST_CLOCKS:
        raise RecordingError("", f"the times fall in {falls.size} places", allowed="rows in the order of time")
    return list(np.split(np.arange(t.size), falls))


def joins_of(t: FloatArray, rows: IntArray) -> FloatArray:
    """Times before and after each gap that rows left out make between `rows`, (k, 2)."""
    last = np.flatnonzero(np.diff(rows) > 1)
    return np.column_stack([t[rows[last]], t[rows[last + 1]]])


def cut_at(t: FloatArray, joins: FloatArray) -> tuple[BoolArray | None, BoolArray]:
    """Where samples at times `t` begin anew after a join, None without joins, and where they lie inside one; (m,)."""
    cut, inside = np.zeros(t.size, dtype=bool), np.zeros(t.size, dtype=bool)
    for before, after in joins.tolist():
        first, last = np.searchsorted(t, before, "right"), np.searchsorted(t, after, "left")
        inside[first:last] = True
        cut[first : first + 1] = cut[last : last + 1] = True
    return cut if joins.size else None, inside


MAX_JUMP: Final = 0.6
"""Offsets [m] further apart are a jump: no value between them is made up, so that it is seen as one later on."""


def middle_two(values: FloatArray, group: IntArray, count: IntArray) -> tuple[FloatArray, FloatArray]:
    """The two middle values of each group that is not empty; groups follow each other, `count` values in each."""
    if count.max(initial=0) <= 1:
        return values, values
    ordered = values[np.lexsort((values, group))]
    begin, filled = np.cumsum(count) - count, count > 0
    return ordered[(begin + (count - 1) // 2)[filled]], ordered[(begin + count // 2)[filled]]


MAX_GAP: Final = 0.25  # longest time [s] between two usable samples that is bridged
_SLACK: Final = 1e-6  # of a step: a sample on the edge of a window is in it, however its time was rounded
_MOST_STEPS: Final = 2**52  # multiples of the step up to here are distinguished by floating point numbers

_NUMBERS: Final = ("lane_offset", "lane_width", "speed", "curvature", "yaw_rate")
_NAMES: Final = ("lane", "turn_signal", "heading", "steering", "steering_command", "engaged", "yaw_rate_measured")
"""Columns of which no mean or median is taken: the nearest usable sample's value counts, of two the earlier one's."""


def resample(recording: Recording, step: float, max_gap: float = MAX_GAP, max_jump: float = MAX_JUMP) -> Recording:
    """The same recording at multiples of a time step after its first sample.

    Samples that already lie at the multiples keep their values, and their times, to the last bit. Of two middle offsets
    of a window that are a jump apart, the one nearer to the nearest sample's is taken, not their mean. Where the lane
    changes in a window, only samples in the nearest sample's lane count.
    """
    if recording.samples == 0:
        return recording
    origin = recording.t[0]
    with np.errstate(over="ignore"):
        t = recording.t - origin
    if not t[-1] <= _MOST_STEPS * step:
        raise RecordingError(
            f"recording {recording.name!r}",
            f"from t = {float(origin)!r} to {float(recording.t[-1])!r} s is too long for steps of {step!r} s",
        )
    usable = usable_samples(recording)
    grid = _occupied(t, step, max_gap)
    centre: FloatArray = np.asarray(grid * step, dtype=np.float64)
    first, last = _windows(t, grid, centre, step)
    seen = last > first
    before = np.concatenate([[0], np.cumsum(usable)])
    low, high = before[first], before[last]
    filled = high > low
    tu, offset = t[usable], recording.lane_offset[usable]
    nearest = _nearest_in(low, high, tu, centre)
    targets, recorded = origin + centre, recording.t[_nearest_in(first, last, t, centre)]
    times = np.where(np.abs(recorded - targets) <= _SLACK * step, recorded, targets)  # they may differ by rounding only
    stretch = None
    if recording.lane is not None and tu.size:
        # samples of one lane in a row: a window that holds several is cut to that of its nearest sample
        lane = recording.lane[usable]
        stretch = np.cumsum(np.concatenate([[False], lane[1:] != lane[:-1]]))
        low = np.where(filled, np.maximum(low, np.searchsorted(stretch, stretch[nearest], "left")), low)
        high = np.where(filled, np.minimum(high, np.searchsorted(stretch, stretch[nearest], "right")), high)
    inside = np.flatnonzero(~filled & (low > 0) & (low < tu.size))
    after = low[inside]
    same = (tu[after] - tu[after - 1] <= max_gap * (1.0 + _SLACK)) & (
        np.abs(offset[after] - offset[after - 1]) <= max_jump
    )
    if stretch is not None:
        same &= stretch[after] == stretch[after - 1]
    bridged = np.zeros(grid.size, dtype=bool)
    bridged[inside[same]] = True
    keep = filled | bridged | seen
    # the windows ``low:high`` are laid once for all columns
    count = np.where(filled, high - low, 0)
    window = np.repeat(np.arange(grid.size), count)
    rows = (low - np.cumsum(count) + count)[window] + np.arange(window.size)
    after = low[bridged]
    share = (centre[bridged] - tu[after - 1]) / (tu[after] - tu[after - 1])
    columns: dict[str, Any] = {}
    for name in (*_NUMBERS, *_NAMES):
        if getattr(recording, name) is None:
            continue
        values = getattr(recording, name)[usable]
        if name in _NAMES:
            columns[name] = values[nearest[keep]] if tu.size else np.zeros(keep.sum(), values.dtype)
            continue
        below, above = middle_two(values[rows], window, count)
        middle = np.where(below == above, below, 0.5 * (below + above))
        if name == "lane_offset" and tu.size:
            near = offset[nearest[filled]]
            beside = np.where(np.abs(below - near) <= np.abs(above - near), below, above)
            middle = np.where(above - below > max_jump, beside, middle)
        result = np.full(grid.size, np.nan)
        result[filled] = middle
        result[bridged] = values[after - 1] + share * (values[after] - values[after - 1])
        columns[name] = result[keep]
    return dataclasses.replace(recording, t=times[keep], valid=(filled | bridged)[keep], **columns)


def _windows(t: FloatArray, grid: IntArray, centre: FloatArray, step: float) -> tuple[IntArray, IntArray]:
    """Samples within half a step of each centre: the first of them, and the one after the last."""
    multiple = np.rint(t / step).astype(np.int64)
    if (multiple[1:] > multiple[:-1]).all() and (np.abs(t - multiple * step) <= _SLACK * step).all():
        # each sample lies at a multiple of its own: no search
        first = np.arange(multiple.size) if np.array_equal(multiple, grid) else np.searchsorted(multiple, grid, "left")
        return first, first + (multiple[np.minimum(first, multiple.size - 1)] == grid)
    half = (0.5 + _SLACK) * step
    return np.searchsorted(t, centre - half, "left"), np.searchsorted(t, centre + half, "right")


def _nearest_in(low: IntArray, high: IntArray, t: FloatArray, centre: FloatArray) -> IntArray:
    """Index of the time nearest to each centre, where ``low:high`` are those in its window; 0 where there are none."""
    nearest = low.copy()
    searched = np.flatnonzero(high - low != 1)
    nearest[searched] = nearest_times(t, centre[searched]) if t.size else 0
    return nearest


def nearest_times(t: FloatArray, centre: FloatArray) -> IntArray:
    """Index of the time nearest to each centre, of two the earlier, of equal ones the first."""
    after = np.minimum(np.searchsorted(t, centre, "left"), t.size - 1)
    before = np.searchsorted(t, t[np.maximum(after - 1, 0)], "left")  # the first of a repeated time
    return np.where(np.abs(t[before] - centre) <= np.abs(t[after] - centre), before, after)


def _occupied(t: FloatArray, step: float, max_gap: float) -> IntArray:
    """Multiples of the step that lie within reach of a sample; a long gap costs nothing."""
    cut = np.flatnonzero(np.diff(t) > max_gap + step)
    first = np.concatenate([t[:1], t[cut + 1]])
    last = np.concatenate([t[cut], t[-1:]])
    low = np.floor(first / step).astype(np.int64)
    high = np.ceil(last / step).astype(np.int64)
    low[1:] = np.maximum(low[1:], high[:-1] + 1)
    count = np.maximum(high - low + 1, 0)
    starts = np.cumsum(count) - count
    grid: IntArray = np.repeat(low, count) + np.arange(count.sum()) - np.repeat(starts, count)
    inside: IntArray = grid[grid * step <= t[-1] + 0.5 * step]
    return inside


LONGEST_GAP = 10.0  # longest time [s] that may be bridged; bounds the memory, too


@dataclasses.dataclass(frozen=True)
class Preparation(CheckedArguments):
    """How recordings are brought to a common form.

    Raises `InputError` for a value outside its range.
    """

    # Time step that they are resampled to; None leaves them as recorded
    step: float | None = declared(None, unit="s", lower=0.01, upper=1.0)
    # Longest time between usable samples that resampling bridges
    max_gap: float = declared(MAX_GAP, unit="s", above=0.0, upper=LONGEST_GAP)
    # Offset and width of each recording are scaled so that its median lane width is this; None leaves them
    nominal_lane_width: float | None = declared(None, unit="m", lower=2.0, upper=6.0)
    # Multiplies the source's yaw rate; -1 where it is positive to the right after all
    yaw_rate_factor: float = declared(1.0)

    def __post_init__(self) -> None:
        check_declared(self)
        if self.yaw_rate_factor == 0.0:
            raise InputError("yaw_rate_factor", value=0.0, allowed="a finite number, not 0")


def corrected(recording: Recording, preparation: Preparation) -> Recording:
    """One recording without codes, with the factors that are given for its yaw rate and its lengths."""
    recording = without_codes(recording, (name for name in LIMITS if name != "lane_offset"))
    if recording.yaw_rate is not None and preparation.yaw_rate_factor != 1.0:
        with np.errstate(over="ignore"):
            yaw_rate = recording.yaw_rate * preparation.yaw_rate_factor
        recording = dataclasses.replace(recording, yaw_rate=yaw_rate)
    nominal = preparation.nominal_lane_width
    if nominal is None or not (widths := recording.lane_width[usable_samples(recording)]).size:
        return recording
    factor = nominal / float(np.median(widths))
    with np.errstate(over="ignore", invalid="ignore"):  # of absurd numbers, which are not usable
        scaled = changed_columns(recording, ("lane_offset", "lane_width"), lambda values: values * factor)
    return dataclasses.replace(scaled, lane_scale=recording.lane_scale * factor)


def stretches(recording: Recording) -> list[Recording]:
    """The pieces between the cuts of a recording; all but the first are said to go on from the one before."""
    if recording.cut is None:
        return [recording]
    ends = [0, *(np.flatnonzero(recording.cut[1:]) + 1).tolist(), recording.samples]
    whole = dataclasses.replace(recording, cut=None)
    pieces = [whole.take(slice(first, last)) for first, last in itertools.pairwise(ends)]
    return pieces[:1] + [dataclasses.replace(piece, continues=True, notes=()) for piece in pieces[1:]]


def prepare(
    recording: Recording,
    preparation: Preparation,
    max_jump: float = MAX_JUMP,
    widths: tuple[float, float] = (MIN_LANE_WIDTH, MAX_LANE_WIDTH),
) -> Recording:
    """One stretch of a recording, on its own clock, in the common form."""
    recording = without_frozen(with_yaw_rate(within_limits(recording, widths)))
    step, steps = preparation.step, np.diff(recording.t[:500])
    # a lane that is seen so seldom that nothing is bridged stays on its own clock
    if step is None or (steps.size and np.median(steps) > max(preparation.max_gap, step) + ROUNDING):
        return recording
    return resample(recording, step, preparation.max_gap, max_jump)


@dataclasses.dataclass(frozen=True)
class SignalLimits:
    """What a signal's numbers tell of themselves, in SI."""

    code_gap: float  # how far from all others a number is that is a code
    code_size: float  # how large a code is at most if most samples have it
    jump: float  # samples of a log that differ by more are not interpolated: one may stand for "not available"
    largest: float = np.inf  # no vehicle on a road has more: such numbers stand for "not available"
    spike: float = np.inf  # a single sample further from both of its neighbours is none


LIMITS: Final = {
    "lane_width": SignalLimits(code_gap=1.0, code_size=10.0, jump=MAX_JUMP),
    "lane_offset": SignalLimits(code_gap=MAX_JUMP, code_size=5.0, jump=MAX_JUMP),
    "speed": SignalLimits(code_gap=10.0, code_size=60.0, jump=20.0, largest=100.0, spike=20.0),
    "curvature": SignalLimits(code_gap=0.01, code_size=0.2, jump=0.1, largest=0.2),
    "yaw_rate": SignalLimits(code_gap=0.3, code_size=1.5, jump=0.75, largest=1.5, spike=0.5),
    "heading": SignalLimits(code_gap=5.0, code_size=40.0, jump=1.0),
    "steering": SignalLimits(code_gap=5.0, code_size=40.0, jump=1.0),
    "steering_command": SignalLimits(code_gap=5.0, code_size=40.0, jump=1.0),
}

_CODE_TIMES: Final = 3


def without_codes(recording: Recording, names: Iterable[str]) -> Recording:
    """NaN for codes of "not available": the end of a column's range, several times, far from all other numbers."""
    changed: dict[str, Any] = {}
    sound = bool(recording.valid.all())
    for name in names:
        limits, values = LIMITS[name], getattr(recording, name)
        if values is None:
            continue
        numbers = values if sound else values[recording.valid]
        if not LARGEST > numbers.max(initial=0.0) >= numbers.min(initial=0.0) > -LARGEST:  # False for NaN
            numbers = numbers[np.abs(numbers) < LARGEST]
        codes = []
        while numbers.size > _CODE_TIMES:
            for end in (numbers.max(), numbers.min()):
                count = np.count_nonzero(numbers == end)
                if not _CODE_TIMES <= count < numbers.size or (
                    2 * count > numbers.size and np.abs(end) <= limits.code_size
                ):
                    continue
                rest = numbers[numbers != end]
                if np.abs(rest - end).min() <= limits.code_gap:
                    continue
                # a width may be a constant, or two, of a map; other signals move
                if name == "lane_width" or np.unique(rest[:: max(1, rest.size // 100)]).size > min(5, rest.size // 2):
                    codes.append(end)
                    numbers = rest
                    break
            else:
                break
        if codes:
            changed[name] = np.where(np.isin(values, codes), np.nan, values)
    return dataclasses.replace(recording, **changed) if changed else recording


def spikes(values: FloatArray, height: float) -> BoolArray:
    """Single samples that are higher than both of their neighbours, or lower, by more than a height."""
    marked = np.zeros(values.size, dtype=bool)
    with np.errstate(over="ignore", invalid="ignore"):
        step = np.diff(values)
        far = np.abs(step) > height
        if far.any():
            marked[1:-1] = far[1:] & far[:-1] & (step[1:] * step[:-1] < 0.0)
    return marked


def within_limits(recording: Recording, widths: tuple[float, float]) -> Recording:
    """NaN for numbers that no lane and no vehicle has."""
    good = {"lane_width": (recording.lane_width >= widths[0]) & (recording.lane_width <= widths[1])}
    good["lane_offset"] = ~(np.abs(recording.lane_offset) > np.abs(recording.lane_width))
    for name in ("speed", "curvature", "yaw_rate"):
        if (values := getattr(recording, name)) is not None:
            good[name] = (np.abs(values) <= LIMITS[name].largest) & ~spikes(values, LIMITS[name].spike)
    beyond = [name for name, mask in good.items() if not mask.all()]
    changed: dict[str, Any] = {name: np.where(good[name], getattr(recording, name), np.nan) for name in beyond}
    return dataclasses.replace(recording, **changed) if changed else recording


_FEWEST_NEW: Final = 8  # so many new values show how often a signal is refreshed
_REGULAR: Final = 0.75  # share of the times between them that must be about the same


def coarse_step(offset: FloatArray) -> float:
    """The step, [m], of an offset that has few values for its samples, all multiples of it apart; 0 if it has none."""
    distinct = np.unique(offset[:: max(1, offset.size // 300)])
    steps = np.diff(distinct[np.isfinite(distinct)])
    step = float(steps.min(initial=np.inf))
    if steps.size < 3 or step <= COARSE:
        return 0.0
    with np.errstate(over="ignore", invalid="ignore"):  # of absurd numbers
        multiples = steps / step
        regular = (np.abs(multiples - np.rint(multiples)) < 0.05).all()
        return step if regular and offset.size > 5.0 * np.ptp(offset) / step else 0.0


_EVERY_ROW: Final = (np.empty(0, dtype=np.int64), 0.0)


def new_rows(t: FloatArray, values: FloatArray) -> tuple[IntArray, float]:
    """Rows in which a signal is there, and new, and the time between them [s]; 0 where that is no clock of its own."""
    held = np.count_nonzero(values[1:] == values[:-1]) + np.count_nonzero(values != values)
    if held < 0.3 * t.size:
        return _EVERY_ROW
    present = np.flatnonzero(np.abs(values) < LARGEST)
    first = values[present]
    new = np.append(True, np.diff(first) != 0.0)[: present.size]
    rows = present[new]
    if not _FEWEST_NEW <= rows.size <= 0.7 * t.size:
        return _EVERY_ROW
    intervals, step = np.diff(t[rows]), float(np.median(np.diff(t)))
    refresh = float(np.median(intervals))
    even = np.abs(intervals - refresh) <= max(1.01 * step, 0.25 * refresh)
    if refresh < 1.5 * step or np.mean(even) < _REGULAR:
        return _EVERY_ROW
    # a slow signal with a coarse step is held as well; its changes are single steps, all of one size
    change = np.abs(np.diff(first[new]))
    if np.mean(np.abs(change - np.median(change)) <= 0.01 * np.median(change)) > 0.5:
        return _EVERY_ROW
    return rows, refresh


def on_own_clocks(recording: Recording) -> Recording:
    """The recording at the times when its lane signal is new, which is the clock of all departures; other signals are
    interpolated between the rows in which they are new.
    """
    t, notes = recording.t, list(recording.notes)
    changed: dict[str, Any] = {}
    for name in ("speed", "curvature", "yaw_rate", "steering"):
        values = getattr(recording, name)
        if values is not None:
            rows, refresh = new_rows(t, values)
            # one that is held for so short a time is as good as interpolated
            if refresh > MAX_GAP + ROUNDING or (refresh > 0.0 and np.isnan(values).any()):
                between = values_at(t, *merge_repeated(t[rows], values[rows]), longest=2.5 * refresh, beyond=refresh)
                changed[name] = np.where(np.isnan(between), values, between)
                notes.append(f"{name} is new every {refresh:.2g} s only, and interpolated between")
    offset = np.where(recording.valid & np.isfinite(recording.lane_width), recording.lane_offset, np.nan)
    rows, refresh = new_rows(t, offset)
    if refresh == 0.0 and t.size > 1:  # of a signal that was interpolated the slope is held
        with np.errstate(all="ignore"):  # equal times, absurd numbers
            slope = np.diff(offset[:1000]) / np.diff(t[:1000])
            if np.count_nonzero(np.abs(np.diff(slope)) < 1e-6) > 0.2 * slope.size:
                bends, longer = new_rows(t[:-1], np.round(np.diff(offset) / np.diff(t), 6))
                rows, refresh = (bends, longer) if longer > SHORTEST_REFRESH else _EVERY_ROW
    if refresh > 0.0:
        # where the lane is lost for longer, rows at the same distance are kept, and are invalid
        lost = np.flatnonzero(np.isnan(offset))
        lost = lost[t[lost] - t[rows[np.maximum(np.searchsorted(rows, lost) - 1, 0)]] > 1.25 * refresh]
        rows = np.union1d(rows, lost[:: max(1, round(refresh / float(np.median(np.diff(t)))))])
        least = f": departures of less than about {3.0 * refresh:.2g} s cannot be found" if refresh > 0.2 else ""
        notes.append(f"the lane is new every {refresh:.2g} s only{least}")
    coarse = coarse_step(offset[np.isfinite(offset)])
    if coarse > 0.0:
        notes.append(f"lane_offset comes in steps of {coarse:.2g} m")
    if len(notes) > len(recording.notes):
        recording = dataclasses.replace(recording, notes=tuple(notes), **changed)
    # a held offset repeats itself as a code does
    return without_codes(recording.take(rows) if refresh > 0.0 else recording, ["lane_offset"])


SHORTEST_REFRESH: Final = 0.3  # [s] a lane signal that was interpolated over less makes up no departure
COARSE: Final = 0.049  # [m] coarser steps of the offset are reported

_FROZEN: Final = (
    (("lane_offset", "lane_width"), 2.0, 1),
    (("lane_offset", "lane_width", "speed", "curvature", "yaw_rate", "heading", "steering"), 1.0, 2),
)
"""Columns that do not all stand still for longer than a time [s] while the vehicle moves, if so many of them move."""


def without_frozen(recording: Recording) -> Recording:
    """Rows that repeat the one before for long, while the vehicle moves, are invalid: they are not driving."""
    valid = recording.valid
    still = recording.lane_offset[1:] == recording.lane_offset[:-1]
    if not (still[:-4] & still[1:-3] & still[2:-2] & still[3:-1] & still[4:]).any():  # as nearly always
        return recording
    for names, longest, enough in _FROZEN:
        changes = [np.diff(x) != 0.0 for x in (getattr(recording, name) for name in names) if x is not None]
        moved = np.append(True, np.any(changes, axis=0) | ~(recording.speed[1:] > 1.0))[: recording.samples]
        begin = np.flatnonzero(moved)
        length = np.diff(np.append(begin, recording.samples))
        long = (length > 5) & (recording.t[begin + length - 1] - recording.t[begin] > longest)
        # signals that stand still most of the time, as made ones do, say nothing
        if long.any() and sum(2 * np.count_nonzero(change) > change.size for change in changes) >= enough:
            valid = valid & ~(np.repeat(long, length) & ~moved)
    return recording if valid is recording.valid else dataclasses.replace(recording, valid=valid)


HALF_WINDOW: Final = 1.0  # half the window of the slope [s]: a heading is coarse
LONGEST: Final = 1.5  # longest time [s] between headings that is bridged; GPS receivers give one a second at least
WORTH_A_NOTE: Final = 0.01  # share of the valid samples above which it is reported

FILLED: Final = "the yaw rate is missing in places, and comes from the GPS heading there"
NONE: Final = "no yaw rate: the lane counts as straight"


def with_yaw_rate(recording: Recording) -> Recording:
    """The recording with the heading's slope for missing yaw rates."""
    rate = recording.yaw_rate
    if rate is None or recording.curvature is not None:
        return recording
    missing = ~(np.abs(rate) < LARGEST)
    if not missing.any():
        return recording
    notes, measured = recording.notes, recording.yaw_rate_measured
    if recording.heading is not None:
        headed = np.abs(recording.heading) < LARGEST
        t, heading = merge_repeated(recording.t[headed], np.unwrap(recording.heading[headed]))
        slope = local_slope(t, heading, half=HALF_WINDOW, longest=LONGEST)
        sure = np.isfinite(slope)
        slopes = values_at(recording.t[missing], t[sure], slope[sure], longest=LONGEST, beyond=HALF_WINDOW)
        rate = rate.copy()
        rate[missing] = slopes
        measured = ~missing if measured is None else measured & ~missing
        filled = np.isfinite(slopes) & recording.valid[missing]
        noted = any("yaw rate" in note for note in notes)  # by the reader
        if not noted and np.count_nonzero(filled) > WORTH_A_NOTE * np.count_nonzero(recording.valid):
            notes = (*notes, FILLED)
    # where the lane or the speed is not known either, the recording is of no use anyway
    if not (np.abs(rate) < LARGEST).any() and (recording.valid & np.isfinite(recording.speed)).any():
        return dataclasses.replace(recording, yaw_rate=None, yaw_rate_measured=None, notes=(*notes, NONE))
    return dataclasses.replace(recording, yaw_rate=rate, yaw_rate_measured=measured, notes=notes)
