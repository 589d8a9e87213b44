"""Scores of designs on common scenarios, resampled: the common ground of all simultaneous intervals."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from studies.ranking.bootstrap import bootstrap_deviations, check_confidence, row_means
from studies.ranking.standard_error import (
    degrees_of_freedom,
    error_parts,
    half_widths,
    paired_errors,
    spread_is_known,
    with_tails_of_t,
)

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_BLOCK_ENTRIES = 32_000
"""Resampled differences held at once; they stay in the cache."""


@dataclasses.dataclass(frozen=True)
class Resampled:
    """Scores of d designs on n scenarios and their means on B resamples, the same ones for all designs.

    Attributes
    ----------
    scores : (d, n) [m s]
    mean : (d,) [m s]
    deviations : (B, d) [m s]
        Mean on a resample minus `mean`.
    parts : (d, n) [m s]
        `studies.ranking.standard_error.error_parts`.
    df : int
        Degrees of freedom of a standard error.
    known : bool
        Whether there is a standard error: `studies.ranking.standard_error.spread_is_known`.
    """

    scores: FloatArray
    mean: FloatArray
    deviations: FloatArray
    parts: FloatArray
    df: int
    known: bool = True

    @classmethod
    def of(cls, scores: FloatArray, side: IntArray, *, seed: int, samples: int, stream: int = 0) -> Resampled:
        """Resample scenarios within each side.

        Parameters
        ----------
        scores : (d, n) [m s]
        side : (n,) int
            Stratum of each scenario.
        seed : int
        samples : int
            Number of resamples B.
        stream : int
            Another stream gives other resamples from the same seed.

        Raises
        ------
        InputError
            If samples is not positive, or there are no scenarios.
        """
        return cls(
            scores=scores,
            mean=row_means(scores),
            deviations=bootstrap_deviations(scores, side, samples=samples, seed=seed, stream=stream),
            parts=error_parts(scores, side),
            df=degrees_of_freedom(side),
            known=spread_is_known(side),
        )

    def take(self, rows: IntArray) -> Resampled:
        """Some of the designs, on the same resamples."""
        return dataclasses.replace(
            self,
            scores=self.scores[rows],
            mean=self.mean[rows],
            deviations=self.deviations[:, rows],
            parts=self.parts[rows],
        )

    def differences(self, reference: int) -> FloatArray:
        """Mean paired difference of every design to one of them, (d,) [m s]; exactly 0 for equal scores."""
        return row_means(self.scores - self.scores[reference])

    def errors(self, reference: int | None = None) -> FloatArray:
        """Standard error of every mean, or of its paired difference to one design, (d,) [m s].

        0 where scores do not spread, or move along with those of the reference. Infinite where a side has one scenario
        only, but for the difference of equal scores.
        """
        if not self.known:
            if reference is None:
                return np.full(self.mean.size, np.inf)
            return np.where((self.scores == self.scores[reference]).all(axis=1), 0.0, np.inf)
        if reference is None:
            return paired_errors(self.parts, np.zeros(self.parts.shape[1]), _largest(self.scores))
        return paired_errors(self.parts, self.parts[reference], _largest(self.scores[reference]))

    def extremes(self, errors: FloatArray, reference: int | None = None, first: int | None = None) -> FloatArray:
        """Largest absolute studentised deviation in each resample: among the first designs, and among all.

        Parameters
        ----------
        errors : (d,) [m s]
            As from `errors`; a design with 0, or an infinite one, is left out.
        reference : int, optional
            Deviations of the difference to this design instead of the means.
        first : int, optional
            How many the first ones are; all by default.

        Returns
        -------
        (2, B)
        """
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
    """Number of standard errors that the largest studentised deviation stays below with the confidence.

    Parameters
    ----------
    largest : (B,)
        In each resample.
    confidence : float
        Between 0 and 1.
    df : int
        Resampled deviations are divided by a known standard error; the tails of Student's t account for that the real
        one is estimated.

    Returns
    -------
    float
    """
    return with_tails_of_t(float(np.quantile(largest, confidence, method="weibull")), df)


@dataclasses.dataclass(frozen=True)
class Interval:
    """Simultaneous intervals of d means or mean differences, arrays of d in m s.

    Attributes
    ----------
    centre, error, low, high : (d,) [m s]
        Mean, its standard error, and both ends: centre -/+ critical * error.
    critical : float
    """

    centre: FloatArray
    error: FloatArray
    low: FloatArray
    high: FloatArray
    critical: float


def simultaneous_interval(resampled: Resampled, confidence: float, reference: int | None = None) -> Interval:
    """Intervals of all means, or of all paired differences to one design that was named beforehand: max-t.

    All of them hold at once with the confidence. The critical value is the quantile of the largest absolute deviation,
    each divided by its own standard error, over the resamples.

    Parameters
    ----------
    resampled : Resampled
    confidence : float
        Between 0 and 1.
    reference : int, optional
        The design that all are compared with.

    Returns
    -------
    Interval

    Raises
    ------
    InputError
        For a confidence outside (0, 1).

    Examples
    --------
    >>> import numpy as np
    >>> S = np.random.default_rng(0).gamma(2.0, 1.0, (3, 100))
    >>> resampled = Resampled.of(S, np.repeat([1, -1], 50), seed=1, samples=200)
    >>> interval = simultaneous_interval(resampled, 0.95)
    >>> bool(np.all((interval.low < 2.0) & (2.0 < interval.high)))
    True
    """
    check_confidence(confidence)
    errors = resampled.errors(reference)
    critical = critical_value(resampled.extremes(errors, reference)[1], confidence, resampled.df)
    centre = resampled.mean if reference is None else resampled.differences(reference)
    width = half_widths(critical, errors)
    return Interval(centre, errors, centre - width, centre + width, critical)
