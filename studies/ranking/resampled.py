"""Scores of designs on common scenarios, resampled: the common ground of all simultaneous intervals."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from studies.ranking.bootstrap import bootstrap_deviations, check_confidence
from studies.ranking.row_blocks import row_blocks, row_means
from studies.ranking.standard_error import (
    degrees_of_freedom,
    error_parts,
    paired_cubes,
    paired_errors,
    skewed_widths,
    spread_is_known,
    with_tails_of_t,
)

_BLOCK_ENTRIES = 32_000
"""Resampled differences held at once; they stay in the cache."""

_KEPT_ENTRIES = 20_000_000
"""Error parts that are kept (160 MB). More are made again for each of the few references."""


@dataclasses.dataclass(frozen=True)
class Resampled:
    """Scores of d designs on n scenarios and their means on B resamples, the same ones for all designs."""

    # (D, n) [m s] Scores of these designs, and perhaps of others, in any order: a table may be too large for a second
    # one
    table: FloatArray
    rows: IntArray  # (d,) Where the designs stand in it
    side: IntArray  # (n,) Stratum of each scenario
    mean: FloatArray  # (d,) [m s]
    deviations: FloatArray  # (B, d) [m s] Mean on a resample minus `mean`
    # (d, n) [m s] or None `studies.ranking.standard_error.error_parts`, where they are few enough to be kept
    parts: FloatArray | None
    df: int  # Degrees of freedom of a standard error
    known: bool = True  # Whether there is a standard error: `studies.ranking.standard_error.spread_is_known`

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
    ) -> Resampled:
        """Resample scenarios within each side."""
        rows = np.arange(len(scores)) if rows is None else rows
        few = rows.size * side.size <= _KEPT_ENTRIES
        return cls(
            table=scores,
            rows=rows,
            side=side,
            mean=row_means(scores, rows),
            deviations=bootstrap_deviations(scores, side, samples=samples, seed=seed, stream=stream, rows=rows),
            parts=error_parts(scores[rows], side) if few else None,
            df=degrees_of_freedom(side),
            known=spread_is_known(side),
        )

    def take(self, rows: IntArray) -> Resampled:
        """Some of the designs, on the same resamples."""
        return dataclasses.replace(
            self,
            rows=self.rows[rows],
            mean=self.mean[rows],
            deviations=self.deviations[:, rows],
            parts=None if self.parts is None else self.parts[rows],
        )

    def scores(self, design: int) -> FloatArray:
        """Scores of one of the designs, (n,) [m s]."""
        result: FloatArray = self.table[self.rows[design]]
        return result

    def differences(self, reference: int) -> FloatArray:
        """Mean paired difference of every design to one of them, (d,) [m s]; exactly 0 for equal scores."""
        result, other = np.empty(self.mean.size), self.scores(reference)
        for places, block in row_blocks(self.table, self.rows):
            result[places] = row_means(block - other)
        return result

    def errors(self, reference: int | None = None) -> FloatArray:
        """Standard error of every mean, or of its paired difference to one design, (d,) [m s].

        0 where scores do not spread, or move along with those of the reference. Infinite where a side has one scenario
        only, but for the difference of equal scores.
        """
        if not self.known:
            result = np.full(self.mean.size, np.inf)
            if reference is not None:
                for places, block in row_blocks(self.table, self.rows):
                    result[places][(block == self.scores(reference)).all(axis=1)] = 0.0
            return result
        if reference is None:
            other = np.zeros(self.side.size)
            largest = max((_largest(block) for _, block in row_blocks(self.table, self.rows)), default=0.0)
        else:
            other, largest = self._parts_of(reference), _largest(self.scores(reference))
        result = np.empty(self.mean.size)
        for places, parts in self._part_blocks():
            result[places] = paired_errors(parts, other, largest)
        return result

    def cubes(self, reference: int | None = None) -> FloatArray:
        """Third moment of every mean, or of its paired difference to one design, (d,) [m s^3]."""
        result = np.zeros(self.mean.size)
        other = np.zeros(self.side.size) if reference is None else self._parts_of(reference)
        for places, parts in self._part_blocks():
            result[places] = paired_cubes(parts, other)
        return result

    def _part_blocks(self) -> Iterator[tuple[slice, FloatArray]]:
        if self.parts is not None:
            yield slice(None), self.parts
            return
        for places, block in row_blocks(self.table, self.rows):
            yield places, error_parts(block, self.side)

    def _parts_of(self, design: int) -> FloatArray:
        parts = error_parts(self.scores(design)[None], self.side) if self.parts is None else self.parts[[design]]
        result: FloatArray = parts[0]
        return result

    def extremes(self, errors: FloatArray, reference: int | None = None, first: int | None = None) -> FloatArray:
        """Largest absolute studentised deviation in each resample: among the first designs, and among all."""
        scale = np.divide(1.0, errors, out=np.zeros_like(errors), where=errors > 0)
        samples, d = self.deviations.shape
        parts = (slice(None, first), slice(first, None)) if first not in (None, d) else (slice(None),)
        found = np.empty((len(parts), samples))
        size = max(1, _BLOCK_ENTRIES // d)
        for start in range(0, samples, size):
            rows = slice(start, start + size)
            if reference is None:
                t = self.deviations[rows] * scale
            else:
                t = self.deviations[rows] - self.deviations[rows, reference : reference + 1]
                t *= scale
            for part, row in zip(parts, found, strict=True):
                # faster than the largest of abs(t), which is one more array
                np.maximum(t[:, part].max(axis=1), -t[:, part].min(axis=1), out=row[rows])
        return np.stack([found[0], found.max(axis=0)])


def _largest(scores: FloatArray) -> float:
    return float(np.abs(scores).max(initial=0.0))


def critical_value(largest: FloatArray, confidence: float, df: int) -> float:
    """Number of standard errors that the largest studentised deviation stays below with the confidence."""
    return with_tails_of_t(float(np.quantile(largest, confidence, method="weibull")), df)


@dataclasses.dataclass(frozen=True)
class Interval:
    """Simultaneous intervals of d means or mean differences, arrays of d in m s."""

    # (d,) [m s] Mean, its standard error, and both ends: `studies.ranking.standard_error.skewed_widths` from the centre
    centre: FloatArray
    error: FloatArray
    low: FloatArray
    high: FloatArray
    critical: float  # Standard errors to both sides for scores without skewness


def simultaneous_interval(resampled: Resampled, confidence: float, reference: int | None = None) -> Interval:
    """Intervals of all means, or of all paired differences to one design that was named beforehand: max-t. All of them
    hold at once with the confidence. The critical value is the quantile of the largest absolute deviation, each
    divided by its own standard error, over the resamples; skewed scores have wider intervals.
    """
    check_confidence(confidence)
    errors = resampled.errors(reference)
    critical = critical_value(resampled.extremes(errors, reference)[1], confidence, resampled.df)
    centre = resampled.mean if reference is None else resampled.differences(reference)
    below, above = skewed_widths(critical, errors, resampled.cubes(reference))
    return Interval(centre, errors, centre - below, centre + above, critical)
