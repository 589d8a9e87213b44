"""Bootstrap and simultaneous intervals of mean scores, exact ones of probabilities and quantiles, the set of best."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.clusters import cluster_error, cluster_values, several, with_tails_of_t
from ldctoolkit.declared import checked_number
from ldctoolkit.errors import InputError
from ldctoolkit.metrics import TAIL

T = TypeVar("T", bound=np.generic)

_ROW_ENTRIES = 250_000  # numbers in a block (2 MB)


def row_blocks(
    values: npt.NDArray[T], rows: IntArray | None = None, *, entries: int | None = None
) -> Iterator[tuple[slice, npt.NDArray[T]]]:
    """Rows of a table in blocks of about `entries` numbers, each with its positions among these rows."""
    size = max(1, (entries or _ROW_ENTRIES) // max(1, values.shape[1]))
    count = values.shape[0] if rows is None else rows.size
    for first in range(0, count, size):
        positions = slice(first, min(first + size, count))
        yield positions, values[positions] if rows is None else values[rows[positions]]


def row_means(values: FloatArray, rows: IntArray | None = None) -> FloatArray:
    """Mean of every row, or of the given rows, (d,); it does not depend on the other rows."""
    result = np.empty(values.shape[0] if rows is None else rows.size)
    for positions, block in row_blocks(values, rows):
        result[positions] = np.ascontiguousarray(block).mean(axis=1)
    return result


_STREAM = 0x626F6F74
"""Keeps the bootstrap's random numbers apart from those of the scenarios, which come from the same seed."""

_WEIGHT_ENTRIES = 2_000_000  # weights held at once (16 MB)

_GRID_ENTRIES = 2_500_000
"""Scores that are resampled at once (20 MB, and as much again for intermediate results)."""

_REUSED_WEIGHTS = 10_000_000
"""Weights in a block of stored ones (80 MB): in products of small matrices threads wait for each other."""

_MANTISSA = 53  # bits of a double precision number


def bootstrap_means(values: FloatArray, side: IntArray, *, samples: int, seed: int, stream: int = 0) -> FloatArray:
    """Means of d designs over resampled scenarios.

    A resample is a multinomial weight vector w / n; the means are one matrix product, in blocks of B. The weights
    depend on seed, stream, B and the sides only. A column depends on its own row and the weights, to the last bit.
    """
    return bootstrap_deviations(values, side, samples=samples, seed=seed, stream=stream) + row_means(values)


def bootstrap_deviations(
    values: FloatArray, side: IntArray, *, samples: int, seed: int, stream: int = 0, rows: IntArray | None = None
) -> FloatArray:
    """Resampled means minus the designs' means, (B, d); parameters and errors are those of `bootstrap_means`.

    `rows`, (d,) int, selects rows of the values and their order.
    """
    n = values.shape[1]
    d = values.shape[0] if rows is None else rows.size
    mean = row_means(values, rows)
    deviations = np.empty((max(samples, 0), d))
    # a stored weight takes a byte: up to this size, scores take less memory than stored weights
    entries = max(_GRID_ENTRIES, samples // 8 * n)
    blocks: Iterable[FloatArray] = weight_blocks(side, samples=samples, seed=seed, stream=stream)
    if d * n > entries:
        blocks = _ReusedWeights(blocks)
    for positions, block in row_blocks(values, rows, entries=entries):
        # centred: a spread that is small against the mean keeps its digits
        grid, unit = exact_grid(block - mean[positions, None], n)
        first = 0
        for weights in blocks:
            result = deviations[first : first + len(weights), positions]
            np.matmul(weights, grid.T, out=result)
            result *= unit / n
            first += len(weights)
    return deviations


class _ReusedWeights:
    """Weights for several passes, stored in the smallest integer type; iteration gives large blocks."""

    def __init__(self, blocks: Iterable[FloatArray]) -> None:
        self._weights = np.concatenate([block.astype(np.min_scalar_type(int(block.max()))) for block in blocks])

    def __iter__(self) -> Iterator[FloatArray]:
        return (block.astype(np.float64) for _, block in row_blocks(self._weights, entries=_REUSED_WEIGHTS))


def weight_blocks(side: IntArray, *, samples: int, seed: int, stream: int = 0) -> Iterator[FloatArray]:
    """How often each scenario is drawn in each resample, in blocks (b, n) with `samples` rows in total."""
    n = side.size
    if samples < 1 or n < 1:
        raise InputError("bootstrap", f"{samples} samples of {n} scenarios", allowed="at least one of each")
    strata = [np.flatnonzero(side == which) for which in np.unique(side)]
    generator = np.random.default_rng(np.random.SeedSequence([seed, _STREAM, stream]))
    size = max(1, _WEIGHT_ENTRIES // n)
    for first in range(0, samples, size):
        block = min(size, samples - first)
        weights = np.zeros((block, n))
        for rows in strata:
            drawn = generator.integers(rows.size, size=(block, rows.size))
            drawn += rows.size * np.arange(block)[:, None]
            weights[:, rows] = np.bincount(drawn.ravel(), minlength=block * rows.size).reshape(block, rows.size)
        yield weights


def exact_grid(values: FloatArray, total: int) -> tuple[FloatArray, FloatArray]:
    """Values as whole numbers (d, n) of a unit (d,), a power of two, so that weighted sums of them are exact.

    `total` bounds the sum of weights. Every partial sum of weights times grid is a whole number below 2^53. A matrix
    product is then the same to the last bit in whatever order a BLAS sums, on any machine, for any number of threads
    and any other rows.
    """
    _, exponent = np.frexp(np.abs(values).max(axis=1, initial=0.0))
    unit = np.ldexp(1.0, exponent + int(total).bit_length() - _MANTISSA)
    grid: FloatArray = np.rint(values / unit[:, None])
    return grid, unit


def check_confidence(confidence: float) -> None:
    """Raise `InputError` for a confidence that is not between 0 and 1."""
    if not 0.0 < checked_number("confidence", confidence) < 1.0:
        raise InputError("confidence", value=confidence, allowed="between 0 and 1")


_SPREAD_ENTRIES = 64_000  # differences held at once; they stay in the cache
_ROUNDING = 1e-12  # an error below this share of the scores is rounding


def error_parts(values: FloatArray, side: IntArray) -> FloatArray:
    """Contribution of each scenario to a standard error: the norm of a row is the standard error of its mean.

    Deviation from the stratum's mean times sqrt(n_h / (n_h - 1)) / n; those of a difference are their differences.
    """
    parts = np.zeros(values.shape)
    for which in np.unique(side):
        rows = side == which
        size = int(rows.sum())
        if size > 1:
            part = values[:, rows]
            part = part - row_means(part)[:, None]
            parts[:, rows] = part * (np.sqrt(size / (size - 1.0)) / side.size)
    return parts


def lengths(parts: FloatArray) -> FloatArray:
    """Standard error of every row's mean, (d,), from its `error_parts`."""
    return paired_errors(parts, np.zeros(parts.shape[1]), 0.0)


def _paired_parts(parts: FloatArray, reference: FloatArray) -> Iterator[tuple[slice, FloatArray]]:
    size = max(1, _SPREAD_ENTRIES // parts.shape[1])
    for first in range(0, len(parts), size):
        rows = slice(first, first + size)
        yield rows, parts[rows] - reference


def paired_errors(parts: FloatArray, reference: FloatArray, largest: float) -> FloatArray:
    """Standard error of the mean paired difference of every row to a reference; 0 within the rounding of `largest`."""
    errors = np.empty(len(parts))
    for rows, block in _paired_parts(parts, reference):
        block *= block
        errors[rows] = np.sqrt(block.sum(axis=1))
    errors[errors <= _ROUNDING * largest] = 0.0
    return errors


def paired_cubes(parts: FloatArray, reference: FloatArray) -> FloatArray:
    """Third moment of the mean paired difference of every row to a reference, (d,)."""
    cubes = np.empty(len(parts))
    for rows, block in _paired_parts(parts, reference):
        cubes[rows] = (block * block * block).sum(axis=1)
    return cubes


def spread_is_known(side: IntArray) -> bool:
    """Whether every side has two scenarios or more: with a single scenario no standard error is finite."""
    return bool((np.unique(side, return_counts=True)[1] > 1).all())


def half_widths(critical: float | FloatArray, errors: FloatArray) -> FloatArray:
    """Critical value times standard errors, (d,); infinite for an infinite error, whatever the critical value."""
    result: FloatArray = np.full(errors.shape, np.inf)
    np.multiply(critical, errors, out=result, where=np.isfinite(errors))
    return result


def skewed_widths(
    critical: float | FloatArray, errors: FloatArray, cubes: FloatArray, normal: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """How far intervals of skewed scores reach below and above their estimates.

    With g = cubes / errors^3, the skewness of an estimate, the Edgeworth expansion of Student's t (Hall 1992,
    Johnson 1978) takes g (1 + 2 c^2) / 6 standard errors more on the side of the longer tail, and for g^2 (c^5 +
    2 c^3 - 3 c) / 18 on both, limited to c. The expansion's gain on the side of the shorter tail is not taken: g
    is itself an estimate. For clusters c of the first term is the `normal` critical value, and the second is left out:
    t with few degrees of freedom has wide tails already.
    """
    skewness = np.zeros(errors.shape)
    usable = np.isfinite(errors) & (errors**3 > 0)
    np.divide(cubes, errors**3, out=skewness, where=usable)
    c = critical if normal is None else normal
    both = critical + (np.clip(skewness**2 * (c**5 + 2 * c**3 - 3 * c) / 18, 0.0, c) if normal is None else 0.0)
    shift = skewness * (1 + 2 * c**2) / 6
    return half_widths(both + np.maximum(-shift, 0.0), errors), half_widths(both + np.maximum(shift, 0.0), errors)


def degrees_of_freedom(side: IntArray) -> int:
    """Scenarios minus the means that are estimated, one for each side; at least 1."""
    return max(1, side.size - np.unique(side).size)


_RESAMPLED_ENTRIES = 32_000  # resampled differences held at once; they stay in the cache
_STORED_PARTS = 20_000_000  # error parts that are stored (160 MB); more are computed again for each reference


@dataclasses.dataclass(frozen=True)
class Resampled:
    """Scores of d designs on n scenarios and their means on B resamples, the same ones for all designs."""

    # (D, n) [m s] Scores of these designs, and perhaps of others, in any order: a large table is not copied
    table: FloatArray
    rows: IntArray  # (d,) Rows of the designs in the table
    side: IntArray  # (n,) Stratum of each scenario
    mean: FloatArray  # (d,) [m s]
    deviations: FloatArray  # (B, d) [m s] Mean on a resample minus `mean`
    # (d, n) [m s] `error_parts`, if they are few enough to be stored
    parts: FloatArray | None
    df: int  # Degrees of freedom of a standard error
    known: bool = True  # Whether there is a standard error: `spread_is_known`
    # Of recorded departures: scores (D, n) of every departure and their clusters (n,); the table has a value a cluster
    departures: tuple[FloatArray, IntArray] | None = None

    @classmethod
    def of(
        cls,
        scores: FloatArray,
        side: IntArray,
        *,
        seed: int,
        samples: int,
        stream: int = 0,
        rows: IntArray | None = None,
        cluster: IntArray | None = None,
    ) -> Resampled:
        """Resample scenarios within each side; with clusters (n,) whole clusters, whatever their sides."""
        rows = np.arange(len(scores)) if rows is None else rows
        cluster, departures = several(cluster), None
        if cluster is not None:
            departures = scores, cluster
            scores = cluster_values(scores, cluster)
            side = np.zeros(scores.shape[1], dtype=np.int64)
        few = rows.size * side.size <= _STORED_PARTS
        deviations = bootstrap_deviations(scores, side, samples=samples, seed=seed, stream=stream, rows=rows)
        if cluster is not None:  # resamples of G values vary by (G - 1)/G of the squared standard error
            deviations *= math.sqrt(side.size / max(side.size - 1, 1))
        return cls(
            table=scores,
            rows=rows,
            side=side,
            mean=row_means(scores, rows),
            deviations=deviations,
            parts=error_parts(scores[rows], side) if few else None,
            df=degrees_of_freedom(side),
            known=spread_is_known(side),
            departures=departures,
        )

    def degrees(self, reference: int | None = None) -> FloatArray | int:
        """Degrees of freedom of every mean, or of its paired difference to the reference: (d,) for clusters."""
        if self.departures is None:
            return self.df
        scores, cluster = self.departures
        df = np.empty(self.mean.size)
        for positions, block in row_blocks(scores, self.rows):
            change = block if reference is None else block - scores[self.rows[reference]]
            df[positions] = cluster_error(change - row_means(change)[:, None], cluster).df
        return df

    def take(self, rows: IntArray) -> Resampled:
        """The given designs on the same resamples."""
        return dataclasses.replace(
            self,
            rows=self.rows[rows],
            mean=self.mean[rows],
            deviations=self.deviations[:, rows],
            parts=None if self.parts is None else self.parts[rows],
        )

    def scores(self, design: int) -> FloatArray:
        """Scores of a design, (n,) [m s]."""
        result: FloatArray = self.table[self.rows[design]]
        return result

    def differences(self, reference: int) -> FloatArray:
        """Mean paired difference of every design to the reference, (d,) [m s]; exactly 0 for equal scores."""
        result, other = np.empty(self.mean.size), self.scores(reference)
        for positions, block in row_blocks(self.table, self.rows):
            result[positions] = row_means(block - other)
        return result

    def errors(self, reference: int | None = None) -> FloatArray:
        """Standard error of every mean, or of its paired difference to the reference, (d,) [m s].

        0 where scores do not spread, or move along with those of the reference. Infinite where a side has one scenario
        only, except for the difference of equal scores.
        """
        if not self.known:
            result = np.full(self.mean.size, np.inf)
            if reference is not None:
                for positions, block in row_blocks(self.table, self.rows):
                    result[positions][(block == self.scores(reference)).all(axis=1)] = 0.0
            return result
        if reference is None:
            other = np.zeros(self.side.size)
            largest = max((_largest(block) for _, block in row_blocks(self.table, self.rows)), default=0.0)
        else:
            other, largest = self._parts_of(reference), _largest(self.scores(reference))
        result = np.empty(self.mean.size)
        for positions, parts in self._part_blocks():
            result[positions] = paired_errors(parts, other, largest)
        return result

    def cubes(self, reference: int | None = None) -> FloatArray:
        """Third moment of every mean, or of its paired difference to the reference, (d,) [m s^3]."""
        result = np.zeros(self.mean.size)
        other = np.zeros(self.side.size) if reference is None else self._parts_of(reference)
        for positions, parts in self._part_blocks():
            result[positions] = paired_cubes(parts, other)
        return result

    def _part_blocks(self) -> Iterator[tuple[slice, FloatArray]]:
        if self.parts is not None:
            yield slice(None), self.parts
            return
        for positions, block in row_blocks(self.table, self.rows):
            yield positions, error_parts(block, self.side)

    def _parts_of(self, design: int) -> FloatArray:
        parts = error_parts(self.scores(design)[None], self.side) if self.parts is None else self.parts[[design]]
        result: FloatArray = parts[0]
        return result

    def extremes(self, errors: FloatArray, reference: int | None = None, first: int | None = None) -> FloatArray:
        """Largest absolute studentised deviation in each resample; designs with error 0 are left out."""
        scale = np.divide(1.0, errors, out=np.zeros_like(errors), where=errors > 0)
        samples, d = self.deviations.shape
        parts = (slice(None, first), slice(first, None)) if first not in (None, d) else (slice(None),)
        maxima = np.empty((len(parts), samples))
        size = max(1, _RESAMPLED_ENTRIES // d)
        for start in range(0, samples, size):
            rows = slice(start, start + size)
            if reference is None:
                t = self.deviations[rows] * scale
            else:
                t = self.deviations[rows] - self.deviations[rows, reference : reference + 1]
                t *= scale
            for part, row in zip(parts, maxima, strict=True):
                # faster than the maximum of abs(t), which needs another array
                np.maximum(t[:, part].max(axis=1), -t[:, part].min(axis=1), out=row[rows])
        return np.stack([maxima[0], maxima.max(axis=0)])


def _largest(scores: FloatArray) -> float:
    return float(np.abs(scores).max(initial=0.0))


def critical_value(largest: FloatArray, confidence: float, df: FloatArray | float) -> Any:
    """Number of standard errors that the largest studentised deviation stays below with the confidence; as `df` (d,).

    With the tails of Student's t: resamples are divided by a known standard error, the real one is estimated.
    """
    critical = with_tails_of_t(float(np.quantile(largest, confidence, method="weibull")), df)
    return critical if critical.ndim else float(critical)


@dataclasses.dataclass(frozen=True)
class Interval:
    """Simultaneous intervals of d means or mean differences, arrays of d in m s."""

    # (d,) [m s] Mean, its standard error, and both ends: `skewed_widths` from the centre
    centre: FloatArray
    error: FloatArray
    low: FloatArray
    high: FloatArray
    critical: float  # Standard errors to both sides for scores without skewness


def simultaneous_interval(resampled: Resampled, confidence: float, reference: int | None = None) -> Interval:
    """Intervals of all means, or of all paired differences to a design that was fixed beforehand: max-t. All of them
    hold at once with the confidence. The critical value is the quantile of the largest absolute deviation, each
    divided by its own standard error, over the resamples; skewed scores have wider intervals.
    """
    check_confidence(confidence)
    errors = resampled.errors(reference)
    extremes = resampled.extremes(errors, reference)[1]
    critical = critical_value(extremes, confidence, resampled.degrees(reference))
    normal = None if resampled.departures is None else critical_value(extremes, confidence, np.inf)
    centre = resampled.mean if reference is None else resampled.differences(reference)
    below, above = skewed_widths(critical, errors, resampled.cubes(reference), normal)
    return Interval(centre, errors, centre - below, centre + above, float(np.max(critical)))


_REFERENCE_ENTRIES = 500_000  # resampled means in a block (4 MB)


@dataclasses.dataclass(frozen=True)
class Differences:
    """Differences of d designs to one of them and to the baseline, arrays of d; NaN where they are not known."""

    # (d,) [m s] Mean S minus that of the reference, paired on the scenarios, and its interval, for all designs at once
    difference: FloatArray
    difference_low: FloatArray
    difference_high: FloatArray
    # (d,) [m s] The same to the baseline
    baseline_difference: FloatArray
    baseline_difference_low: FloatArray
    baseline_difference_high: FloatArray


@dataclasses.dataclass(frozen=True)
class Inference(Differences):
    """Simultaneous intervals of d designs, arrays of d: each family holds for all its designs at once.

    The reference is the best design; the intervals hold whichever design came out best.
    """

    # (d,) [m s] Interval of the mean S
    S_low: FloatArray
    S_high: FloatArray
    # (d,) The truly best of the ranked designs is in this set with the confidence at least. A design within 1e-6 m s of
    # the best, the accuracy of an iterative solver, always is
    set_of_best: BoolArray
    # (d,) Share of resamples in which the design has the smallest mean of the ranked designs, divided between equal
    # designs. It is not the probability that the design is the best
    best_frequency: FloatArray
    # Designs that critical values of the comparisons with the best were computed for, and designs that may be the best;
    # fewer references make intervals too short
    references: int
    may_be_best: int


def infer(resampled: Resampled, *, ranked: int, baseline: int | None, confidence: float) -> Inference:
    """Compare designs, the first `ranked` of them as candidates for the best; none where that is 0."""
    d = resampled.mean.size
    contenders = ranked or d
    means = simultaneous_interval(resampled, confidence)
    best = compare_with_best(resampled, confidence, contenders)
    among = np.arange(d) < ranked
    undefined = np.full(d, np.nan)
    to_baseline = None if baseline is None else simultaneous_interval(resampled, confidence, baseline)
    return Inference(
        S_low=means.low,
        S_high=means.high,
        difference=best.difference,
        difference_low=best.low_of_all,
        difference_high=best.high_of_all,
        baseline_difference=undefined if to_baseline is None else to_baseline.centre,
        baseline_difference_low=undefined if to_baseline is None else to_baseline.low,
        baseline_difference_high=undefined if to_baseline is None else to_baseline.high,
        set_of_best=~best.clear & among,
        best_frequency=np.where(among, best_frequency(resampled, contenders), 0.0),
        references=best.references,
        may_be_best=best.may_be_best,
    )


def best_frequency(resampled: Resampled, contenders: int) -> FloatArray:
    """Share of resamples in which each design has the smallest mean of the first `contenders`, (d,)."""
    mean, deviations = resampled.mean[:contenders], resampled.deviations[:, :contenders]
    frequency = np.zeros(resampled.mean.size)
    size = max(1, _REFERENCE_ENTRIES // contenders)
    for first in range(0, len(deviations), size):
        block = deviations[first : first + size] + mean
        smallest = block == block.min(axis=1, keepdims=True)
        # integer counts for each number of equal designs: sums of rounded thirds are not exact
        equals = smallest.sum(axis=1)
        for number in np.unique(equals).tolist():
            frequency[:contenders] += smallest[equals == number].sum(axis=0) / number
    return frequency / len(deviations)


SAME = 1e-6  # differences of mean S [m s] up to this are a solver's tolerance, not design
_MOST_TERMS = 300_000_000  # resampled differences to evaluate: references x designs x resamples
_MOST_SCORES = 100_000_000  # paired scores to evaluate: references x designs x scenarios


@dataclasses.dataclass(frozen=True)
class Separation:
    """How far k designs are from the best of them."""

    mean: FloatArray  # (k,) [m s] Mean score
    best: int  # The design with the smallest mean; the first of equal designs
    difference: FloatArray  # (k,) [m s] Mean minus that of `best`
    error: FloatArray  # (k,) [m s] Standard error of the difference
    # (k,) [m s] Lower bound of how much a design is worse than the truly best, by multiple comparisons with the
    # best: the truly best design has a bound above 0 with a probability of at most 1 - confidence, however many designs
    # there are
    low: FloatArray
    # (k,) [m s] Interval of the difference to the design `best`; all k hold at once, whichever design came out best
    low_of_all: FloatArray
    high_of_all: FloatArray
    # Standard errors behind `low`, and behind the interval where scores have no skewness
    critical: float
    critical_of_all: float
    # Designs that critical values were computed for, and designs that may be the best
    references: int
    may_be_best: int

    @property
    def clear(self) -> BoolArray:
        """Designs that are worse than the best by more than a solver's tolerance, (k,): all but the set of best."""
        result: BoolArray = self.low > SAME
        return result


def compare_with_best(resampled: Resampled, confidence: float, contenders: int | None = None) -> Separation:
    """Compare k designs with the best of them on common scenarios; only the first `contenders` can be the best.

    Design r is tested against all others as if it were the best, and is `clear` when some design beats it by more
    than c_r standard errors of their paired difference; c_r is the quantile of the largest studentised difference
    to r (Hsu 1984). Only the test of the truly best design can do harm, so the choice of r costs nothing. One
    critical value serves all: the largest c_r of the designs that may be best. Where these are very many, c_r is
    computed for some of them, evenly over the ranks. Differences count in both directions, though only one is
    tested: scores are skewed, and resampled means are skewed the other way than studentised ones. The interval of
    the difference to the design that came out best needs more: its critical value is the quantile of the largest
    difference over all these r at once. Of skewed scores it is wider, see `skewed_widths`; `low` is not, for the
    test of one design is conservative.
    """
    check_confidence(confidence)
    k = resampled.mean.size if contenders is None else contenders
    best = int(np.argmin(resampled.mean[:k]))
    difference, error = resampled.differences(best), resampled.errors(best)
    df = float(np.min(resampled.degrees(best)))
    candidates = _may_be_best(difference[:k], error[:k], df, confidence)
    may_be_best = candidates.size
    most = max(
        2, min(_MOST_TERMS // resampled.deviations.size, _MOST_SCORES // (resampled.mean.size * resampled.side.size))
    )
    if candidates.size > most:
        candidates = candidates[np.unique(np.linspace(0, candidates.size - 1, most).astype(np.int64))]

    critical, of_every = 0.0, np.zeros(resampled.deviations.shape[0])
    errors = np.empty((candidates.size, error.size))
    for r, row in zip(candidates.tolist(), errors, strict=True):
        row[:] = resampled.errors(r)
        # as the best, r is compared with the other contenders; for intervals, with all designs
        contending, largest = resampled.extremes(row, r, k)
        critical = max(critical, critical_value(contending, confidence, df))
        np.maximum(of_every, largest, out=of_every)
    of_all = critical_value(of_every, confidence, df)
    low = np.full(error.size, -np.inf)
    for r, row in zip(candidates.tolist(), errors, strict=True):
        others = np.arange(error.size) != r
        np.maximum(low, resampled.mean - resampled.mean[r] - half_widths(critical, row), out=low, where=others)
    normal = None if resampled.departures is None else critical_value(of_every, confidence, np.inf)
    below, above = skewed_widths(of_all, error, resampled.cubes(best), normal)
    low = np.where(error == 0, difference, low)  # exactly 0 for the best itself
    return Separation(
        mean=resampled.mean,
        best=best,
        difference=difference,
        error=error,
        low=low,
        low_of_all=difference - below,
        high_of_all=difference + above,
        critical=critical,
        critical_of_all=of_all,
        references=candidates.size,
        may_be_best=may_be_best,
    )


def _may_be_best(difference: FloatArray, error: FloatArray, df: float, confidence: float) -> IntArray:
    """Designs that even Bonferroni's bound does not separate from the best, by rank; the best is the first."""
    from scipy.special import stdtrit

    bound = float(-stdtrit(df, (1.0 - confidence) / (2 * max(1, difference.size - 1))))
    order = np.argsort(difference, kind="stable")
    result: IntArray = order[difference[order] <= bound * error[order] + SAME].astype(np.int64)
    return result


# ------------------------------------------------------------------------------------- probabilities and quantiles


LEVEL = 0.95


def exact_interval(count: int, n: int) -> tuple[float, float]:
    """Interval of a probability after Clopper and Pearson, 95 %, from `count` events in `n` independent trials.

    It covers the true probability in 95 % of the cases at least. Without any event it ends near 3.7/n; of no trials it
    is 0 to 1.

    Examples
    --------
    >>> low, high = exact_interval(0, 100)
    >>> low, round(high, 4)
    (0.0, 0.0362)
    """
    low, high = binomial_interval(count, n, LEVEL)
    return float(low), float(high)


def binomial_interval(count: npt.ArrayLike, n: npt.ArrayLike, level: float) -> tuple[FloatArray, FloatArray]:
    """`exact_interval` for arrays, which need not be integers: n of weighted events is their effective number."""
    from scipy.special import betaincinv

    events, trials, outside = np.asarray(count), np.asarray(n), (1.0 - level) / 2.0
    rest = np.maximum(trials - events, 0.0)
    low = betaincinv(np.maximum(events, 1e-300), rest + 1.0, outside)
    high = betaincinv(events + 1.0, np.maximum(rest, 1e-300), 1.0 - outside)
    return np.where(events > 0, low, 0.0), np.where(rest > 0, high, 1.0)


def order_statistics(n: npt.ArrayLike, share: float, level: float) -> tuple[IntArray, IntArray]:
    """Ranks, from 1, of the two of n independent values that enclose a quantile of their distribution.

    They enclose it with a probability of at least `level`, for every distribution (David and Nagaraja, *Order
    Statistics*, 2003, 7.1). Rank 0 or n + 1: there is no such value.
    """
    from scipy.special import bdtr, bdtrik  # scipy.stats takes half a second to import

    def quantile(end: float) -> IntArray:
        """Of the number of values below it: the smallest count that so many are at most with this probability."""
        near = np.ceil(np.nan_to_num(bdtrik(end, trials, share)))  # NaN of no values
        lower = np.maximum(near - 1.0, 0.0)
        return np.asarray(np.where(bdtr(lower, trials, share) >= end, lower, near), dtype=np.int64)

    trials, outside = np.asarray(n, dtype=np.int64), (1.0 - level) / 2.0
    return quantile(outside), quantile(1.0 - outside) + 1


def paired_sign(b: int, c: int) -> int:
    """1 where a design has an event more often than its reference on the same trials, -1 where less often, else 0.

    Of b trials only the design has the event, of c only the reference. McNemar's exact test, two-sided at 5 %: where
    both are alike, each of these trials belongs to b or to c with the same probability.
    """
    from scipy.special import bdtr

    if b == c or 2.0 * bdtr(float(min(b, c)), b + c, 0.5) > 1.0 - LEVEL:
        return 0
    return 1 if b > c else -1


def tail_text(deepest: FloatArray, uncorrected: FloatArray) -> str:
    """Phrase on a design that is significantly worse than no control in the tail, else empty.

    `deepest` and `uncorrected` are the depths (n,) [m] of both on the same departures.
    """
    beyond, without = deepest > TAIL, uncorrected > TAIL
    if paired_sign(int(np.sum(beyond & ~without)), int(np.sum(without & ~beyond))) <= 0:
        return ""
    return (
        f"worse than no control beyond {TAIL:g} m: {beyond.sum():,} of {beyond.size:,} departures get so deep, without "
        f"control {without.sum():,}"
    )
